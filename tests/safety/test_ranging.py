"""Ultrasonic and radar at their limits: echoes that repeat, what is kept, cycles that agree, places in base."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Mount, Radar, TrailedImplement, Ultrasonic, Vehicle
from geometry.pose2 import to_frame
from messages.motion import Odometry
from messages.perception import ObstacleClass, Track, Tracks
from messages.sensors import RadarScan, UltrasonicRange
from safety.config import SafetyConfig
from safety.sources.radar import RadarSource, confirmed, is_same, usable_detections
from safety.sources.ultrasonic import UltrasonicSource, cone_arc, ground_range_m, is_beyond, is_confirmed_by_track
from safety.zones.footprint import Footprint, footprint_of
from tests.safety.safety_world import START_NS

STILL = Odometry(START_NS, np.eye(4), 0.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))
SENSOR = Ultrasonic(mount=Mount(xyz_m=(3.5, 0.6, 0.7)), cone_deg=60.0, rate_hz=10.0, range_m=(0.25, 4.5),
                    range_sigma_m=0.01)  # fmt: skip
NONE = math.nan


def turned(roll_deg: float = 0.0, pitch_deg: float = 0.0, yaw_deg: float = 0.0) -> Ultrasonic:
    return SENSOR.model_copy(update={"mount": Mount(xyz_m=(3.5, 0.6, 0.7), rpy_deg=(roll_deg, pitch_deg, yaw_deg))})


def listen(
    config: SafetyConfig, ranges: list[float], speeds: Any = 0.0, every_ns: int = 100_000_000, **how: Any
) -> UltrasonicSource:
    source = UltrasonicSource("left", how.get("sensor", SENSOR), config.ultrasonic)
    for k, (range_m, speed) in enumerate(zip(ranges, np.broadcast_to(speeds, len(ranges)), strict=True)):
        source.update(
            UltrasonicRange(START_NS + k * every_ns, range_m), np.zeros(3), replace(STILL, speed_mps=float(speed))
        )
    return source


def is_confirmed(config: SafetyConfig, ranges: list[float], *args: Any, **how: Any) -> bool:
    return len(listen(config, ranges, *args, **how).echo_arc_odom_m) > 0


def test_an_ear_begins_with_nothing(config: SafetyConfig) -> None:
    source = listen(config, [])
    assert (source.name, source.stamp_ns, source.echo_arc_odom_m.shape) == ("left", None, (0, 2))
    assert listen(config, [1.0, 1.0]).stamp_ns == START_NS + 100_000_000


def test_echoes_count_from_the_dead_zone_to_the_reach(config: SafetyConfig) -> None:
    for range_m, counts in ((0.249, False), (0.25, True), (4.5, True), (4.501, False)):
        assert is_confirmed(config, [range_m] * 3) == counts, range_m
    ground = 0.9 * 0.7 / math.sin(math.radians(20.0))
    for further, counts in ((-0.001, True), (0.001, False)):
        assert is_confirmed(config, [ground + further] * 3, sensor=turned(pitch_deg=20.0)) == counts, further


def test_an_echo_fits_what_is_no_faster_than_a_walker(config: SafetyConfig) -> None:
    most = config.ultrasonic.gate_m + 0.1 * config.ultrasonic.max_object_speed_mps
    for side in (1, -1):
        for further, fits in ((-1e-6, True), (1e-6, False)):
            assert is_confirmed(config, [2.0, 2.0, 2.0 + side * (most + further)]) == fits, (side, further)


def test_the_machines_own_way_is_taken_off(config: SafetyConfig) -> None:
    assert is_confirmed(config, [4.0, 3.5, 3.0], 5.0)
    assert not is_confirmed(config, [4.0, 4.0, 4.0], 5.0)
    assert is_confirmed(config, [4.0, 3.0, 2.6], [0.0, 10.0, 4.0])  # each way by the speed at its end


def test_the_window_holds_five_measurements(config: SafetyConfig) -> None:
    assert is_confirmed(config, [2.0, 2.0, NONE, NONE, 2.0])
    assert not is_confirmed(config, [2.0, 2.0, NONE, NONE, NONE, 2.0])


def test_what_was_heard_is_kept_for_a_moment_and_in_the_dead_zone_for_long(config: SafetyConfig) -> None:
    for range_m, hold_ns in ((1.0, 500_000_000), (0.4, 10_000_000_000), (0.401, 500_000_000)):
        for later_ns, is_kept in ((0, True), (1000, False)):
            source = listen(config, [range_m] * 3)
            heard_ns = START_NS + 200_000_000
            source.update(UltrasonicRange(heard_ns + hold_ns + later_ns, NONE), np.zeros(3), STILL)
            assert (len(source.echo_arc_odom_m) > 0) == is_kept, (range_m, later_ns)
            assert source.echo_arc_odom_m.shape[1] == 2
    source.update(UltrasonicRange(heard_ns + hold_ns + 1_000_000_000, NONE), np.zeros(3), STILL)
    assert source.echo_arc_odom_m.shape == (0, 2)


def test_what_the_machine_came_to_or_left_is_kept_by_where_it_is_now(config: SafetyConfig) -> None:
    near = [1.0, 1.0, 1.0]
    assert is_confirmed(config, [*near, *[NONE] * 6], [0.0] * 3 + [2.0] * 6)
    assert not is_confirmed(config, [*near, *[NONE] * 6], [0.0] * 3 + [0.9] * 6)
    assert not is_confirmed(config, [4.0, 3.5, 3.0, *[NONE] * 6], [5.0] * 3 + [4.0] * 6)
    assert not is_confirmed(config, [0.3] * 3 + [NONE] * 6, [0.0] * 3 + [-1.0] * 6)


def test_speed_along_the_axis(config: SafetyConfig) -> None:
    source = UltrasonicSource("left", turned(yaw_deg=30.0), config.ultrasonic)
    odom = replace(STILL, speed_mps=2.0, lateral_mps=0.1, yaw_rate_radps=0.3)
    expected = math.cos(math.pi / 6) * (2.0 - 0.3 * 0.6) + math.sin(math.pi / 6) * (0.1 + 0.3 * 3.5)
    assert source._axis_mps(odom) == pytest.approx(expected)


def test_the_arc_lies_across_the_cone() -> None:
    sensor = turned(yaw_deg=90.0)
    angle = np.radians([-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0])
    expected = np.column_stack([3.5 - 2.0 * np.sin(angle), 0.6 + 2.0 * np.cos(angle)])
    assert cone_arc(2.0, sensor, sensor.mount.T_base_sensor) == pytest.approx(expected)
    leaning = turned(pitch_deg=60.0)
    assert cone_arc(2.0, leaning, leaning.mount.T_base_sensor)[3] == pytest.approx([3.5 + 1.0, 0.6])


def test_the_arc_is_put_where_the_machine_was(config: SafetyConfig) -> None:
    source = listen(config, [2.0, 2.0])
    pose = np.array([5.0, -2.0, 0.7])
    source.update(UltrasonicRange(START_NS + 200_000_000, 2.1), pose, STILL)
    assert source.echo_arc_odom_m == pytest.approx(to_frame(pose, cone_arc(2.1, SENSOR, SENSOR.mount.T_base_sensor)))


def test_an_axis_that_hardly_falls_meets_no_ground() -> None:
    for slope, expected in ((-1e-6, math.inf), (-2e-6, 3.5e5), (0.5, math.inf), (0.0, math.inf)):
        T = np.eye(4)
        T[2, 0], T[2, 3] = slope, 0.7
        assert ground_range_m(T) == pytest.approx(expected), slope


def track(x: float, y: float, size: tuple[float, float], yaw: float = 0.0, **changes: Any) -> Track:
    one = Track(1, ObstacleClass.UNKNOWN, 0.9, np.array([x, y, 0.6]), np.zeros(3), np.eye(4),
                np.array([*size, 1.2]), yaw, 0, START_NS, True, ("radar_front", "lidar_front"))  # fmt: skip
    return replace(one, **changes)


ARC = np.array([[3.0, -1.0], [3.2, 0.0], [3.0, 1.0]])


@pytest.mark.parametrize("size", [(3.0, 0.5), (0.5, 3.0), (0.1, 0.1)])
@pytest.mark.parametrize("yaw", [0.0, 0.6, -2.0, math.pi / 2])
def test_a_track_answers_whose_box_and_margin_hold_some_of_the_arc(size: tuple[float, float], yaw: float) -> None:
    c, s = math.cos(yaw), math.sin(yaw)
    for a, b, margin, answers in (
        (1, 0, 0.299, True), (1, 0, 0.301, False), (-1, 0, 0.299, True), (-1, 0, 0.301, False), (0, 1, 0.299, True),
        (0, 1, 0.301, False), (0, -1, 0.299, True), (0, -1, 0.301, False), (1, 1, 0.299, True), (1, 1, 0.301, False),
    ):  # fmt: skip
        along, across = a * (0.5 * size[0] + margin), b * (0.5 * size[1] + margin)
        x, y = 3.0 - (c * along - s * across), 1.0 - (s * along + c * across)
        assert is_confirmed_by_track(ARC[2:], Tracks(START_NS, (track(x, y, size, yaw),)), 0.3) == answers, (
            a,
            b,
            margin,
        )
    beside = track(3.0 + s * (0.5 * size[1] + 0.299), 1.0 - c * (0.5 * size[1] + 0.299), size, yaw)
    assert is_confirmed_by_track(ARC, Tracks(START_NS, (beside,)), 0.3)


def test_a_track_that_does_not_answer_hides_none_that_does() -> None:
    answers, away = track(3.0, 1.0, (0.2, 0.2)), track(30.0, 1.0, (0.2, 0.2))
    wide = replace(answers, size_m=np.array([1.1, 1.1, 0.5]))
    others = (away, replace(answers, is_confirmed=False), wide, track(3.0, 2.0, (0.2, 0.2)),
              replace(answers, sensors=("ultrasonic_left", "camera_front")))  # fmt: skip
    assert not is_confirmed_by_track(ARC, Tracks(START_NS, others), 0.3)
    assert is_confirmed_by_track(ARC, Tracks(START_NS, (*others, answers)), 0.3)
    assert not is_confirmed_by_track(ARC, None, 0.3)


def test_beyond_is_farther_than_the_reach_and_the_box() -> None:
    one = track(4.0, 6.0, (3.0, 4.0))
    for reach, is_far in ((0.0, False), (-0.001, True), (1.0, False)):
        assert is_beyond(one, 1.0, 2.0, reach) == is_far, reach


RADAR = Radar(mount=Mount(xyz_m=(1.0, 2.0, 0.5), rpy_deg=(0.0, 0.0, 90.0)), field_of_view_deg=120.0, rate_hz=20.0,
              range_m=(0.5, 60.0), range_sigma_m=0.1, azimuth_sigma_deg=1.0, doppler_sigma_mps=0.1)  # fmt: skip
AHEAD = RADAR.model_copy(update={"mount": Mount(xyz_m=(3.5, 0.0, 0.7))})
Row = tuple[float, ...]


def scan(*rows: Row, stamp_ns: int = START_NS) -> RadarScan:
    """Rows of range, azimuth, elevation, Doppler and cross-section."""
    return RadarScan(stamp_ns, *(column.copy() for column in np.array(rows, np.float64).reshape(-1, 5).T))


def test_a_detection_is_placed_in_base_with_its_speed_over_ground() -> None:
    odom = replace(STILL, speed_mps=2.0, lateral_mps=0.1, yaw_rate_radps=0.3)
    base, radial, rcs = usable_detections(scan((10.0, 0.2, 0.1, -1.5, 4.0)), RADAR, RADAR.mount.T_base_sensor, odom)
    line = np.array([-math.cos(0.1) * math.sin(0.2), math.cos(0.1) * math.cos(0.2), math.sin(0.1)])
    assert base == pytest.approx(np.array([(1.0, 2.0, 0.5) + 10.0 * line]))
    assert radial == pytest.approx([-1.5 + line[0] * (2.0 - 0.3 * 2.0) + line[1] * (0.1 + 0.3 * 1.0)])
    assert rcs.tolist() == [4.0]


def test_detections_within_range_and_view_are_used() -> None:
    half = math.radians(60.0)
    rows = [(0.5, half), (60.0, -half), (0.499, 0.0), (60.01, 0.0), (9.0, half + 1e-9), (9.0, -half - 1e-9)]
    used = usable_detections(
        scan(*((r, a, 0.0, 0.0, float(k)) for k, (r, a) in enumerate(rows))), RADAR, np.eye(4), STILL
    )
    assert used[2].tolist() == [0.0, 1.0]
    for column in range(5):
        for bad in (math.nan, math.inf, -math.inf):
            row = [9.0, 0.1, 0.2, 0.0, 1.0]
            row[column] = bad
            base, _, _ = usable_detections(scan(tuple(row)), RADAR, np.eye(4), STILL)
            assert len(base) == (column == 2), (column, bad)
            if column == 2:
                assert base[0] == pytest.approx([9.0 * math.cos(0.1), 9.0 * math.sin(0.1), 0.0])


@pytest.mark.parametrize("field", ["range_m", "azimuth_rad", "elevation_rad", "doppler_mps", "rcs_dbsm"])
def test_arrays_of_unequal_length_are_no_detections(field: str) -> None:
    broken = replace(scan((9.0, 0.0, 0.0, 0.0, 1.0)), **{field: np.zeros(3)})
    assert [part.shape for part in usable_detections(broken, RADAR, np.eye(4), STILL)] == [(0, 3), (0,), (0,)]


def test_a_cycle_is_the_same_when_ranges_and_dopplers_are() -> None:
    one = scan((9.0, 0.1, 0.0, 1.0, 2.0))
    assert is_same(one, replace(one, stamp_ns=1))
    assert not is_same(one, None)
    assert not is_same(one, replace(one, range_m=np.array([9.1])))
    assert not is_same(one, replace(one, doppler_mps=np.array([1.1])))
    assert not is_same(scan(), scan())


def cycle(*places: tuple[float, float], moves: bool = False) -> np.ndarray:
    return np.array([(x, y, 1.0 + x, float(moves), 10.0) for x, y in places])


def test_places_seen_in_enough_cycles_are_confirmed_by_their_mean(config: SafetyConfig) -> None:
    radar = config.radar.model_copy(update={"static_cycles": 2, "moving_cycles": 1})
    here, near, far = (0.0, 0.0), (0.8, 0.0), (0.81, 0.0)
    assert confirmed([], radar, 0.02).shape == (0, 4)
    assert confirmed([cycle(here)], radar, 0.02).shape == (0, 4)
    assert confirmed([cycle(here, near)], radar, 0.02).shape == (0, 4)  # two of one cycle
    assert confirmed([cycle(here), cycle(far)], radar, 0.02).shape == (0, 4)
    both = np.array([(0.4, 0.0, 1.4, 0.2 / math.sqrt(2.0))] * 2)
    assert confirmed([cycle(here), cycle(near)], radar, 0.02) == pytest.approx(both)
    aside = confirmed([cycle((2.0, 1.0)), cycle((2.0, 1.8)), cycle((9.0, 9.0))], radar, 0.02)
    assert aside == pytest.approx(np.array([(2.0, 1.4, 3.0, 0.2 / math.sqrt(2.0))] * 2))
    assert len(confirmed([cycle((3.0, 4.0), moves=True)], radar, 0.02)) == 1
    alone = confirmed([cycle((3.0, 4.0), moves=True), cycle((0.0, 4.0))], radar, 0.02)
    assert alone == pytest.approx(np.array([(3.0, 4.0, 4.0, 0.2)]))


@pytest.fixture
def footprint(vehicle: Vehicle) -> Footprint:
    return footprint_of(vehicle, None)


def take(
    config: SafetyConfig, footprint: Footprint, scans: list[RadarScan], pose: Any = (0.0, 0.0, 0.0)
) -> RadarSource:
    source = RadarSource("front", AHEAD, (0.25, 3.2), 0.15, config.radar)
    for one in scans:
        source.update(one, np.array(pose), STILL, footprint)
    return source


def again(row: Row, count: int = 5, every_ns: int = 50_000_000) -> list[RadarScan]:
    return [scan(row, stamp_ns=START_NS + k * every_ns) for k in range(count)]


def test_a_radar_begins_with_nothing(config: SafetyConfig, footprint: Footprint) -> None:
    source = take(config, footprint, [])
    assert (source.name, source.stamp_ns, source.hits.shape, source.is_frozen) == ("front", None, (0, 4), False)
    assert take(config, footprint, again((8.0, 0.0, 0.0, 0.0, 5.0))).stamp_ns == START_NS + 200_000_000


@pytest.mark.parametrize(("row", "counts"), [
    ((15.0, 0.0, 0.0, 0.0, -10.0), True), ((15.01, 0.0, 0.0, 0.0, -10.0), False),
    ((15.0, 0.0, 0.0, 0.0, -10.01), False), ((25.0, 0.0, 0.0, 0.5, -18.0), True),
    ((25.01, 0.0, 0.0, 0.5, -18.0), False), ((25.0, 0.0, 0.0, 0.5, -18.01), False),
    ((25.0, 0.0, 0.0, 0.499, 5.0), False), ((25.0, 0.0, 0.0, -0.5, -18.0), True),
    ((15.0, 1.0, 0.0, 0.0, -10.0), True), ((10.0, 0.0, math.asin(0.251), 0.0, 5.0), False),
    ((10.0, 0.0, math.asin(0.249), 0.0, 5.0), True), ((10.0, 0.0, math.asin(0.2501), 0.0, 5.0), False),
    ((10.0, 0.0, -math.asin(0.0449), 0.0, 5.0), True), ((10.0, 0.0, -math.asin(0.0451), 0.0, 5.0), False),
    ((12.0, 0.0, math.asin(2.49 / 12.0), 0.0, 5.0), True), ((12.0, 0.0, math.asin(2.51 / 12.0), 0.0, 5.0), False),
    ((0.5, 0.0, 0.0, 0.0, 5.0), True), ((0.51, 1.04, 0.0, 0.0, 5.0), True),
])  # fmt: skip
def test_a_detection_counts_by_strength_range_and_height(
    config: SafetyConfig, footprint: Footprint, row: Row, counts: bool
) -> None:
    assert (len(take(config, footprint, again(row)).hits) > 0) == counts


def test_a_detection_of_the_machine_itself_does_not_count(config: SafetyConfig, footprint: Footprint) -> None:
    inward = AHEAD.model_copy(update={"mount": Mount(xyz_m=(3.0, 0.0, 0.7))})
    for range_m, counts in ((0.64, False), (0.66, True)):
        source = RadarSource("front", inward, (0.25, 3.2), 0.15, config.radar)
        for one in again((range_m, 0.0, 0.0, 0.0, 5.0)):
            source.update(one, np.zeros(3), STILL, footprint)
        assert (len(source.hits) > 0) == counts, range_m


def test_nor_does_one_of_the_trailer_that_it_pulls(config: SafetyConfig, vehicle: Vehicle) -> None:
    wagon = TrailedImplement(
        kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
    )  # fmt: skip
    back = AHEAD.model_copy(update={"mount": Mount(xyz_m=(-1.3, 0.0, 0.7), rpy_deg=(0.0, 0.0, 180.0))})
    for curvature, counts in ((0.0, False), (0.2, True)):
        source = RadarSource("rear", back, (0.25, 3.2), 0.15, config.radar)
        for one in again((5.0, -0.2, 0.0, 0.0, 5.0)):
            source.update(one, np.zeros(3), replace(STILL, curvature_radpm=curvature), footprint_of(vehicle, wagon))
        assert (len(source.hits) > 0) == counts, curvature


def test_heights_at_the_limits_count(config: SafetyConfig, footprint: Footprint) -> None:
    for height, counts in (((0.7, 3.2), True), ((0.25, 0.7), True), ((0.71, 3.2), False), ((0.25, 0.69), False)):
        source = RadarSource("front", AHEAD, height, 0.15, config.radar)
        for one in again((8.0, 0.0, 0.0, 0.0, 5.0)):
            source.update(one, np.zeros(3), STILL, footprint)
        assert (len(source.hits) > 0) == counts, height


def test_hits_lie_in_odom_with_the_deviation_of_their_bearing(config: SafetyConfig, footprint: Footprint) -> None:
    hits = take(config, footprint, again((10.0, 0.3, 0.1, 0.0, 5.0)), (5.0, -2.0, 0.7)).hits
    flat = 10.0 * math.cos(0.1)
    place = to_frame(np.array([5.0, -2.0, 0.7]), np.array([[3.5 + flat * math.cos(0.3), flat * math.sin(0.3)]]))[0]
    sigma = math.radians(1.0) * flat / math.sqrt(5.0)
    assert hits == pytest.approx(np.array([(*place, 0.7 + 10.0 * math.sin(0.1), sigma)] * 5))


def test_cycles_are_remembered_for_a_time_and_a_number(config: SafetyConfig, footprint: Footprint) -> None:
    there = (8.0, 0.0, 0.0, 0.0, 5.0)
    for last_ns, counts in ((400_000_000, True), (400_001_000, False)):
        cycles = [*again(there, 4, 100_000_000), scan(there, stamp_ns=START_NS + last_ns)]
        assert (len(take(config, footprint, cycles).hits) > 0) == counts, last_ns
    for empty, counts in ((3, True), (4, False)):
        gone = [scan(stamp_ns=START_NS + 50_000_000 + k * 1_000_000) for k in range(empty)]
        assert (len(take(config, footprint, [*again(there, 5, 1_000_000), *gone]).hits) > 0) == counts, empty


def test_a_radar_is_frozen_after_five_repetitions_until_it_changes(config: SafetyConfig, footprint: Footprint) -> None:
    for count, is_frozen in ((5, False), (6, True), (9, True)):
        assert take(config, footprint, again((8.0, 0.0, 0.0, 0.0, 5.0), count)).is_frozen == is_frozen, count
    others = [*again((8.0, 0.0, 0.0, 0.0, 5.0), 6), *again((9.0, 0.0, 0.0, 0.0, 5.0), 5)]
    assert not take(config, footprint, others).is_frozen
