"""Departure of what blocked the path, and the resume that depends on it."""

import numpy as np
import pytest

from configs.vehicle import MountedImplement, Vehicle
from geometry.arrays import Float64
from messages.command import Mode, OperatorCommandKind
from safety.supervisor_config import SupervisorConfig
from safety.zones.departure import Departure
from safety.zones.footprint import footprint_of
from safety.zones.protective_field import sweep_field
from safety.zones.swept_area import SweptArea
from tests.clause import clause
from tests.safety.safety_world import Box, World

HERE = np.zeros(3)


def hits(*places: tuple[float, float]) -> Float64:
    return np.array(places, np.float64).reshape(-1, 2)


@pytest.fixture(scope="session")
def area(vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig) -> SweptArea:
    footprint = footprint_of(vehicle, implement)
    return sweep_field(None, None, 0.0, 1, 8.0, 4.0, footprint, config.field).main


class Clocked(Departure):
    """Takes the hits of scans 0.1 s apart."""

    now_ns = 5_000_000_000

    def see(self, hits_m: Float64, area: SweptArea, pose: Float64 = HERE, scans: int = 1) -> None:
        for _ in range(scans):
            self.now_ns += 100_000_000
            self.update(hits_m, area, pose, self.now_ns)


@pytest.fixture
def departure(config: SupervisorConfig) -> Clocked:
    return Clocked(config.departure)


def test_nothing_blocked(departure: Clocked, area: SweptArea) -> None:
    departure.see(hits((6.0, 9.0)), area)
    assert not departure.is_unresolved


@pytest.mark.parametrize(("x", "y", "scans", "is_unresolved"), [
    (-0.8, 2.7, 1, False), (-0.8, 2.7, 3, True), (4.3, 0.0, 3, True), (4.8, 0.0, 3, False), (4.8, 0.0, 4, True),
])  # fmt: skip
def test_what_is_seen_for_a_moment_right_before_the_machine_has_not_left(
    departure: Clocked, area: SweptArea, x: float, y: float, scans: int, is_unresolved: bool
) -> None:
    """The front of the machine is at x = 3.5 m, that of the wings at -1.1 m: all before them is as near as they are."""
    departure.see(hits((x, y)), area, scans=scans)
    departure.see(hits(), area, scans=5)
    assert departure.is_unresolved == is_unresolved


def test_who_walks_out_has_left(departure: Clocked, area: SweptArea) -> None:
    departure.see(hits((6.0, 0.0)), area, scans=4)
    for k in range(60):
        departure.see(hits((6.0, 0.15 * k)), area)
        assert departure.is_unresolved == (0.15 * k < 4.2) or abs(0.15 * k - 3.9) < 0.4, k
    assert not departure.is_unresolved


def test_who_is_lost_in_the_path_has_not_left(departure: Clocked, area: SweptArea) -> None:
    departure.see(hits((6.0, 0.0), (9.0, 8.0)), area, scans=4)
    for _ in range(600):
        departure.see(hits((9.0, 8.0)), area)  # somebody else
    assert departure.is_unresolved
    departure.forget()
    assert not departure.is_unresolved


def test_a_jump_is_somebody_else(departure: Clocked, area: SweptArea, config: SupervisorConfig) -> None:
    departure.see(hits((6.0, 3.0)), area, scans=4)
    beyond = 3.0 + config.departure.follow_m + 0.01
    departure.see(hits((6.0, beyond + 2.0)), area)
    assert departure.is_unresolved


def test_lost_beside_the_path_within_the_distance(departure: Clocked, area: SweptArea) -> None:
    edge = max(body.half_width_m for body, _ in area.bodies)
    departure.see(hits((6.0, edge)), area, scans=4)
    departure.see(hits((6.0, edge + 0.55)), area)
    departure.see(hits(), area)
    assert departure.is_unresolved  # a step from the path, and lost


def test_the_path_turns_away(departure: Clocked, area: SweptArea) -> None:
    departure.see(hits((6.0, 0.0)), area, scans=4)
    assert departure.is_unresolved
    departure.see(hits((6.0, 0.0)), area, np.array([0.0, 0.0, np.pi]))
    assert not departure.is_unresolved


def test_returns_that_vanish_at_once_are_no_body(departure: Clocked, area: SweptArea) -> None:
    for _ in range(20):
        departure.see(hits((6.0, 0.0)), area, scans=2)
        assert not departure.is_unresolved
        departure.see(hits(), area, scans=3)
        assert not departure.is_unresolved
    departure.see(hits((6.0, 0.0)), area, scans=4)
    assert departure.is_unresolved


@clause("BD-5.2.4")
def test_one_of_two_who_is_lost_stays_when_the_other_walks_out(departure: Clocked, area: SweptArea) -> None:
    child, adult = (5.0, -2.0), (6.0, 1.0)
    departure.see(hits(child, adult), area, scans=4)
    departure.see(hits(adult), area, scans=4)
    assert departure.is_lost
    for k in range(40):
        departure.see(hits((6.0, 1.0 + 0.12 * k)), area)
    assert departure.is_lost
    departure.forget()
    departure.see(hits(child, adult), area, scans=4)
    for k in range(40):
        departure.see(hits((5.0, -2.0 - 0.12 * k), (6.0, 1.0 + 0.12 * k)), area)
    assert not departure.is_unresolved


@clause("BD-5.2.4")
@pytest.mark.parametrize("passes_m", [0.0, 0.9])
def test_who_comes_to_where_another_was_lost_and_leaves_is_not_them(
    departure: Clocked, area: SweptArea, passes_m: float
) -> None:
    departure.see(hits((6.0, 1.0)), area, scans=4)
    departure.see(hits(), area, scans=6)
    for y in np.arange(6.0, -6.0, -0.12):
        departure.see(hits((6.0 + passes_m, y)), area)
    assert departure.is_lost
    departure.see(hits((6.0, 1.0)), area)
    for y in np.arange(1.0, 6.0, 0.12):
        departure.see(hits((6.0, y)), area)
    assert not departure.is_unresolved  # who had lain there has stood up and left


def test_two_who_part_are_two(departure: Clocked, area: SweptArea) -> None:
    for k in range(20):
        departure.see(hits((6.0, -0.1 * k), (6.0, 0.1 * k)), area)
    departure.see(hits((6.0, 2.0)), area, scans=4)
    assert departure.is_lost
    for k in range(30):
        departure.see(hits((6.0, 2.0 + 0.12 * k)), area)
    assert departure.is_lost


def test_returns_of_a_scan_here_and_there_are_no_body(departure: Clocked, area: SweptArea) -> None:
    """Clutter that blocks all the time, in each scan elsewhere."""
    for k in range(30):
        departure.see(hits((5.0 + 2.5 * (k % 2), 3.0 * (k % 3 - 1))), area)
    departure.see(hits(), area, scans=5)
    assert not departure.is_unresolved


@clause("BD-5.2.4")
def test_resume_waits_for_a_confirmation_when_a_person_was_lost(world: World) -> None:
    world.start().run(3.0)
    world.boxes = (Box(world.x_m + 9.0, 0.0),)
    world.run(6.0)
    assert world.mode == Mode.OBSTACLE_STOP
    world.boxes = ()
    world.run(20.0)
    assert world.mode == Mode.OBSTACLE_STOP
    assert world.command.reason == "operator_command.unconfirmed"
    world.order(OperatorCommandKind.CONFIRM_CLEAR)
    world.run(5.0)
    assert world.mode == Mode.AUTOMATIC


@clause("BD-5.2.4")
def test_resume_after_a_person_was_seen_leaving(world: World) -> None:
    world.start().run(3.0)
    place = world.x_m + 9.0
    world.boxes = (Box(place, 0.0),)
    world.run(6.0)
    for k in range(40):
        world.boxes = (Box(place, 0.15 * k),)
        world.run(0.1)
    assert world.mode == Mode.OBSTACLE_STOP
    world.run(4.5)
    assert world.mode == Mode.AUTOMATIC


@clause("BD-5.2.4")
def test_a_post_beside_is_not_who_left(departure: Clocked, area: SweptArea) -> None:
    somebody, post = (5.0, 2.9), (5.0, 3.9)
    departure.see(hits(somebody, post), area, scans=8)
    departure.see(hits(post), area, scans=20)
    assert departure.is_unresolved
    departure.forget()
    departure.see(hits(somebody, post), area, scans=8)
    for k in range(12):
        departure.see(hits((5.0, 2.9 + 0.12 * k), post), area)
    assert not departure.is_unresolved


@clause("BD-5.2.4")
def test_who_was_lost_stays_there_while_another_path_leads_elsewhere(
    departure: Clocked, area: SweptArea, config: SupervisorConfig, vehicle: Vehicle, implement: MountedImplement
) -> None:
    back = sweep_field(None, None, 0.0, -1, 8.0, 4.0, footprint_of(vehicle, implement), config.field).main
    departure.see(hits((6.0, 0.0)), area, scans=8)
    assert (departure.is_unresolved, departure.is_lost) == (True, False)
    departure.see(hits(), back)
    assert (departure.is_unresolved, departure.is_kept) == (False, True)
    departure.see(hits(), area)
    assert (departure.is_unresolved, departure.is_lost) == (True, False)  # one scan may miss it
    departure.see(hits(), area)
    assert departure.is_lost
    for away_m, is_kept in ((-0.1, True), (0.1, False)):
        departure.see(hits(), back, np.array([6.0 - config.departure.kept_m - away_m, 0.0, 0.0]))
        assert departure.is_kept == is_kept, away_m
