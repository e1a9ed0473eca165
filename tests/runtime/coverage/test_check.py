"""Driving is refused when a place is uncovered that a mission can reach."""

import pytest

from messages.errors import ConfigError
from runtime.coverage.check import require_coverage
from runtime.setup import load_setup


@pytest.mark.parametrize("mission", ["line", "line_reverse", "line_turn", "dock"])
def test_shipped_machine_may_drive(mission: str) -> None:
    setup = load_setup(mission, None, None, None, 1)
    require_coverage(setup.mission, setup.vehicle, setup.implement, setup.stack.planning, setup.stack.safety)


def test_places_beside_the_near_field_are_uncovered() -> None:
    """The ring around the raised harrow of 12 m is closed with the shipped width of the near field, open with 3 m."""
    setup = load_setup("line", None, "harrow_12m", None, 1)
    safety, planning = setup.stack.safety, setup.stack.planning
    require_coverage(setup.mission, setup.vehicle, setup.implement, planning, safety)
    narrow = safety.model_copy(update={"near_field": safety.near_field.model_copy(update={"aside_m": 3.0})})
    with pytest.raises(ConfigError, match="covers the place"):
        require_coverage(setup.mission, setup.vehicle, setup.implement, planning, narrow)


@pytest.mark.parametrize(
    ("gone", "state"), [("front_left", "working"), ("front_right", "working"), ("rear_near", "reversing")]
)
def test_machine_without_one_of_its_near_lidars_may_not(gone: str, state: str) -> None:
    setup = load_setup("line", None, None, None, 1)
    kept = {name: one for name, one in setup.vehicle.sensors.lidar.items() if name != gone}
    sensors = setup.vehicle.sensors.model_copy(update={"lidar": kept})
    vehicle = setup.vehicle.model_copy(update={"sensors": sensors})
    for _ in range(2):  # the second answer is kept from the first
        with pytest.raises(ConfigError, match=rf"covers the place .* m high while {state}"):
            require_coverage(setup.mission, vehicle, setup.implement, setup.stack.planning, setup.stack.safety)


def test_a_trailed_implement_is_not_driven() -> None:
    setup = load_setup("line", None, "disc_harrow_3m", None, 1)
    with pytest.raises(ConfigError, match=r"'disc harrow 3 m' is trailed: it is planned .*, not driven"):
        require_coverage(setup.mission, setup.vehicle, setup.implement, setup.stack.planning, setup.stack.safety)
