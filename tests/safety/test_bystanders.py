"""Bystanders: who comes towards machine or implement from any side, and who has left."""

import math
from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import MountedImplement, Vehicle
from geometry.arrays import Float64
from messages.command import Mode, OperatorCommandKind
from messages.perception import ObstacleClass, Track, Tracks
from safety.stopping_distance import Braking
from safety.supervisor_config import SupervisorConfig
from safety.zones.bystanders import Bystanders, distance_to_bodies_m, nearest_track, place_of
from safety.zones.footprint import footprint_of
from safety.zones.machine_motion import MachineMotion
from safety.zones.swept_area import SweptArea, arc_poses, spaced, sweep_along
from safety.zones.tracked_obstacles import is_broad_mover
from tests.clause import clause
from tests.safety.safety_world import START_NS, WAGON, World, around

HERE = np.zeros(3)
WING_X, WING_Y = -1.7, 3.05  # on the left wing of the harrow, 6.1 m wide
PTO_STOP_S = 2.4
FLAT = Braking(0.6, 0.4, 2.5)


def person(
    x: float, y: float, vx: float = 0.0, vy: float = 0.0, id: int = 1, label: ObstacleClass = ObstacleClass.PERSON,
    age_s: float = 2.0, size: tuple[float, float, float] = (0.5, 0.4, 1.7), stamp_ns: int = START_NS,
) -> Track:  # fmt: skip
    covariance = np.diag([0.01, 0.01, 1e-6, 1e-6])
    return Track(id, label, 0.9, np.array([x, y, 0.8]), np.array([vx, vy, 0.0]), covariance, np.array(size), 0.0,
                 stamp_ns - round(age_s * 1e9), stamp_ns, True, ("lidar/front",))  # fmt: skip


@pytest.fixture
def area(vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig) -> SweptArea:
    return swept(vehicle, implement, config, 0.0)


def swept(vehicle: Vehicle, implement, config: SupervisorConfig, curvature: float) -> SweptArea:
    s = spaced(14.0, 0.4)
    footprint = footprint_of(vehicle, implement)
    return sweep_along(footprint, 1, s, arc_poses(curvature, 1, s), curvature, config.field, True)


@pytest.fixture
def bystanders(config: SupervisorConfig) -> Bystanders:
    return Bystanders(config.bystanders, config.tracked, PTO_STOP_S)


def at_rest(area: SweptArea) -> MachineMotion:
    return MachineMotion(area, HERE, 0.0, 0.0, FLAT)


def see(
    bystanders: Bystanders, area: SweptArea, *tracks: Track, speed_mps: float = 0.0, pose: Float64 = HERE,
    at_s: float = 0.0, yaw_rate_radps: float = 0.0,
) -> bool:  # fmt: skip
    """Whether somebody comes in three messages, of tracks that move as their velocity says."""
    for after_s in (0.0, 0.2, 0.4):
        stamp_ns = START_NS + round((at_s + after_s) * 1e9)
        take(
            bystanders, area, *tracks, speed_mps=speed_mps, pose=pose, stamp_ns=stamp_ns, yaw_rate_radps=yaw_rate_radps
        )
    return bystanders.coming is not None


def take(
    bystanders: Bystanders, area: SweptArea, *tracks: Track, speed_mps: float = 0.0, pose: Float64 = HERE,
    stamp_ns: int = START_NS, yaw_rate_radps: float = 0.0,
) -> None:  # fmt: skip
    moving = [track for track in tracks if track.velocity_mps.any()]
    near = tracks if speed_mps == 0.0 else ()
    machine = MachineMotion(area, pose, speed_mps, yaw_rate_radps, FLAT)
    bystanders.update(moving, (), near, Tracks(stamp_ns, tracks), machine, 2.0)


@pytest.mark.parametrize("label", [ObstacleClass.UNKNOWN, ObstacleClass.PERSON])
def test_a_track_has_to_come_for_two_messages(bystanders: Bystanders, area: SweptArea, label: ObstacleClass) -> None:
    found = []
    for vy, at_s in [(-1.6, 0.0), (-1.6, 0.02), (0.0, 0.1), (-1.6, 0.2), (-1.6, 0.3)]:
        one = person(WING_X, 5.5 - 1.6 * at_s, vy=vy, label=label)
        take(bystanders, area, one, stamp_ns=START_NS + round(at_s * 1e9))
        found.append(bystanders.coming is not None)
    assert found == [False, False, False, False, True]


def test_what_comes_slowly_has_to_have_moved(bystanders: Bystanders, area: SweptArea, config: SupervisorConfig) -> None:
    for k in range(8):
        take(bystanders, area, person(WING_X, 4.2 - 0.05 * k, vy=-0.5), stamp_ns=START_NS + k * 100_000_000)
        assert (bystanders.coming is not None) == (0.05 * k >= config.bystanders.min_coming_m - 1e-9), k


def test_distance_to_bodies(area: SweptArea) -> None:
    points = np.array([(WING_X, WING_Y + 1.0), (-3.7, 4.0), (0.0, 0.0), (9.0, 0.0), (WING_X + 3.6, WING_Y + 1.0)])
    travel = np.array([0.0, 0.0, 0.0, 0.0, 3.6])
    found = distance_to_bodies_m(points, area, travel)
    rear = min(body.rear_m for body, _ in area.bodies)
    front = max(body.front_m for body, _ in area.bodies)
    corner = math.hypot(max(0.0, rear + 3.7), 4.0 - WING_Y)
    assert found == pytest.approx([1.0, corner, 0.0, 9.0 - front, 1.0])
    beyond = distance_to_bodies_m(np.array([(WING_X + area.s_m[-1], WING_Y + 1.0)]), area, np.array([99.0]))
    assert beyond == pytest.approx([1.0])  # the sweep ends


def test_distance_to_bodies_in_a_turn(vehicle: Vehicle, config: SupervisorConfig) -> None:
    area = swept(vehicle, WAGON, config, 0.1)
    for k in (0, 10):
        for body, poses in area.bodies:
            x, y, yaw = poses[k]
            left = np.array([[x - math.sin(yaw) * 9.0, y + math.cos(yaw) * 9.0]])
            inside = np.array([[x, y]]) + 0.5 * body.front_m * np.array([[math.cos(yaw), math.sin(yaw)]])
            assert distance_to_bodies_m(inside, area, area.s_m[k : k + 1])[0] == 0.0 or body.rear_m > 0.0
            assert 0.0 < distance_to_bodies_m(left, area, area.s_m[k : k + 1])[0] <= 9.0 - body.half_width_m


@pytest.mark.parametrize(("x", "y", "vx", "vy"), [
    (WING_X, 6.0, 0.0, -1.5), (WING_X, -6.0, 0.0, 1.5), (-6.0, 0.0, 2.0, 0.0), (-5.0, 5.0, 1.5, -1.5),
])  # fmt: skip
def test_comes_from_every_side(
    bystanders: Bystanders, area: SweptArea, x: float, y: float, vx: float, vy: float
) -> None:
    assert see(bystanders, area, person(x, y, vx, vy))
    assert bystanders.is_near
    assert bystanders.coming is not None
    assert (bystanders.coming.clearance_m, bystanders.coming.id) == (0.0, 1)
    other = Bystanders(bystanders._config, bystanders._tracked, PTO_STOP_S)
    assert not see(other, area, person(x, y, -vx, -vy))  # goes away
    assert not see(other, area, person(x, y, vy, -vx))  # passes by
    assert not other.is_near


def test_reach_of_the_prediction(bystanders: Bystanders, area: SweptArea, config: SupervisorConfig) -> None:
    change_m = 0.5 * config.bystanders.turn_radps * 1.5 * 2.0**2
    reach_m = 0.2 + config.tracked.lateral_m + 2.0 * 1e-3 + change_m  # half of the box, margin, uncertainty after 2 s
    for y in around(WING_Y + 2.0 * 1.5 + reach_m, 0.02):
        assert see(bystanders, area, person(WING_X, y - 1e-6, vy=-1.5)) == (y <= WING_Y + 3.0 + reach_m + 1e-9), y


def test_the_machine_drives_into_a_slow_walker(bystanders: Bystanders, area: SweptArea) -> None:
    walker = person(2.5, WING_Y + 1.5, vy=-0.3)
    assert not see(bystanders, area, walker, speed_mps=0.0)  # in front of a wing that stands
    assert see(bystanders, area, walker, speed_mps=2.7)
    assert not see(bystanders, area, person(-6.0, 0.0, vx=2.7), speed_mps=2.7)  # follows at the same speed
    assert see(bystanders, area, person(-6.0, 0.0, vx=4.7), speed_mps=2.7)


def test_who_follows_the_wing_in_a_turn(
    vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig
) -> None:
    """At a constant velocity the wing, which moves on, is passed behind."""
    area, cyclist = swept(vehicle, implement, config, -0.2), person(-1.6, 5.4, vx=1.7, vy=-2.1)
    straight = config.bystanders.model_copy(update={"manoeuvre_mps2": 0.0, "turn_radps": 0.0})
    assert see(Bystanders(config.bystanders, config.tracked, PTO_STOP_S), area, cyclist, speed_mps=2.2)
    assert not see(Bystanders(straight, config.tracked, PTO_STOP_S), area, cyclist, speed_mps=2.2)
    away = person(-1.6, 5.4, vx=1.7, vy=0.3)
    assert not see(Bystanders(config.bystanders, config.tracked, PTO_STOP_S), area, away, speed_mps=2.2)


def test_who_runs_turns_faster(bystanders: Bystanders, config: SupervisorConfig) -> None:
    least, most = config.bystanders.manoeuvre_mps2, config.bystanders.max_manoeuvre_mps2
    for speed_mps, expected in ((0.0, least), (1.0, least), (3.0, 1.5), (4.0, most), (9.0, most)):
        assert bystanders._manoeuvre_mps2(person(0.0, 9.0, vx=speed_mps)) == pytest.approx(expected)
        cart = replace(person(0.0, 9.0, vx=speed_mps), label=ObstacleClass.VEHICLE)
        assert bystanders._manoeuvre_mps2(cart) == least


def test_who_runs_past_a_wing_and_turns_to_it(
    vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig
) -> None:
    """At its velocity the dog passes behind the wing, which moves on."""
    area, dog = swept(vehicle, implement, config, 0.0), person(-2.3, 6.4, vx=0.4, vy=-3.4)
    straight = config.bystanders.model_copy(update={"turn_radps": 0.0})
    assert see(Bystanders(config.bystanders, config.tracked, PTO_STOP_S), area, dog, speed_mps=1.5)
    assert not see(Bystanders(straight, config.tracked, PTO_STOP_S), area, dog, speed_mps=1.5)


def test_own_implement_is_no_bystander(bystanders: Bystanders, area: SweptArea, config: SupervisorConfig) -> None:
    for y in around(WING_Y + config.tracked.self_filter_m, 0.02):
        coming = see(bystanders, area, person(WING_X, y + 1e-6, vy=-1.0))
        assert coming == (y >= WING_Y + config.tracked.self_filter_m), y


def test_age_of_unclassified_tracks(bystanders: Bystanders, area: SweptArea, config: SupervisorConfig) -> None:
    for age_s in around(config.bystanders.min_unclassified_age_s, 0.05):
        one = person(WING_X, 5.5, vy=-1.5, label=ObstacleClass.UNKNOWN, age_s=age_s)
        see(bystanders, area, one)
        assert see(bystanders, area, one, at_s=0.1) == (age_s >= config.bystanders.min_unclassified_age_s), age_s
        assert see(bystanders, area, replace(one, label=ObstacleClass.ANIMAL))


@clause("BD-5.2.4")
def test_dust_that_loses_its_class_does_not_come(area: SweptArea, config: SupervisorConfig) -> None:
    age_s = config.bystanders.min_unclassified_age_s
    for later_s, comes in ((0.1, False), (age_s - 0.5, False), (age_s + 0.1, True)):
        bystanders = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
        cloud = person(WING_X, 5.0, vy=-1.5, label=ObstacleClass.AIRBORNE, age_s=9.0)
        take(bystanders, area, cloud)
        stamp_ns = START_NS + round(later_s * 1e9)
        for k in range(3):
            seen_ns = stamp_ns + k * 10**8
            one = replace(cloud, label=ObstacleClass.UNKNOWN, first_seen_ns=START_NS - 9 * 10**9, last_seen_ns=seen_ns)
            take(bystanders, area, one, stamp_ns=seen_ns)
        assert (bystanders.coming is not None) == comes


def test_stays_until_seen_away(bystanders: Bystanders, area: SweptArea, config: SupervisorConfig) -> None:
    away = config.bystanders.away_m + 0.2  # half of the box
    assert see(bystanders, area, person(WING_X, 5.0, vy=-1.5))
    for y in (4.0, WING_Y + 0.2, WING_Y + 1.0, WING_Y + away - 0.01):
        assert not see(bystanders, area, person(WING_X, y))
        assert bystanders.is_near, y
    see(bystanders, area, person(WING_X, WING_Y + away + 0.01))
    assert not bystanders.is_near


def test_who_came_to_the_machine_from_ahead_keeps_it_standing(
    bystanders: Bystanders, area: SweptArea, config: SupervisorConfig
) -> None:
    """As one who stands behind it after it reversed, when it then drives forward."""

    def come(label: ObstacleClass, speed_mps: float) -> bool:
        one = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
        for at_s in (0.0, 0.4):
            rider = person(7.0 - speed_mps * at_s, 0.0, vx=-speed_mps, label=label)
            one.update((), [rider], (), Tracks(START_NS + round(at_s * 1e9), (rider,)), at_rest(area), 2.0)
            assert one.coming is None
        stands = person(front_m + 0.5, 0.0)
        one.update((), (), (), Tracks(START_NS, (stands,)), at_rest(area), 2.0)
        is_near = one.is_near
        left = person(front_m + config.bystanders.away_m + 0.3, 0.0)
        one.update((), (), (), Tracks(START_NS, (left,)), at_rest(area), 2.0)
        assert not one.is_near
        return is_near

    front_m = max(body.front_m for body, _ in area.bodies)
    assert come(ObstacleClass.PERSON, 2.0)
    assert come(ObstacleClass.ANIMAL, 2.0)
    assert not come(ObstacleClass.VEHICLE, 2.0)
    assert not come(ObstacleClass.PERSON, -2.0)


def test_long_body_is_near_with_its_nearest_end(
    bystanders: Bystanders, area: SweptArea, config: SupervisorConfig
) -> None:
    calf = replace(person(WING_X, 6.0, vy=-2.0, size=(1.4, 0.4, 1.0)), yaw_rad=math.pi / 2)
    assert see(bystanders, area, calf)
    stands = np.array([WING_X, WING_Y + config.bystanders.away_m + 0.6, 0.5])
    see(bystanders, area, replace(calf, p_odom_m=stands, velocity_mps=np.zeros(3)))
    assert bystanders.is_near
    see(bystanders, area, replace(calf, p_odom_m=stands, velocity_mps=np.zeros(3), yaw_rad=0.0))
    assert not bystanders.is_near


def test_lost_beside_the_machine(bystanders: Bystanders, area: SweptArea, config: SupervisorConfig) -> None:
    somebody_else = person(20.0, 0.0, id=9)
    assert see(bystanders, area, person(WING_X, 4.0, vy=-1.5))
    for _ in range(50):
        see(bystanders, area, somebody_else)
        assert bystanders.is_near
    bystanders.update((), (), (), None, at_rest(area), 2.0)
    assert bystanders.is_near
    edge = 4.0 - 0.2 - WING_Y  # gap of the nearest side of the box
    for gap_m, is_near in ((-0.01, True), (0.01, False)):  # the machine has moved on to the right
        pose = np.array([0.0, edge - config.bystanders.lost_m - gap_m, 0.0])
        see(bystanders, area, somebody_else, pose=pose)
        assert bystanders.is_near == is_near, gap_m


def test_another_track_continues_a_lost_one(bystanders: Bystanders, area: SweptArea, config: SupervisorConfig) -> None:
    assert see(bystanders, area, person(WING_X, 4.0, vy=-1.5))
    see(bystanders, area, person(WING_X, 4.0 + config.bystanders.follow_m - 0.01, id=5, age_s=0.5))
    assert bystanders.is_near
    see(bystanders, area, person(WING_X, 9.0, id=5))
    assert not bystanders.is_near
    place = place_of(person(0.0, 0.0))
    far, near = person(0.9, 0.0, id=3), person(0.5, 0.0, id=4)
    assert nearest_track([far, near], place, 1.0) is near
    assert nearest_track([far], place, 0.8) is None
    assert nearest_track([], place, 9.0) is None


@clause("BD-5.2.4")
@pytest.mark.parametrize(("beside_m", "continues"), [(0.45, True), (0.8, False)])
def test_who_stood_beside_is_not_who_was_lost(
    bystanders: Bystanders, area: SweptArea, beside_m: float, continues: bool
) -> None:
    post = person(WING_X, 4.0 + beside_m, id=5, label=ObstacleClass.POLE)
    assert see(bystanders, area, person(WING_X, 4.0, vy=-1.5), post)
    see(bystanders, area, post, at_s=1.0)
    see(bystanders, area, replace(post, p_odom_m=np.array([WING_X, 9.0, 0.8])), at_s=2.0)
    assert bystanders.is_near != continues


@clause("BD-5.2.4")
def test_one_who_leaves_is_one_of_two(bystanders: Bystanders, area: SweptArea) -> None:
    assert see(bystanders, area, person(WING_X, 4.0, vy=-1.5), person(WING_X, 4.3, vy=-1.5, id=2))
    one = person(WING_X, 4.2, id=5, age_s=0.3)
    see(bystanders, area, one)
    see(bystanders, area, replace(one, p_odom_m=np.array([WING_X, 9.0, 0.8])))
    assert bystanders.is_near


@clause("BD-5.2.4")
def test_what_stands_at_the_machine_when_an_operator_confirms_is_nobody(
    bystanders: Bystanders, area: SweptArea, config: SupervisorConfig
) -> None:
    stone, dog = np.array([(-2.6, 0.0)]), np.array([(-2.6, 0.0), (-2.6, 0.5)])
    now_ns = START_NS
    for hits, is_near in ((stone, True), (stone, False), (dog, True)):
        for _ in range(2):
            bystanders.note_returns(hits, None, at_rest(area), None, now_ns)
            now_ns += round(config.bystanders.at_machine_s * 1e9)
        assert bystanders.is_near == is_near
        bystanders.forget_unseen()


@clause("BD-5.2.4")
def test_what_is_where_the_implement_unfolds_to(
    bystanders: Bystanders, area: SweptArea, config: SupervisorConfig
) -> None:
    somebody, folded = np.array([(WING_X, 3.0)]), replace(area, bodies=area.bodies[:1])
    for k, is_in_reach in enumerate((False, True)):
        bystanders.note_returns(
            somebody, None, at_rest(folded), area, START_NS + k * round(config.bystanders.at_machine_s * 1e9)
        )
        assert (bystanders.is_in_reach, bystanders.is_near) == (is_in_reach, False)
    bystanders.forget_unseen()  # a wing would still hit it
    assert bystanders.is_in_reach


def test_unconfirmed_track_continues_nobody(bystanders: Bystanders, area: SweptArea) -> None:
    assert see(bystanders, area, person(WING_X, 4.0, vy=-1.5))
    see(bystanders, area, replace(person(WING_X, 9.0), is_confirmed=False))
    assert bystanders.is_near


def test_confirmation_keeps_who_is_seen(bystanders: Bystanders, area: SweptArea) -> None:
    assert see(bystanders, area, person(WING_X, 4.0, vy=-1.5), person(-6.0, 0.0, vx=2.0, id=2))
    see(bystanders, area, person(WING_X, 4.0))
    bystanders.forget_unseen()
    assert bystanders.is_near
    see(bystanders, area, person(WING_X, 9.0))
    assert not bystanders.is_near  # the other one was forgotten
    assert see(bystanders, area, person(WING_X, 4.0, vy=-1.5))
    see(bystanders, area)
    bystanders.forget_unseen()
    assert not bystanders.is_near


@pytest.mark.parametrize(("speed_mps", "is_barred"), [(3.3, True), (1.5, False)])
def test_who_follows_the_machine_bars_the_pto_as_it_may_stop(
    area: SweptArea, config: SupervisorConfig, speed_mps: float, is_barred: bool
) -> None:
    one = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
    one.note_close([person(WING_X - 8.0, 0.0, vx=speed_mps)], at_rest(area).at_speed(2.8), START_NS)
    assert one.bars_pto(START_NS) == is_barred


def test_a_body_that_moves_near_the_machine_bars_the_pto(
    bystanders: Bystanders, area: SweptArea, config: SupervisorConfig
) -> None:
    near_m, hold_ns = 1.5 * PTO_STOP_S + 0.4, round(config.bystanders.pto_hold_s * 1e9)
    assert not bystanders.bars_pto(START_NS)
    for y in around(WING_Y + near_m + 0.2, 0.02):  # half of the box
        one = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
        one.note_close([person(WING_X, y, vx=1.0)], at_rest(area), START_NS)
        assert one.bars_pto(START_NS) == (y <= WING_Y + near_m + 0.2 + 1e-9), y
    clutter = person(WING_X, 4.0, vx=1.0, label=ObstacleClass.UNKNOWN, age_s=0.9)
    bystanders.note_close([clutter], at_rest(area), START_NS)
    assert not bystanders.bars_pto(START_NS)
    bystanders.note_close([clutter, person(WING_X, 4.0, vx=1.0)], at_rest(area), START_NS)
    bystanders.note_close([], at_rest(area), START_NS + hold_ns)
    assert bystanders.bars_pto(START_NS + hold_ns)
    assert not bystanders.bars_pto(START_NS + hold_ns + 1)


def test_who_runs_towards_the_implement_bars_the_pto_in_time(area: SweptArea, config: SupervisorConfig) -> None:
    """At the moment at which the PTO is barred they are still farther away than it takes to run down."""
    for speed_mps in (2.4, 3.2, 4.0):
        barred_m = 0.0
        for y in around(WING_Y + speed_mps * PTO_STOP_S + 0.2, 0.02):
            one = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
            one.note_close([person(WING_X, y, vy=-speed_mps)], at_rest(area), START_NS)
            barred_m = max(barred_m, y - WING_Y - 0.2) if one.bars_pto(START_NS) else barred_m
        assert barred_m >= speed_mps * PTO_STOP_S, speed_mps
        passing = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
        passing.note_close([person(WING_X, WING_Y + 7.0, vx=speed_mps)], at_rest(area), START_NS)
        leaving = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
        leaving.note_close([person(WING_X, WING_Y + 5.0, vy=speed_mps)], at_rest(area), START_NS)
        assert not passing.bars_pto(START_NS)
        assert not leaving.bars_pto(START_NS)


def walker(world: World, y: float, vy: float) -> tuple[Track, ...]:
    now = world.inbox.now_ns
    return (person(world.x_m + WING_X, world.y_m + y, vy=vy, stamp_ns=now, age_s=3.0),)


@clause("BD-5.2.4")
def test_no_start_beside_somebody_who_came(world: World) -> None:
    world.tracks = walker(world, 6.0, -1.5)
    world.order(OperatorCommandKind.AUTOMATIC)
    world.run(0.2)
    world.start().run(0.5)
    for y in (5.0, 4.0, 3.3):
        world.tracks = walker(world, y, -1.5)
        world.run(0.4)
    world.tracks = walker(world, 3.3, 0.0)
    world.run(8.0)
    assert world.mode == Mode.OBSTACLE_STOP
    assert world.speed_mps == 0.0
    world.order(OperatorCommandKind.CONFIRM_CLEAR)  # wrong: somebody is seen there
    world.run(6.0)
    assert world.mode == Mode.OBSTACLE_STOP
    world.tracks = walker(world, 6.0, 0.0)
    world.run(8.0)
    assert world.mode == Mode.AUTOMATIC


@clause("BD-5.2.4")
def test_stop_for_somebody_who_walks_into_a_wing(world: World) -> None:
    world.start().run(5.0)
    assert world.mode == Mode.AUTOMATIC
    assert world.speed_mps > 2.0
    assert world.command.is_pto_on
    world.tracks = (person(world.x_m + WING_X, 6.0, vx=2.5, stamp_ns=world.inbox.now_ns, age_s=3.0),)  # runs along
    world.run(0.1)
    assert world.mode == Mode.AUTOMATIC
    assert not world.command.is_pto_on
    for _ in range(2):
        one = person(world.x_m + WING_X + 2.0, 5.0, vx=1.0, vy=-2.0, stamp_ns=world.inbox.now_ns, age_s=3.0)
        world.tracks = (one,)
        world.run(0.1)
    assert world.mode == Mode.OBSTACLE_STOP


@pytest.mark.parametrize(("size", "vy", "late_s", "is_mover"), [
    ((2.9, 1.3, 1.2), -2.4, 0.0, True), ((2.9, 0.8, 0.8), -1.0, 0.0, True), ((2.9, 0.79, 1.2), -2.4, 0.0, False),
    ((2.9, 1.3, 0.79), -2.4, 0.0, False), ((2.9, 1.3, 1.2), -0.99, 0.0, False), ((2.9, 1.3, 1.2), -2.4, 0.26, False),
])  # fmt: skip
def test_a_broad_unclassified_track_that_moves_fast_may_be_a_vehicle(
    config: SupervisorConfig, size: tuple[float, float, float], vy: float, late_s: float, is_mover: bool
) -> None:
    one = person(WING_X, 6.0, vy=vy, label=ObstacleClass.UNKNOWN, size=size)
    assert is_broad_mover(one, START_NS + round(late_s * 1e9), config.tracked) == is_mover
    person_sized = person(WING_X, 6.0, vy=vy, size=size)
    assert not is_broad_mover(person_sized, START_NS, config.tracked)


def test_stop_for_a_vehicle_among_plants_that_comes_from_the_side(world: World) -> None:
    world.start().run(5.0)
    for _ in range(2):
        one = person(world.x_m + WING_X + 3.0, 6.5, vy=-2.4, stamp_ns=world.inbox.now_ns,
                     label=ObstacleClass.UNKNOWN, size=(2.9, 1.3, 1.2))  # fmt: skip
        world.tracks = (one,)
        world.run(0.1)
    assert world.mode == Mode.OBSTACLE_STOP


@pytest.mark.parametrize(("size", "label", "comes"), [
    ((0.8, 0.4, 2.3), ObstacleClass.UNKNOWN, True), ((0.8, 0.4, 2.31), ObstacleClass.UNKNOWN, False),
    ((0.8, 0.4, 2.4), ObstacleClass.PERSON, True), ((2.0, 0.9, 2.6), ObstacleClass.UNKNOWN, True),
])  # fmt: skip
def test_the_edge_of_a_wall_does_not_come(
    bystanders: Bystanders, area: SweptArea, size: tuple[float, float, float], label: ObstacleClass, comes: bool
) -> None:
    assert see(bystanders, area, person(WING_X, 5.0, vy=-1.5, label=label, size=size)) == comes


@clause("BD-5.2.4")
def test_who_arrives_by_place_alone_keeps_a_machine_at_rest(
    bystanders: Bystanders, area: SweptArea, config: SupervisorConfig
) -> None:
    behind = (
        WING_X - 0.7 - config.bystanders.away_m
    )  # a child who runs into the blind zone, of unknown velocity and class
    for at_s, x, is_near in ((0.0, behind, False), (0.1, behind + 0.5, False), (0.2, behind + 0.7, True)):
        child = person(x, 0.0, label=ObstacleClass.UNKNOWN, age_s=at_s, size=(0.1, 0.1, 0.1))
        take(bystanders, area, child, stamp_ns=START_NS + round(at_s * 1e9))
        assert (bystanders.is_near, bystanders.coming) == (is_near, None)
    take(bystanders, area, stamp_ns=START_NS + 10**9)
    bystanders.forget_unseen()
    assert not bystanders.is_near
    for x in (behind, behind + 0.7):  # while the machine moves its own motion brings it nearer
        take(bystanders, area, replace(child, p_odom_m=np.array([x, 0.0, 0.5])), speed_mps=1.0)
    assert not bystanders.is_near


def test_goods_side_by_side_do_not_arrive_as_their_box_grows(bystanders: Bystanders, area: SweptArea) -> None:
    """Seen as one body or as two from scan to scan, beside the machine in its shed."""
    one = person(WING_X, WING_Y + 1.6, label=ObstacleClass.UNKNOWN, size=(0.6, 0.6, 0.7))
    both = replace(one, p_odom_m=np.array([WING_X, WING_Y + 1.1, 0.4]), size_m=np.array([0.8, 1.6, 0.8]))
    turned = replace(both, size_m=np.array([1.6, 0.8, 0.8]), yaw_rad=0.5 * np.pi)
    for k, track in enumerate((one, both, one, turned)):
        take(bystanders, area, track, stamp_ns=START_NS + k * 10**8)
        assert not bystanders.is_near
    left = replace(both, p_odom_m=np.array([WING_X, WING_Y + 0.7, 0.4]), size_m=np.array([0.6, 0.6, 0.7]))
    take(bystanders, area, left, stamp_ns=START_NS + 10**9)
    assert bystanders.is_near


@clause("BD-5.2.4")
def test_what_is_right_at_a_machine_at_rest_keeps_it(
    bystanders: Bystanders, area: SweptArea, config: SupervisorConfig
) -> None:
    rear_m, least_ns = -2.4, round(config.bystanders.at_machine_s * 1e9)
    for gap_m, is_near in (
        (config.bystanders.at_machine_m + 0.01, False),
        (config.bystanders.at_machine_m - 0.01, True),
    ):
        dog = np.array([(rear_m - gap_m, 0.0)])
        for after_ns in (0, least_ns - 1):
            bystanders.note_returns(dog, None, at_rest(area), None, START_NS + after_ns)
            assert not bystanders.is_near
        bystanders.note_returns(dog, None, at_rest(area), None, START_NS + least_ns)
        assert (bystanders.is_near, bystanders.bars_pto(START_NS + least_ns)) == (is_near, is_near)
    fenced = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
    for after_ns in (0, least_ns):  # the fence of the field
        fenced.note_returns(dog, lambda points: np.zeros(len(points), bool), at_rest(area), None, START_NS + after_ns)
        assert not fenced.is_near
    nothing = np.empty((0, 2))
    for after_ns, is_near in ((2 * least_ns, True), (2 * least_ns + 1, False)):  # one scan may miss it
        bystanders.note_returns(nothing, None, at_rest(area), None, START_NS + after_ns)
        assert bystanders.is_near == is_near


@clause("BD-5.2.4")
def test_who_follows_reaches_a_machine_that_brakes(area: SweptArea, config: SupervisorConfig) -> None:
    """Who keeps a distance, as on a road, brakes too."""
    for gap_m, v_mps, speed_mps, comes in (
        (3.5, 3.4, 1.5, True), (2.5, 1.6, 1.5, False), (4.9, 3.6, 2.2, True), (5.1, 3.6, 2.2, False),
        (4.0, 3.4, 3.2, False), (1.9, 3.4, 3.2, True),
    ):  # fmt: skip
        quad = person(-2.4 - gap_m - 0.2, 0.0, vx=v_mps, label=ObstacleClass.VEHICLE, size=(0.4, 1.0, 1.2))
        bystanders = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
        assert see(bystanders, area, quad, speed_mps=speed_mps) == comes, (gap_m, v_mps)


@clause("BD-5.2.4")
def test_who_is_behind_another_follower_reaches_that_one_first(area: SweptArea, config: SupervisorConfig) -> None:
    """The wind shield of a quad that keeps its distance seemed to come nearer (draw 12029)."""
    size = (0.4, 1.0, 1.2)
    for aside_m, front_m, comes in ((0.0, -6.9, False), (0.7, -6.9, True), (0.0, -5.0, True)):
        front = person(front_m, 0.0, vx=2.3, id=1, label=ObstacleClass.VEHICLE, size=size)
        back = person(-7.4, aside_m, vx=3.8, id=2, label=ObstacleClass.VEHICLE, size=size)
        bystanders = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
        assert see(bystanders, area, front, back, speed_mps=2.5) == comes, (aside_m, front_m)


@clause("BD-5.2.4")
def test_who_follows_through_a_turn(vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig) -> None:
    """A roe deer 1 m behind keeps its place while the machine turns at 5 m; one that crosses its track there passes."""
    area = swept(vehicle, implement, config, 0.2)
    deer, dust = ObstacleClass.ANIMAL, ObstacleClass.UNKNOWN
    body, gull = (0.4, 0.3, 0.5), (1.0, 0.3, 0.15)
    for at, velocity, label, size, comes in (
        ((-4.0, 1.0), (1.76, -1.6), deer, body, True),
        ((-4.0, 1.0), (1.76, 1.6), deer, body, False),  # crosses
        ((-4.0, 1.0), (1.76, -1.6), dust, body, False),
        ((-4.0, 1.0), (1.76, -1.6), deer, gull, False),
        ((0.0, -5.0), (4.4, 0.0), deer, body, False),  # beside the machine
    ):
        behind = person(*at, *velocity, label=label, size=size)
        bystanders = Bystanders(config.bystanders, config.tracked, PTO_STOP_S)
        assert see(bystanders, area, behind, speed_mps=2.2, yaw_rate_radps=0.44) == comes
