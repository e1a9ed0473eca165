"""A scenario: what people, animals and vehicles do, what a person orders, and when satellites fail."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from configs.strict import Config
from messages.command import Order
from messages.perception import ObstacleClass


def _is_rising(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError(f"{value[0]} to {value[1]} is not a range")
    return value


Bound = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Range = Annotated[tuple[Bound, Bound], AfterValidator(_is_rising)]
OrderName = Literal["start", "pause", "resume", "emergency_stop", "reset", "manual", "automatic"]


class ScenarioOrder(Config):
    """A person presses something."""

    at_s: float = Field(ge=0.0, le=1e6)
    order: OrderName
    expires_s: float = Field(gt=0.0, le=600.0)

    @property
    def code(self) -> Order:
        """The order as it travels."""
        return Order[self.order.upper()]


class GnssEpisode(Config):
    """A time in which the receiver reaches no better than this state."""

    from_s: float = Field(ge=0.0, le=1e6)
    for_s: float = Field(gt=0.0, le=1e6)
    state: Literal["none", "single", "rtk_float"]


class _Encounter(Config):
    name: str = Field(min_length=1, max_length=40)
    stops: int = Field(ge=0, le=1, description="how many stops this must cause, stated beforehand")
    share: Range = Field(description="where along its swath, 0 start to 1 end")


class Crossing(_Encounter):
    """Somebody who walks to the middle of the way when the machine comes, stands, and leaves to the other side.

    `slack_s` is how long they stand before an unslowed machine would arrive, `wait_s` how much longer than that.
    """

    kind: Literal["crossing"]
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
    aside_m: Range
    turned_deg: Range = Field(description="against the direction of the swath")

    @property
    def label(self) -> ObstacleClass:
        """What it truly is."""
        return ObstacleClass.VEHICLE


Encounter = Annotated[Crossing | Parked, Field(discriminator="kind")]


class Scenario(Config):
    """What happens around the machine; the same seed draws the same places, times and speeds."""

    name: str
    orders: tuple[ScenarioOrder, ...]
    gnss: tuple[GnssEpisode, ...] = ()
    encounters: tuple[Encounter, ...] = ()

    @property
    def expected_stops(self) -> dict[str, int]:
        """How many stops each encounter must force, by its name."""
        return {e.name: e.stops for e in self.encounters}
