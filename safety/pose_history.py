"""Where the machine was when a scan was taken: the last odometry, kept for a moment."""

import math
from collections import deque

import numpy as np

from geometry.transforms import yaw_of
from messages.message import Float64
from messages.motion import MapPose, Odometry

KEEP_NS = 1_000_000_000


def planar_of(T: Float64) -> Float64:
    """Place and heading (x, y, yaw) of a pose."""
    return np.array([T[0, 3], T[1, 3], yaw_of(T)])


def tilt_of(T: Float64) -> tuple[float, float]:
    """Roll and pitch of a pose (REP-103: pitch is positive nose down); NaN where the pose is no number."""
    return math.atan2(T[2, 1], T[2, 2]), -math.asin(max(-1.0, min(1.0, T[2, 0]))) if T[2, 0] == T[2, 0] else math.nan


def valid_odometry(odom: Odometry | None) -> Odometry | None:
    """Odometry without a value that is no number, or None."""
    if odom is None:
        return None
    motion = odom.speed_mps + odom.yaw_rate_radps + odom.curvature_radpm + odom.acceleration_mps2
    return odom if math.isfinite(motion) and np.isfinite(odom.T_odom_base).all() else None


def valid_map_pose(pose: MapPose | None) -> MapPose | None:
    """A pose in map without a value that is no number, or None; an infinite protection level is a value."""
    return pose if pose is not None and np.isfinite(pose.T_map_odom).all() else None


def to_frame(pose: Float64, xy: Float64) -> Float64:
    """Points (N, 2) of a pose's own frame in the frame the pose is given in."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.column_stack([pose[0] + c * xy[:, 0] - s * xy[:, 1], pose[1] + s * xy[:, 0] + c * xy[:, 1]])


def from_frame(pose: Float64, xy: Float64) -> Float64:
    """Points (N, 2) of the frame a pose is given in, seen from the pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = xy[:, 0] - pose[0], xy[:, 1] - pose[1]
    return np.column_stack([c * dx + s * dy, c * dy - s * dx])


def seen_from(pose: Float64, x_m: float, y_m: float) -> tuple[float, float]:
    """As `from_frame`, of one point."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = x_m - float(pose[0]), y_m - float(pose[1])
    return c * dx + s * dy, c * dy - s * dx


class PoseHistory:
    """Odometry of the last second, and the way driven."""

    def __init__(self) -> None:
        self.driven_m = 0.0
        self._poses: deque[tuple[int, Float64]] = deque()

    def add(self, odom: Odometry) -> None:
        """Take the newest; one with an old stamp is left out."""
        pose = planar_of(odom.T_odom_base)
        if self._poses:
            stamp_ns, before = self._poses[-1]
            if odom.stamp_ns <= stamp_ns:
                return
            self.driven_m += math.hypot(pose[0] - before[0], pose[1] - before[1])
        self._poses.append((odom.stamp_ns, pose))
        while odom.stamp_ns - self._poses[0][0] > KEEP_NS:
            self._poses.popleft()

    def pose_at(self, stamp_ns: int) -> Float64:
        """Place and heading in odom nearest in time; raises ValueError before the first odometry."""
        if not self._poses:
            raise ValueError("the trail is empty")
        best_ns, best = None, self._poses[-1][1]
        for known_ns, pose in reversed(self._poses):  # stamps rise, and what is asked for is young
            away_ns = abs(known_ns - stamp_ns)
            if best_ns is not None and away_ns > best_ns:
                break
            best_ns, best = away_ns, pose
        return best
