"""Scenario: objects, encounters, environment, operator commands, episodes, faults (docs/scenarios.md)."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from configs.strict import Config
from messages.command import OperatorCommandKind
from messages.perception import ObstacleClass
from simulation.faults.config import InjectedFault
from simulation.scenario_environment import Environment
from simulation.scenario_objects import ScenarioObject, check_objects
from simulation.scenario_values import ALL_SENSORS, KindName, Range

PlantKind = Literal["nominal", "drawn", "worst", "slow_brake"]
CommandName = Literal[
    "start", "pause", "resume", "emergency_stop", "reset", "manual", "automatic", "confirm_clear", "nudge"
]


class ScenarioCommand(Config):
    """An operator command at a time after the start; a start or resume comes with a `confirm_clear`, right or wrong."""

    at_s: float = Field(ge=0.0, le=1e6)
    command: CommandName
    expires_s: float = Field(gt=0.0, le=600.0)
    is_confirmed: bool = Field(default=True, description="start and resume: the operator confirms that nobody is near")
    left_m: float | None = Field(default=None, ge=-1.0, le=1.0, description="nudge: shift of the line to the left")

    @model_validator(mode="after")
    def _has_its_parameter(self) -> Self:
        if (self.left_m is not None) != (self.command == "nudge"):
            raise ValueError("left_m belongs to a nudge, and to no other command")
        return self

    @property
    def kinds(self) -> tuple[OperatorCommandKind, ...]:
        """The kinds of the OperatorCommand messages, in their order."""
        kind = OperatorCommandKind[self.command.upper()]
        is_start = kind in (OperatorCommandKind.START, OperatorCommandKind.RESUME)
        return (OperatorCommandKind.CONFIRM_CLEAR, kind) if is_start and self.is_confirmed else (kind,)


class GnssEpisode(Config):
    """An interval in which the GNSS solution is no better than `state`."""

    from_s: float = Field(ge=0.0, le=1e6)
    for_s: float = Field(gt=0.0, le=1e6)
    state: Literal["none", "single", "rtk_float"]


class CameraEpisode(Config):
    """An interval in which the lens of every camera is covered or blurred."""

    from_s: float = Field(ge=0.0, le=1e6)
    for_s: float = Field(gt=0.0, le=1e6)
    state: Literal["blocked", "blurred"]


class _Encounter(Config):
    name: str = Field(min_length=1, max_length=40)
    expected_stops: int = Field(ge=0, le=1, description="stops that this encounter must cause")
    visible_to: tuple[KindName, ...] = Field(default=ALL_SENSORS, description="kinds of sensors that detect it")


class Crossing(_Encounter):
    """A person or animal that walks to the middle of the path as the machine approaches, stands and leaves opposite.

    It stands `arrival_margin_s` before an unslowed machine would arrive and `extra_stand_s` after.
    """

    kind: Literal["crossing"]
    swath_fraction: Range = Field(description="position along the swath, 0 start to 1 end")
    actor: Literal["person", "animal"]
    start_lateral_m: Range = Field(description="waiting point, from the edge of the swept width")
    skew_deg: Range = Field(description="walking direction against the perpendicular of the swath")
    walk_speed_mps: Range
    leave_speed_mps: Range
    arrival_margin_s: Range
    extra_stand_s: Range

    @property
    def label(self) -> ObstacleClass:
        """True obstacle class."""
        return ObstacleClass(self.actor)


class Parked(_Encounter):
    """A vehicle parked on a swath."""

    kind: Literal["parked"]
    swath_fraction: Range = Field(description="position along the swath, 0 start to 1 end")
    lateral_m: Range
    yaw_offset_deg: Range = Field(description="heading against the direction of the swath")

    @property
    def label(self) -> ObstacleClass:
        """True obstacle class."""
        return ObstacleClass.VEHICLE


class Bystander(_Encounter):
    """A person or animal that stands before a bay while the machine reverses towards it, then walks off.

    It stands `dock_distance_m` ahead of the bay's dock pose; it starts `start_lateral_m` beside that point (0: stands
    there from the start) when the machine's rear is `trigger_distance_m` away, and leaves to the other side.
    """

    kind: Literal["bystander"]
    actor: Literal["person", "animal"]
    bay: str
    dock_distance_m: Range
    lateral_m: Range
    start_lateral_m: Range
    trigger_distance_m: Range
    walk_speed_mps: Range
    stand_s: Range

    @property
    def label(self) -> ObstacleClass:
        """True obstacle class."""
        return ObstacleClass(self.actor)


Encounter = Annotated[Crossing | Parked | Bystander, Field(discriminator="kind")]


class Scenario(Config):
    """One scenario; the seed determines places, times and speeds drawn from its ranges."""

    name: str
    operator_commands: tuple[ScenarioCommand, ...]
    plant: PlantKind = "nominal"
    gnss: tuple[GnssEpisode, ...] = ()
    camera: tuple[CameraEpisode, ...] = ()
    encounters: tuple[Encounter, ...] = ()
    objects: tuple[ScenarioObject, ...] = ()
    environment: Environment | None = None
    faults: tuple[InjectedFault, ...] = ()

    @model_validator(mode="after")
    def _objects_fit(self) -> Self:
        check_objects(self.objects, tuple(e.name for e in self.encounters))
        return self

    @property
    def expected_stops(self) -> dict[str, int]:
        """Stops that each encounter and each object must cause, by its name."""
        return {e.name: e.expected_stops for e in (*self.encounters, *self.objects)}
