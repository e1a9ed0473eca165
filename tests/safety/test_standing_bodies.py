"""Standing bodies: how fast the machine passes a person or animal that stands beside its path."""

import math
from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import MountedImplement, Vehicle
from messages.perception import ObstacleClass, Track
from safety.stopping_distance import Braking, stopping_distance, stopping_time
from safety.supervisor_config import SupervisorConfig
from safety.zones.standing_bodies import NO_STANDING_BODY, Cover, StandingBodies
from safety.zones.tracked_obstacles import NO_CRITICAL_OBJECT
from tests.clause import clause
from tests.safety.safety_world import START_NS, around
from tests.safety.test_bystanders import HERE, WING_Y, person, swept

TOP_MPS = 10.0 / 3.6
BRAKING = Braking(0.6, 0.4, 2.5)

PLANTS_M = 0.35


@pytest.fixture
def bodies(config: SupervisorConfig) -> StandingBodies:
    return StandingBodies(config.standing_body)


@pytest.fixture
def slowest(bodies: StandingBodies, vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig):
    """Slowest body after one update with these tracks, each with whether it moves."""
    area = swept(vehicle, implement, config, 0.0)

    def update(*tracks, pose=HERE, now_ns=START_NS, braking=BRAKING, is_inside=None, plants=False):
        near = [(t, bool(t.velocity_mps.any())) for t in tracks if t.is_confirmed]
        around = Cover(PLANTS_M, tracks, np.eye(4)) if plants else None
        bodies.update(near, area, pose, braking, now_ns, is_inside, around)
        return bodies.slowest

    return update


@clause("BD-5.2.4", rule="standing_body")
@pytest.mark.parametrize("gap_m", [0.5, 2.0, 3.5, 4.5, 6.0])
def test_who_sets_off_meets_a_standing_machine(slowest, config: SupervisorConfig, gap_m: float) -> None:
    """Abeam of the wing: the machine stands before the body has crossed the gap, or is at its lowest speed."""
    found = slowest(person(-1.7, WING_Y + gap_m + 0.2, size=(0.4, 0.4, 1.7)))
    assert found.gap_m == pytest.approx(gap_m)
    needed_s = config.standing_body.notice_s + stopping_time(found.speed_mps, BRAKING)
    crosses_s = gap_m / config.standing_body.walk_mps
    if found.speed_mps > config.standing_body.min_mps:
        assert needed_s == pytest.approx(crosses_s)
    else:
        assert found.speed_mps == config.standing_body.min_mps
        assert needed_s >= crosses_s
    assert (found.speed_mps >= TOP_MPS) == (gap_m >= 5.0)


def test_approach_allows_a_stop_short_of_the_place(slowest, config: SupervisorConfig) -> None:
    speeds = []
    for ahead_m in np.arange(0.0, 11.0, 0.5):
        found = slowest(person(4.0 + ahead_m, WING_Y + 1.0))
        at_wing_m = ahead_m + 4.0 + 1.7 - 0.65 - 0.25  # before its front edge is abeam of that of the wing
        needed_m = config.standing_body.notice_s * found.speed_mps + stopping_distance(found.speed_mps, BRAKING)
        assert found.speed_mps == config.standing_body.min_mps or needed_m <= at_wing_m + 0.1
        speeds.append(found.speed_mps)
    assert speeds == sorted(speeds)
    assert speeds[0] < 2.0
    assert speeds[-1] > TOP_MPS


@pytest.mark.parametrize("changes", [
    {"label": ObstacleClass.VEHICLE}, {"label": ObstacleClass.UNKNOWN}, {"vy": -1.0}, {"age_s": 0.9}, {"y": 12.0},
])  # fmt: skip
def test_who_does_not_slow_the_machine(slowest, changes: dict) -> None:
    found = slowest(person(-1.7, **{"y": WING_Y + 2.0} | changes))
    assert found.speed_mps > TOP_MPS
    assert math.isfinite(found.speed_mps) == ("y" in changes)


def test_who_is_lost_from_view_stays_for_a_time(slowest, config: SupervisorConfig) -> None:
    first = slowest(person(1.0, WING_Y + 2.0))
    assert first.speed_mps < TOP_MPS
    for late_s in around(config.standing_body.hold_s, 0.01, 2):
        slowest(person(1.0, WING_Y + 2.0))
        kept = slowest(now_ns=START_NS + round(late_s * 1e9))
        assert kept == (first if late_s <= config.standing_body.hold_s else NO_STANDING_BODY), late_s


@clause("BD-5.2.4", rule="tracked_obstacle")
def test_who_is_lost_in_the_path_among_plants_stays(slowest, bodies, config: SupervisorConfig) -> None:
    """A person who lies down there is not seen: only a confirmation ends that, no time."""
    seen, ahead_m = person(9.0, 0.5), []
    for late_s in (0.0, *around(config.standing_body.lost_s, 0.01, 2), 2.0 * config.standing_body.hold_s):
        slowest(*([seen] if late_s == 0.0 else []), now_ns=START_NS + round(late_s * 1e9), plants=True)
        assert (bodies.hidden is NO_CRITICAL_OBJECT) == (late_s <= config.standing_body.lost_s), late_s
    for x in (0.0, 2.0, 4.0):
        slowest(pose=np.array([x, 0.0, 0.0]), now_ns=START_NS + 25_000_000_000, plants=True)
        ahead_m.append(bodies.hidden.clearance_m)
    assert bodies.hidden.label is ObstacleClass.PERSON
    assert bodies.hidden.id == seen.id
    assert ahead_m[0] - np.array(ahead_m) == pytest.approx([0.0, 2.0, 4.0], abs=0.26)
    assert slowest(now_ns=START_NS + 25_000_000_000, plants=True) is NO_STANDING_BODY  # which is for who stands beside
    bodies.forget_hidden()
    assert bodies.hidden is NO_CRITICAL_OBJECT
    slowest(now_ns=START_NS + 25_000_000_000, plants=True)
    assert bodies.hidden is NO_CRITICAL_OBJECT


@pytest.mark.parametrize(
    ("changes", "plants"), [({}, False), ({"y": WING_Y + 2.0}, True), ({"label": ObstacleClass.UNKNOWN}, True)]
)
def test_who_is_not_hidden_in_the_path(slowest, bodies, changes: dict, plants: bool) -> None:
    """Without plants low bodies are seen by the raw returns."""
    slowest(person(9.0, **{"y": 0.5} | changes), plants=plants)
    slowest(now_ns=START_NS + 2_000_000_000, plants=plants)
    assert bodies.hidden.clearance_m == math.inf


@pytest.mark.parametrize(("changes", "second", "expected"), [
    ({}, {}, True),
    ({}, None, False),  # seen in one scan
    ({"size": (0.7, 0.2, 0.4)}, {}, False),
    ({"label": ObstacleClass.AIRBORNE}, {}, False),
    ({}, {"x": 9.7}, False),  # moves
    ({}, {"is_confirmed": True}, True),
    ({}, {"is_confirmed": True, "age_s": 1.0}, False),  # and is left to the other rules
    ({"sensors": ("ultrasonic_front",)}, {}, False),
    ({"up_m": -0.2}, {}, False),  # hardly above the plants
])  # fmt: skip
def test_who_was_glimpsed_above_plants_may_lie_there(
    slowest, bodies, changes: dict, second: dict | None, expected: bool
) -> None:
    """A child who lies down is seen in two scans, or stands so shortly that its track is young."""

    def child(x: float = 9.0, age_s: float = 0.0, **more) -> Track:
        wanted = {"label": ObstacleClass.UNKNOWN, "size": (0.3, 0.2, 0.4), "is_confirmed": False} | changes | more
        flags = {name: wanted.pop(name) for name in ("is_confirmed", "sensors") if name in wanted}
        flags["p_odom_m"] = np.array([x, 0.5, 0.46 + wanted.pop("up_m", 0.0)])
        return replace(person(x, 0.5, age_s=age_s, stamp_ns=START_NS + round(age_s * 1e9), **wanted), **flags)

    slowest(child(), plants=True)
    if second is not None:
        slowest(child(**{"age_s": 0.1} | second), now_ns=START_NS + 100_000_000, plants=True)
    slowest(now_ns=START_NS + 2_000_000_000, plants=True)
    assert math.isfinite(bodies.hidden.clearance_m) == expected
    bodies.forget_hidden()
    slowest(now_ns=START_NS + 2_000_000_000, plants=True)
    assert bodies.hidden is NO_CRITICAL_OBJECT


def test_a_tuft_is_not_lost_among_plants(slowest, bodies) -> None:
    """What never rose above them is one of them."""
    for top_m in around(PLANTS_M, 0.01):
        bodies.forget_hidden()
        body = person(9.0, 0.5, size=(0.5, 0.2, 0.2), label=ObstacleClass.ANIMAL)
        slowest(replace(body, p_odom_m=np.array([9.0, 0.5, top_m - 0.1 + 1e-9])), plants=True)
        slowest(now_ns=START_NS + 2_000_000_000, plants=True)
        assert math.isfinite(bodies.hidden.clearance_m) == (top_m >= PLANTS_M), top_m


def test_nobody_is_glimpsed_outside_of_the_geofence(slowest, bodies) -> None:
    for age_s in (0.0, 0.1):
        small = replace(person(9.0, 0.5, age_s=age_s, size=(0.3, 0.2, 0.4)), is_confirmed=False)
        slowest(small, plants=True, is_inside=lambda points: points[:, 0] < 5.0)
    slowest(now_ns=START_NS + 2_000_000_000, plants=True)
    assert bodies.hidden is NO_CRITICAL_OBJECT


def test_who_is_far_away_is_not_hidden_for_ever(slowest, bodies, config: SupervisorConfig) -> None:
    hold_ns = round(config.standing_body.hold_s * 1e9)
    for apart_m in around(config.standing_body.reach_m, 0.01, 2):
        bodies.forget_hidden()
        body = person(9.0, 0.0, size=(0.0, 0.0, 1.7))
        slowest(body, plants=True)
        slowest(pose=np.array([9.0 + apart_m, 0.0, 0.0]), now_ns=START_NS + hold_ns + 1, plants=True)
        slowest(now_ns=START_NS + hold_ns + 1, plants=True)
        assert (bodies.hidden is NO_CRITICAL_OBJECT) == (apart_m > config.standing_body.reach_m), apart_m


def test_class_that_changes_and_body_that_sets_off(slowest) -> None:
    first = slowest(person(1.0, WING_Y + 2.0))
    assert slowest(person(1.0, WING_Y + 2.0, label=ObstacleClass.MOUND)) == first
    assert slowest(person(1.0, WING_Y + 2.0, vy=-1.0)) is NO_STANDING_BODY  # left to `tracked_obstacles`


def test_passed_body_no_longer_slows_the_machine(slowest) -> None:
    body = person(1.0, WING_Y + 1.0)
    speeds = [slowest(body, pose=np.array([x, 0.0, 0.0])).speed_mps for x in (-15.0, 0.0, 2.0, 12.0)]
    assert speeds[1] == speeds[2] == min(speeds)
    assert speeds[0] > TOP_MPS
    assert speeds[3] > TOP_MPS


@pytest.mark.parametrize("edge_m", around(WING_Y + 2.2, 0.01, 2))
def test_outside_of_the_geofence_nobody_stands(slowest, edge_m: float) -> None:
    found = slowest(person(1.0, WING_Y + 2.0), is_inside=lambda points: points[:, 1] < edge_m)
    assert (found is NO_STANDING_BODY) == (edge_m <= WING_Y + 2.2)


def test_the_slowest_of_several_counts(slowest) -> None:
    near, far = person(-1.7, WING_Y + 3.7, id=1), person(-1.7, -WING_Y - 4.7, id=2, label=ObstacleClass.ANIMAL)
    assert slowest(far).label is ObstacleClass.ANIMAL
    assert slowest(far, near).label is ObstacleClass.PERSON


def test_without_brakes_only_the_lowest_speed(slowest, config: SupervisorConfig) -> None:
    assert slowest(person(4.0, WING_Y + 1.0), braking=Braking(0.6, 0.4, 0.0)).speed_mps == config.standing_body.min_mps
