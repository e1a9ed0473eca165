"""Pose history, frames, and validity of odometry and pose."""

import math
from dataclasses import replace

import numpy as np
import pytest

from geometry.pose2 import from_frame, to_frame
from geometry.transforms import planar
from messages.motion import MapPose, Odometry, PositionSource
from safety.pose_history import PoseHistory, tilt_of, valid_map_pose, valid_odometry


def test_frames_and_pose_history() -> None:
    pose = np.array([3.0, -2.0, 0.7])
    points = np.array([[1.0, 2.0], [-4.0, 0.5]])
    assert from_frame(pose, to_frame(pose, points)) == pytest.approx(points)
    assert all(math.isnan(angle) or angle == 0.0 for angle in tilt_of(np.full((4, 4), np.nan)))
    for sine in (-1.0 - 1e-9, 1.0 + 1e-9):  # rounded
        upright = np.eye(4)
        upright[2, 0] = sine
        assert tilt_of(upright)[1] == pytest.approx(-math.copysign(math.pi / 2, sine))
    with pytest.raises(ValueError, match="empty"):
        PoseHistory().pose_at(0)


def odometry(stamp_ms: int, x_m: float, y_m: float, **changes: float) -> Odometry:
    T = planar(x_m, y_m, 0.5)
    return replace(Odometry(stamp_ms * 10**6, T, 1.0, 0.0, 0.0, 0.0, 0.0, np.eye(6)), **changes)


def test_driven_distance() -> None:
    pose_history = PoseHistory()
    assert pose_history.driven_m == 0.0
    for stamp, x, y in ((0, 1.0, 2.0), (500, 4.0, 6.0), (500, 9.0, 9.0), (400, 9.0, 9.0), (1000, 4.0, 5.0)):
        pose_history.add(odometry(stamp, x, y))
    assert pose_history.driven_m == 6.0
    assert tuple(pose_history.pose_at(0)) == pytest.approx((1.0, 2.0, 0.5))
    for stamp, y in ((-100, 2.0), (249, 2.0), (250, 2.0), (251, 6.0), (749, 6.0), (751, 5.0), (2000, 5.0)):
        assert pose_history.pose_at(stamp * 10**6)[1] == y, stamp
    pose_history.add(odometry(1001, 4.0, 5.0))  # what is more than a second old is forgotten
    assert pose_history.pose_at(0)[1] == 6.0


def test_non_finite_odometry_and_pose() -> None:
    good = odometry(0, 1.0, 2.0)
    assert valid_odometry(good) is good
    for name in ("speed_mps", "yaw_rate_radps", "curvature_radpm", "acceleration_mps2"):
        assert valid_odometry(replace(good, **{name: math.nan})) is None, name
    assert valid_odometry(replace(good, T_odom_base=np.full((4, 4), np.nan))) is None
    assert valid_odometry(None) is None
    pose = MapPose(0, np.eye(4), np.eye(4), np.eye(6), PositionSource.RTK_FIXED, math.inf, 0.1, True)
    assert valid_map_pose(pose) is pose
    assert valid_map_pose(replace(pose, T_map_odom=np.full((4, 4), np.nan))) is None
    assert valid_map_pose(None) is None


@pytest.mark.parametrize(("way_m", "has_jumped"), [(0.05, False), (0.31, False), (0.33, True)])
def test_jump(way_m: float, has_jumped: bool) -> None:
    """At 1 m/s, 20 ms after the last pose."""
    pose_history = PoseHistory()
    pose_history.add(odometry(0, 0.0, 0.0))
    pose_history.add(odometry(20, 0.0, way_m))
    assert pose_history.has_jumped == has_jumped
    pose_history.add(odometry(40, 0.0, way_m))
    assert not pose_history.has_jumped
