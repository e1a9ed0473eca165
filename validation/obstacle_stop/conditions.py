"""Conditions of an evaluation, read from a versioned YAML file."""

from fnmatch import fnmatch
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from configs.strict import Config, load
from messages.perception import ObstacleClass
from validation.obstacle_stop.consistency.config import ConsistencyConditions

FILE = Path(__file__).parent.parent / "conditions" / "obstacle_stop.yaml"
Metres = Annotated[float, Field(ge=0.0, le=500.0)]
Seconds = Annotated[float, Field(ge=0.0, le=1e6)]
Count = Annotated[int, Field(ge=0, le=1000000)]


class BrakingValues(Config):
    """τ, t_b and a of docs/requirements.md, and the part of τ that remains after the braking request."""

    reaction_s: float = Field(ge=0.0, le=10.0)
    build_up_s: float = Field(ge=0.0, le=10.0)
    deceleration_mps2: float = Field(gt=0.0, le=12.0)
    dead_time_s: float = Field(ge=0.0, le=10.0)

    @model_validator(mode="after")
    def _dead_time_within_reaction(self) -> "BrakingValues":
        if self.dead_time_s > self.reaction_s:
            raise ValueError(f"dead_time_s {self.dead_time_s} is a part of reaction_s {self.reaction_s}")
        return self


class CorridorConditions(Config):
    """Driving corridor: half width (also for manual driving), side margin, length, returns for entry."""

    half_width_m: float = Field(gt=0.1, le=20.0)
    side_margin_m: float = Field(ge=0.0, le=5.0)
    length_m: float = Field(ge=5.0, le=300.0)
    min_returns: int = Field(ge=1, le=1000)


class TruthConditions(Config):
    """Source of the truth, its maximum age, and the association of returns with boxes."""

    source: Literal["any", "topic", "sidecar", "labels"]
    max_age_s: float = Field(gt=0.0, le=10.0)
    association_m: Metres
    ground_margin_m: Metres


class RecallConditions(Config):
    """Returns from which an object counts, and range bins of the recall table."""

    min_returns: int = Field(ge=1, le=1000)
    range_edges_m: tuple[Metres, ...] = Field(min_length=2)


class MaxCounts(Config):
    """Highest counts that pass."""

    missed: Count
    late: Count
    false_stops: Count


class RequiredBounds(Config):
    """Exact 95 % bounds that a verdict needs to be shown: upper of the missed share, lower of the recall."""

    missed_share: float = Field(default=1.0, gt=0.0, le=1.0)
    recall: float = Field(default=0.0, ge=0.0, lt=1.0)


class Window(Config):
    """Time interval of the logs whose name matches `log`."""

    log: str
    from_s: Seconds
    to_s: Seconds


class IgnoredArea(Config):
    """Area excluded from the evaluation, in the frame `odom` of the replay."""

    log: str
    outline_odom_m: tuple[tuple[float, float], ...] = Field(min_length=3)
    reason: str = Field(min_length=3)


class ListedObject(Config):
    """Object of the logs whose name matches `log`, by its id in the truth."""

    log: str
    id: int
    reason: str = Field(min_length=3)


class Conditions(Config):
    """All inputs of a verdict besides the log and the stack."""

    version: Literal[1]
    braking: BrakingValues
    corridor: CorridorConditions
    truth: TruthConditions
    recall: RecallConditions
    classes: tuple[ObstacleClass, ...] = Field(min_length=1)
    recognition_m: Metres
    settling_s: float = Field(ge=0.0, le=10.0)
    margin_m: Metres = 0.0
    max_counts: MaxCounts
    required_bounds: RequiredBounds = RequiredBounds()
    windows: tuple[Window, ...]
    ignored: tuple[IgnoredArea, ...]
    must_stop: tuple[ListedObject, ...]
    must_not_stop: tuple[ListedObject, ...]
    consistency: ConsistencyConditions

    def is_evaluated(self, log: str, t_s: float) -> bool:
        """Whether a time of a log is evaluated: inside one of its windows, or no window is given."""
        mine = [w for w in self.windows if fnmatch(log, w.log)]
        return not mine or any(w.from_s <= t_s <= w.to_s for w in mine)

    def areas(self, log: str) -> tuple[IgnoredArea, ...]:
        """Ignored areas of a log."""
        return tuple(area for area in self.ignored if fnmatch(log, area.log))


def listed_ids(entries: tuple[ListedObject, ...], log: str) -> dict[int, str]:
    """Object ids listed for a log, with reasons."""
    return {entry.id: entry.reason for entry in entries if fnmatch(log, entry.log)}


def load_conditions(file: Path | None) -> Conditions:
    """Conditions from a file, by default the shipped one; raises ConfigError."""
    return load(Conditions, file or FILE)
