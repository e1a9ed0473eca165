"""Odometry of the last second for the pose at the time of a scan, and checks that poses and odometry are finite."""

import math
from collections import deque

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import Pose2
from messages.motion import MapPose, Odometry

KEEP_NS = 1_000_000_000
JUMP_M = 0.3


def planar_pose(T: Float64) -> Float64:
    """Level part (x, y, yaw) of a transform (4, 4)."""
    return np.array(Pose2.of(T))


def tilt_of(T: Float64) -> tuple[float, float]:
    """Roll and pitch of a transform (REP-103: pitch is positive nose down); NaN where it is not finite."""
    return math.atan2(T[2, 1], T[2, 2]), -math.asin(max(-1.0, min(1.0, T[2, 0]))) if T[2, 0] == T[2, 0] else math.nan


def valid_odometry(odom: Odometry | None) -> Odometry | None:
    """The odometry if all its values are finite, else None."""
    if odom is None:
        return None
    motion = odom.speed_mps + odom.yaw_rate_radps + odom.curvature_radpm + odom.acceleration_mps2
    return odom if math.isfinite(motion) and np.isfinite(odom.T_odom_base).all() else None


def valid_map_pose(pose: MapPose | None) -> MapPose | None:
    """The pose in map if its transform is finite, else None; an infinite protection level is valid."""
    return pose if pose is not None and np.isfinite(pose.T_map_odom).all() else None


class PoseHistory:
    """Poses of base in odom over the last second; `driven_m` is the distance driven since the first.

    `has_jumped`: the last one is farther from the one before than the speed explains.
    """

    def __init__(self) -> None:
        self.driven_m, self.has_jumped = 0.0, False
        self._poses: deque[tuple[int, Float64]] = deque()

    def add(self, odom: Odometry) -> None:
        """Adds the newest odometry; one that is not newer than the last is ignored."""
        pose, self.has_jumped = planar_pose(odom.T_odom_base), False
        if self._poses:
            stamp_ns, before = self._poses[-1]
            if odom.stamp_ns <= stamp_ns:
                return
            way_m = math.hypot(pose[0] - before[0], pose[1] - before[1])
            self.driven_m += way_m
            self.has_jumped = way_m > abs(odom.speed_mps) * (odom.stamp_ns - stamp_ns) * 1e-9 + JUMP_M
        self._poses.append((odom.stamp_ns, pose))
        while odom.stamp_ns - self._poses[0][0] > KEEP_NS:
            self._poses.popleft()

    def pose_at(self, stamp_ns: int) -> Float64:
        """Pose (3,) of base in odom nearest in time; raises ValueError before the first odometry."""
        if not self._poses:
            raise ValueError("the pose history is empty")
        best_ns, best = None, self._poses[-1][1]
        for known_ns, pose in reversed(self._poses):  # stamps increase, and requested stamps are recent
            away_ns = abs(known_ns - stamp_ns)
            if best_ns is not None and away_ns > best_ns:
                break
            best_ns, best = away_ns, pose
        return best
