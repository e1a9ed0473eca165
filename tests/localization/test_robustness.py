"""Judgement and rows of the benchmark of robustness."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.localization_faults import CASES, Draw, edited, lidar_motions
from benchmarks.localization_robustness import Row, judged, measured, table
from benchmarks.rows import append_row, rows_of
from geometry.transforms import invert
from messages.motion import LidarOdometry, MapPose, PositionSource
from messages.sensors import GnssFix
from tests.localization.harness import Run
from tests.localization.synthetic_drive import DATUM, START_NS, SensorErrors, drive

BY_NAME = {case.name: case for case in CASES}


def displaced(truth, level_m):
    """A run whose poses are 0.28 m off from 42 s for 10 s."""
    poses = []
    for k in range(20, 600):
        stamp_ns = START_NS + k * 100_000_000
        T = truth.at(stamp_ns)
        T[0, 3] += 0.28 if 420 <= k < 520 else 0.0
        poses.append(MapPose(stamp_ns, T, T, np.eye(6) * 1e-4, PositionSource.RTK_FIXED, level_m, 0.1, True))
    return Run([], poses, [], np.zeros(0), None, [])


def test_misleading_is_an_error_above_the_limit_at_a_lower_protection_level():
    truth = drive(62, sensor_errors=SensorErrors(seed=1))
    draw, case = Draw(1), BY_NAME["wrong fix 0.2 m 20 s"]
    row = judged(case, "open", 1, displaced(truth, 0.2), truth, draw, 0.1)
    assert np.allclose(row.misleading_s, [0.0, 10.0, 0.0, 0.0])  # 0.28 m at a level of 0.20 m
    assert math.isclose(row.max_error_m, 0.28)
    row = judged(case, "open", 1, displaced(truth, 0.3), truth, draw, 0.1)
    assert row.misleading_s == [0.0] * 4


def test_cases_change_what_they_name_while_they_last():
    truth, draw = drive(70, sensor_errors=SensorErrors(seed=1)), Draw(1)
    case = BY_NAME["wrong fix 1 m 20 s"]
    start_s, end_s = case.window_s(draw)
    for before, after in zip(truth.messages, edited(truth, case, draw), strict=True):
        if not isinstance(before[2], GnssFix):
            assert after is before or after == before
            continue
        points = [np.array(DATUM.to_map(f.latitude_rad, f.longitude_rad, f.height_m)) for f in (before[2], after[2])]
        is_within = start_s <= (before[2].stamp_ns - START_NS) * 1e-9 < end_s
        assert np.linalg.norm(points[1] - points[0]) == pytest.approx(1.0 if is_within else 0.0, abs=0.01)


def test_model_of_lidar_odometry_follows_the_truth():
    truth = drive(20, sensor_errors=SensorErrors(seed=1))
    for _, _, motion in lidar_motions(truth, 1, 20.0):
        assert isinstance(motion, LidarOdometry)
        true = invert(truth.at(motion.from_stamp_ns)) @ truth.at(motion.stamp_ns)
        assert np.linalg.norm((motion.T_from_to - true)[:3, 3]) < 0.05


def test_rows_are_read_again(tmp_path):
    row = measured(BY_NAME["clean"], "open", 1, 14.0)
    assert row.misleading_s == [0.0] * 4
    assert row.false_alarms == 0
    file = tmp_path / "rows.jsonl"
    append_row(file, row)
    (again,) = rows_of(file, Row)
    assert table([again]) == table([row])
    assert table([replace(row, max_error_m=9.0)]) != table([row])
