"""From the dock into the yard and back without fixes under the roof: UWB and lidar map."""

import functools
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from configs.site import PoseConfig
from localization.dock_prior import DockPrior
from localization.lidar.map_localization import LidarMap
from localization.lidar.surface_map import SurfaceMap, faces_of, posts_of
from localization.localizer import Localizer
from localization.uwb.range_gate import RangeGate, consistent
from localization.uwb.window import RobustWeighting
from messages.motion import MapPose, Odometry, PositionSource
from messages.sensors import GnssSolution
from tests.localization.harness import StubInbox, configuration, errors, run
from tests.localization.synthetic_drive import DATUM, START_NS, SensorErrors, drive
from tests.localization.synthetic_shed import (
    UwbErrors,
    harrow,
    is_open,
    messages,
    out_and_back_drive,
    ranges,
    shed,
    simulate_scan,
    tagged,
)

CONFIG = configuration()
NARROW = shed().bay("narrow").dock
UWB_ERRORS = UwbErrors()


def driven(truth, uwb_errors=UWB_ERRORS, has_lidar=True, start=NARROW, change=lambda entry: entry, surveyed=None):
    """A run from the dock."""
    vehicle = tagged() if has_lidar else without_lidar()
    surveyed = surveyed or shed()
    node = Localizer(vehicle, DATUM, CONFIG, surveyed, start)
    rng, mapped = np.random.default_rng(0), None
    if has_lidar:
        lidar_map = LidarMap(tagged(), harrow(), surveyed, CONFIG.lidar_map)
        mapped = (
            lidar_map,
            lambda t: {s: simulate_scan(truth, t, s, rng) for s in ("front", "rear")} if t > START_NS + 2e8 else None,
        )
    kept = [m for m in map(change, messages(truth, uwb_errors)) if m is not None]
    return run(kept, localizer=node, lidar_map=mapped)


def without_lidar():
    v = tagged()
    return v.model_copy(update={"sensors": v.sensors.model_copy(update={"lidar": {}})})


@functools.cache
def out_and_back():
    truth = out_and_back_drive(NARROW, drive_s=16.0, speed_mps=0.7)
    return truth, driven(truth)


@functools.cache
def standstill():
    pose = (NARROW.x_m, NARROW.y_m, math.radians(NARROW.heading_deg))
    return drive(4.5, legs=[(9.0, 0.0, 0.0)], sensor_errors=SensorErrors(seed=2), begin=pose, is_flat=True)


def at_dock(e):
    return e.t_s > e.t_s[-1] - 8.0


def test_docking_accuracy_and_integrity() -> None:
    truth, result = out_and_back()
    e = errors(result, truth)
    m = at_dock(e)
    assert np.sqrt(np.mean(e.p_m[m, :2] ** 2)) < 0.01
    assert np.max(np.linalg.norm(e.p_m[m, :2], axis=1)) < 0.03
    assert np.degrees(np.max(np.abs(e.turn_rad[m, 2]))) < 0.2
    after = e.t_s > 6.0
    assert np.max(np.linalg.norm(e.p_m[after, :2], axis=1)) < 0.03
    assert np.mean(e.nees[after, 0]) < 1.5
    assert np.all(np.linalg.norm(e.p_m[:, :2], axis=1) < e.level_m)
    assert np.all(e.level_m[after] < 0.25)  # the supervisor limits speed above 0.3


def test_position_source() -> None:
    truth, result = out_and_back()
    poses = [p for p in result.poses if p.is_initialized]
    assert poses[0].stamp_ns < START_NS + 3_000_000_000
    assert math.isinf(poses[0].gnss_age_s)
    for p in poses:
        free = is_open(truth, p.stamp_ns)
        assert p.source in ((PositionSource.RTK_FIXED, PositionSource.UWB) if free else tuple(PositionSource)[3:])
    ages = np.array([p.uwb_age_s for p in poses])
    assert np.quantile(ages, 0.95) < 0.9  # keyframes wait 0.3 s for fixes and are 0.2 s apart
    assert np.max(ages) < 1.9  # four of six anchors blocked
    sources = {p.source for p in poses}
    assert sources == {PositionSource.UWB, PositionSource.RTK_FIXED}
    assert poses[-1].source is PositionSource.UWB
    assert poses[-1].gnss_age_s > 2.0


def test_odom_is_continuous_across_handover() -> None:
    truth, result = out_and_back()
    worst_m, worst_rad = 0.0, 0.0
    for a, b in itertools.pairwise(result.odom):
        step = np.linalg.inv(a.T_odom_base) @ b.T_odom_base
        true = np.linalg.inv(truth.at(a.stamp_ns)) @ truth.at(b.stamp_ns)
        off = np.linalg.inv(true) @ step
        worst_m = max(worst_m, float(np.linalg.norm(off[:2, 3])))
        worst_rad = max(worst_rad, abs(math.atan2(off[1, 0], off[0, 0])))
    assert worst_m < 1.5e-3  # of 14 mm a step: wheel noise of 1 cm/s and slip not known yet
    assert worst_rad < 5e-4


def test_map_alignment_rate_limit() -> None:
    _, result = out_and_back()
    poses = [p for p in result.poses if p.is_initialized and p.stamp_ns > START_NS + 6_000_000_000]
    for a, b in itertools.pairwise(poses):
        moved = np.linalg.inv(a.T_map_odom @ np.linalg.inv(a.T_map_odom) @ a.T_map_base) @ (
            b.T_map_odom @ np.linalg.inv(a.T_map_odom) @ a.T_map_base
        )
        assert np.linalg.norm(moved[:2, 3]) < 0.02
        assert abs(math.degrees(math.atan2(moved[1, 0], moved[0, 0]))) < 0.2


def test_accuracy_by_uwb_alone_with_blocked_anchor() -> None:
    """BD-5.2.2: 10 cm, 1 sigma."""
    truth = out_and_back_drive(NARROW, drive_s=12.0, speed_mps=0.7)
    result = driven(truth, UwbErrors(blocked_anchors=("north_west",)), has_lidar=False)
    e = errors(result, truth)
    covered = np.array([not is_open(truth, START_NS + round(t * 1e9)) for t in e.t_s]) & (e.t_s > 5)
    assert np.sqrt(np.mean(e.p_m[covered, :2] ** 2)) < 0.08
    assert np.all(np.linalg.norm(e.p_m[:, :2], axis=1) < e.level_m)


@pytest.mark.parametrize(
    ("start", "uwb_errors", "why"),
    [
        (shed().bay("wide").dock, UwbErrors(), r"of 6 UWB anchors agree"),
        (PoseConfig(x_m=NARROW.x_m + 1.5, y_m=NARROW.y_m, heading_deg=0.0), UwbErrors(), r"of 6 UWB anchors agree"),
        (NARROW, None, "no UWB ranges"),
    ],
)
def test_dock_not_confirmed_by_ranges(start, uwb_errors, why) -> None:
    result = driven(standstill(), uwb_errors, has_lidar=False, start=start)
    assert not any(p.is_initialized for p in result.poses)
    fault = next(f for f in result.faults if f.code == "localization.not_docked")
    assert fault.is_active
    assert why.replace(r"of 6", "of 6") in fault.text_en


def test_dock_confirmed_with_two_blocked_anchors() -> None:
    result = driven(
        standstill(), UwbErrors(reflected_ratio=0.0, blocked_anchors=("north_west", "yard_north")), has_lidar=False
    )
    assert result.poses[-1].is_initialized
    assert not [f for f in result.faults if f.code == "localization.not_docked" and f.is_active]


def displaced(x_m=0.8, y_m=-0.5, turn_deg=24.0):
    pose = (NARROW.x_m + x_m, NARROW.y_m + y_m, math.radians(NARROW.heading_deg + turn_deg))
    return drive(4.5, legs=[(9.0, 0.0, 0.0)], sensor_errors=SensorErrors(seed=2), begin=pose, is_flat=True)


@pytest.mark.parametrize("truth", [standstill(), displaced(), displaced(-0.9, 0.4, -28.0)])
def test_lidars_find_the_pose_in_the_shed(truth) -> None:
    """Displaced while it was off, UWB alone accepted the remembered pose: 1.1 m and 28 degrees wrong."""
    e = errors(driven(truth), truth)
    assert len(e.t_s)
    assert np.max(np.linalg.norm(e.p_m[:, :2], axis=1)) < 0.05
    assert np.degrees(np.max(np.abs(e.turn_rad[:, 2]))) < 0.5


def test_start_needs_lidars_and_ranges_that_agree() -> None:
    moved = {name: (x + 1.0, y, z) for name, (x, y, z) in shed().anchors.items()}
    result = driven(standstill(), surveyed=shed().model_copy(update={"anchors": moved}))
    assert not any(p.is_initialized for p in result.poses)
    assert "of 6 UWB anchors agree" in reasons(result)[-1]


def test_start_without_a_shed_around_names_the_lidars() -> None:
    other = shed().model_copy(update={"walls_m": (((1.0, -60.0), (-9.0, -60.0)),), "posts": ()})
    result = driven(standstill(), surveyed=other)
    assert not any(p.is_initialized for p in result.poses)
    assert "lie on the surveyed shed" in reasons(result)[-1]


def test_two_poses_that_fit_are_refused() -> None:
    """Nose first in the bay, the shed looks much the same from the other side of its back wall."""
    result = driven(displaced(turn_deg=180.0))
    assert not any(p.is_initialized for p in result.poses)
    assert "ambiguous: a pose" in reasons(result)[-1]


def reasons(result):
    return [f.text_en for f in result.faults if f.code == "localization.not_docked" and f.is_active]


def test_fixes_after_the_shed_are_awaited_without_an_alarm() -> None:
    _, result = out_and_back()
    assert not [f for f in result.faults if f.code == "gnss.refused"]


def test_reflected_fixes_beside_shed_have_no_effect() -> None:
    def mirrored(entry):
        arrival, topic, message = entry
        if topic != "gnss/main" or is_open(truth, message.stamp_ns, margin_m=2.5):
            return entry
        return arrival, topic, replace(message, latitude_rad=message.latitude_rad + 0.12 / 6.37e6)

    truth = out_and_back_drive(NARROW, drive_s=10.0, speed_mps=0.8)
    assert any(m[1] == "gnss/main" and mirrored(m) is not m for m in messages(truth))
    e = errors(driven(truth, change=mirrored), truth)
    assert np.max(np.linalg.norm(e.p_m[e.t_s > 6, :2], axis=1)) < 0.03
    float_only = errors(driven(truth, change=lambda m: floating(mirrored(m))), truth)
    assert np.max(np.linalg.norm(float_only.p_m[float_only.t_s > 6, :2], axis=1)) < 0.03


def floating(entry):
    arrival, topic, m = entry
    if topic != "gnss/main":
        return entry
    worse = replace(m, solution=GnssSolution.RTK_FLOAT, longitude_rad=m.longitude_rad + 0.3 / 4e6)
    return arrival, topic, replace(worse, sigma_enu_m=np.array([0.2, 0.2, 0.4]))


def test_no_uwb_topics_without_shed() -> None:
    node = Localizer(tagged(), DATUM, CONFIG)
    assert not [t for t in node.reads if t.startswith("uwb")]
    assert "uwb/roof" in Localizer(tagged(), DATUM, CONFIG, shed()).reads


@pytest.mark.parametrize(
    ("away_m", "has_sky_obstruction", "is_near_shed"),
    [(2.9, True, True), (3.1, False, True), (14.9, False, True), (15.1, False, False)],
)
def test_sky_obstruction_and_uwb_margins(away_m, has_sky_obstruction, is_near_shed) -> None:
    dock_prior = DockPrior(None, shed(), CONFIG.map_alignment.dock_prior)
    east, south = np.array(shed().outline_m).max(axis=0)[0], np.array(shed().outline_m).mean(axis=0)[1]
    place = np.array([east + away_m, south, 1.0])
    assert (dock_prior.has_sky_obstruction(place), dock_prior.is_near_shed(place)) == (
        has_sky_obstruction,
        is_near_shed,
    )
    assert not DockPrior(None, None, dock_prior.config).is_near_shed(place)


def test_inconsistent_range_messages_are_dropped() -> None:
    node = RangeGate(CONFIG.map_alignment.range_gate, tagged().sensors.uwb, shed().anchors)
    valid = ranges(standstill())[0][2]
    assert node.add(valid)
    assert not node.add(replace(valid, tag="other"))
    assert not node.add(replace(valid, range_m=valid.range_m[:3]))


@pytest.mark.parametrize("late_m", [0.6, 1.0, 5.0])
def test_reflected_range_is_rejected_and_common_error_is_not(late_m) -> None:
    weighting = RobustWeighting(1.0, 2.5, 4.0)
    S = 0.07**2 * np.eye(6) + 0.2**2 * np.ones((6, 6))
    assert np.all(consistent(np.full(6, 0.5), S, weighting, 0.35) > 0.35)
    off = np.full(6, 0.5)
    off[2] += late_m
    weight = consistent(off, S, weighting, 0.35)
    assert weight[2] == 0.0
    assert np.all(np.delete(weight, 2) > 0.35)


def test_short_and_long_range_limits() -> None:
    weighting, S = RobustWeighting(1.0, 2.5, 4.0), 0.07**2 * np.eye(4)
    for off_m, late_kept, early_kept in ((0.20, True, True), (0.30, False, True), (0.45, False, False)):
        one = np.array([0.0, off_m, 0.0, 0.0])
        assert bool(consistent(one, S, weighting, 0.35)[1] > 0) is late_kept
        assert bool(consistent(-one, S, weighting, 0.35)[1] > 0) is early_kept


def test_wall_faces_and_normals() -> None:
    faces, posts = faces_of(shed()), posts_of(shed())
    assert len(faces) == 8  # three walls, both sides, and two ends
    assert np.allclose(np.linalg.norm(faces[:, 4:], axis=1), 1.0)
    back = faces[(np.abs(faces[:, 0] - faces[:, 2]) < 1e-9) & (np.abs(faces[:, 1] - faces[:, 3]) > 5)]
    assert sorted(np.round(back[:, [0, 4]], 3).tolist()) == [[-9.075, -1.0], [-8.925, 1.0]]
    assert len(posts) == len(shed().posts)
    assert faces_of(None).shape == (0, 6)
    assert posts_of(None).shape == (0, 3)


def lone_wall(n=400):
    """Points of one straight wall 4 m to the left of the origin."""
    rng = np.random.default_rng(1)
    p = np.column_stack([rng.uniform(-10, 10, n), 4 + rng.normal(0, 0.01, n), rng.uniform(0.5, 2, n)])
    return np.column_stack([p, np.zeros((n, 2))])


def test_learned_wall_constrains_across_only() -> None:
    surfaces = SurfaceMap(CONFIG.lidar_map.surfaces, None)
    assert surfaces.match(lone_wall(), np.zeros(3))[2] == 0
    for _ in range(CONFIG.lidar_map.surfaces.min_scans):
        surfaces.learn(lone_wall(), np.zeros(3))
    pose, covariance, found = surfaces.match(lone_wall(), np.array([0.0, 0.1, 0.01]))
    assert found > 300
    assert abs(pose[1]) < 0.01
    assert abs(pose[2]) < 0.002
    assert math.sqrt(covariance[0, 0]) > CONFIG.lidar_map.max_sigma_m
    assert math.sqrt(covariance[1, 1]) < 0.02


def test_two_faces_of_thin_wall_are_separate() -> None:
    surfaces, other = SurfaceMap(CONFIG.lidar_map.surfaces, None), lone_wall()
    other[:, 1] += 0.1
    other[:, 3:] = [0.0, 8.0]
    for _ in range(5):
        surfaces.learn(lone_wall(), np.zeros(3))
        surfaces.learn(other, np.zeros(3))
    assert abs(surfaces.match(lone_wall(), np.zeros(3))[0][1]) < 0.005


def test_full_table_drops_far_cells() -> None:
    small = CONFIG.lidar_map.surfaces.model_copy(update={"table_bits": 10, "keep_radius_m": 30.0})
    surfaces = SurfaceMap(small, None)
    for k in range(12):
        for _ in range(3):
            surfaces.learn(lone_wall(200), np.array([25.0 * k, 0.0, 0.0]))
    assert surfaces.match(lone_wall(200), np.array([25.0 * 11, 0.05, 0.0]))[2] > 100
    assert surfaces.match(lone_wall(200), np.zeros(3))[2] == 0


def test_lidar_localization_validity() -> None:
    truth, stamp = standstill(), START_NS + 1_000_000_000
    node = LidarMap(tagged(), harrow(), shed(), CONFIG.lidar_map)
    pair = simulate_scan(truth, stamp, "front", np.random.default_rng(0))
    still = [("odom", Odometry(stamp - ns, np.eye(4), 0, 0, 0, 0, 0, np.eye(6))) for ns in (200_000_000, 0)]

    def answer(T_map_odom, source=PositionSource.UWB):
        where = MapPose(stamp, T_map_odom, T_map_odom, np.eye(6), source, 1.0, math.inf, True, 0.1)
        box = StubInbox([("lidar/front", pair[0]), ("ground/front", pair[1]), ("map_pose", where)], still)
        return dict(node.step(stamp, box))["lidar_localization"]

    valid = answer(truth.at(stamp))
    assert valid.is_valid
    assert np.linalg.norm((np.linalg.inv(truth.at(stamp)) @ valid.T_map_base)[:2, 3]) < 0.02
    away = truth.at(stamp).copy()
    away[0, 3] += 200.0
    assert answer(away).reason.startswith("only 0 returns")
    assert not answer(away).is_valid
    unneeded = answer(away, PositionSource.RTK_FIXED)
    assert (unneeded.is_valid, unneeded.reason) == (False, "not needed")
