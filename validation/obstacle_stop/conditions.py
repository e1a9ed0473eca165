"""The conditions of a judgement, as they stand in their versioned file."""

from fnmatch import fnmatch
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from configs.strict import Config, load
from messages.perception import ObstacleClass

FILE = Path(__file__).parent.parent / "conditions" / "obstacle_stop.yaml"
Metres = Annotated[float, Field(ge=0.0, le=500.0)]
Seconds = Annotated[float, Field(ge=0.0, le=1e6)]
Count = Annotated[int, Field(ge=0, le=1000000)]


class BrakingValues(Config):
    """τ, t_b and a of requirements.md, and the share of τ left once braking is asked for."""

    reaction_s: float = Field(ge=0.0, le=10.0)
    build_up_s: float = Field(ge=0.0, le=10.0)
    deceleration_mps2: float = Field(gt=0.0, le=12.0)
    dead_time_s: float = Field(ge=0.0, le=10.0)

    @model_validator(mode="after")
    def _dead_time_is_part_of_it(self) -> "BrakingValues":
        if self.dead_time_s > self.reaction_s:
            raise ValueError(f"dead_time_s {self.dead_time_s} is a part of reaction_s {self.reaction_s}")
        return self


class TubeConditions(Config):
    """The swept path."""

    half_width_m: float = Field(gt=0.1, le=20.0)
    side_m: float = Field(ge=0.0, le=5.0)
    reach_m: float = Field(ge=5.0, le=300.0)
    least_returns: int = Field(ge=1, le=1000)


class TruthConditions(Config):
    """Where truth comes from and how far it goes."""

    source: Literal["any", "topic", "sidecar", "labels"]
    greatest_age_s: float = Field(gt=0.0, le=10.0)
    view_deg: dict[str, Annotated[float, Field(gt=0.0, le=180.0)]]
    near_m: Metres
    foot_m: Metres


class RecallConditions(Config):
    """Which objects count, and the ranges that the table has."""

    least_returns: int = Field(ge=1, le=1000)
    edges_m: tuple[Metres, ...] = Field(min_length=2)


class Most(Config):
    """How many of each may be; more, and the logs have failed."""

    missed: Count
    late: Count
    false_stops: Count


class Window(Config):
    """A stretch of time of the logs whose name fits."""

    log: str
    from_s: Seconds
    to_s: Seconds


class Area(Config):
    """An area where nothing is judged, in the frame `odom` of the replay."""

    log: str
    outline_odom_m: tuple[tuple[float, float], ...] = Field(min_length=3)
    reason: str = Field(min_length=3)


class Named(Config):
    """An object of certain logs by its id in the truth."""

    log: str
    id: int
    reason: str = Field(min_length=3)


class Conditions(Config):
    """Everything that a verdict depends on besides the log and the stack."""

    version: Literal[1]
    braking: BrakingValues
    tube: TubeConditions
    truth: TruthConditions
    recall: RecallConditions
    classes: tuple[ObstacleClass, ...] = Field(min_length=1)
    recognition_m: Metres
    grace_s: float = Field(ge=0.0, le=10.0)
    most: Most
    windows: tuple[Window, ...]
    ignored: tuple[Area, ...]
    must_stop: tuple[Named, ...]
    must_not_stop: tuple[Named, ...]

    def is_judged(self, log: str, t_s: float) -> bool:
        """Whether a time of a log is to be judged: in one of its windows, if it has any."""
        mine = [w for w in self.windows if fnmatch(log, w.log)]
        return not mine or any(w.from_s <= t_s <= w.to_s for w in mine)

    def areas(self, log: str) -> tuple[Area, ...]:
        """What of a log is ignored."""
        return tuple(area for area in self.ignored if fnmatch(log, area.log))


def named(entries: tuple[Named, ...], log: str) -> dict[int, str]:
    """Ids of a log with the reason why they are named."""
    return {entry.id: entry.reason for entry in entries if fnmatch(log, entry.log)}


def load_conditions(file: Path | None) -> Conditions:
    """The given file, or ours; raises ConfigError."""
    return load(Conditions, file or FILE)
