"""A scenario: what people, animals and vehicles do, what a person orders, and when satellites fail."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from configs.strict import Config
from messages.command import OperatorCommandKind
from messages.perception import ObstacleClass
from simulation.faults.config import InjectedFault


def _is_rising(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError(f"{value[0]} to {value[1]} is not a range")
    return value


Bound = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Range = Annotated[tuple[Bound, Bound], AfterValidator(_is_rising)]
CommandName = Literal["start", "pause", "resume", "emergency_stop", "reset", "manual", "automatic"]


class ScenarioCommand(Config):
    """A person presses something."""

    at_s: float = Field(ge=0.0, le=1e6)
    command: CommandName
    expires_s: float = Field(gt=0.0, le=600.0)

    @property
    def code(self) -> OperatorCommandKind:
        """The command as it is sent."""
        return OperatorCommandKind[self.command.upper()]


class GnssEpisode(Config):
    """A time in which the receiver reaches no better than this state."""

    from_s: float = Field(ge=0.0, le=1e6)
    for_s: float = Field(gt=0.0, le=1e6)
    state: Literal["none", "single", "rtk_float"]


class CameraEpisode(Config):
    """A time in which something lies on the lens of every camera."""

    from_s: float = Field(ge=0.0, le=1e6)
    for_s: float = Field(gt=0.0, le=1e6)
    state: Literal["blocked", "blurred"]


SensorKind = Literal["lidar", "camera", "radar", "ultrasonic"]
ALL_SENSORS: tuple[SensorKind, ...] = ("lidar", "camera", "radar", "ultrasonic")


class _Encounter(Config):
    name: str = Field(min_length=1, max_length=40)
    stops: int = Field(ge=0, le=1, description="how many stops this must cause, stated beforehand")
    seen_by: tuple[SensorKind, ...] = Field(default=ALL_SENSORS, description="sensors that see it; to others it is air")


class Crossing(_Encounter):
    """Somebody who walks to the middle of the way when the machine comes, stands, and leaves to the other side.

    `slack_s` is how long they stand before an unslowed machine would arrive, `wait_s` how much longer than that.
    """

    kind: Literal["crossing"]
    share: Range = Field(description="where along its swath, 0 start to 1 end")
    figure: Literal["person", "animal"]
    from_m: Range = Field(description="how far aside they wait")
    oblique_deg: Range = Field(description="their way against straight across")
    walk_mps: Range
    leave_mps: Range
    slack_s: Range
    wait_s: Range

    @property
    def label(self) -> ObstacleClass:
        """What it truly is."""
        return ObstacleClass(self.figure)


class Parked(_Encounter):
    """A vehicle that stays on a swath."""

    kind: Literal["parked"]
    share: Range = Field(description="where along its swath, 0 start to 1 end")
    aside_m: Range
    turned_deg: Range = Field(description="against the direction of the swath")

    @property
    def label(self) -> ObstacleClass:
        """What it truly is."""
        return ObstacleClass.VEHICLE


class Bystander(_Encounter):
    """Somebody who comes before a bay while the machine backs towards it, stands there a while and walks off.

    The place lies `ahead_m` of the bay's dock pose along its heading; they come from `from_m` aside (0: they stand
    there from the first) when the machine's rear is `trigger_m` away from them, and leave to the other side.
    """

    kind: Literal["standing"]
    figure: Literal["person", "animal"]
    bay: str
    ahead_m: Range
    aside_m: Range
    from_m: Range
    trigger_m: Range
    walk_mps: Range
    stand_s: Range

    @property
    def label(self) -> ObstacleClass:
        """What it truly is."""
        return ObstacleClass(self.figure)


Encounter = Annotated[Crossing | Parked | Bystander, Field(discriminator="kind")]


class Scenario(Config):
    """What happens around the machine; the same seed draws the same places, times and speeds."""

    name: str
    operator_commands: tuple[ScenarioCommand, ...]
    gnss: tuple[GnssEpisode, ...] = ()
    camera: tuple[CameraEpisode, ...] = ()
    encounters: tuple[Encounter, ...] = ()
    faults: tuple[InjectedFault, ...] = ()

    @property
    def expected_stops(self) -> dict[str, int]:
        """How many stops each encounter must force, by its name."""
        return {e.name: e.stops for e in self.encounters}
