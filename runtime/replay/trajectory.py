"""Trajectory of a recorded vehicle: smoothed motion, and its driven line as paths."""

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.transforms import interpolate, invert, yaw_of
from messages.motion import MapPose, Odometry, PositionSource
from messages.plan import Path, PathSection, PathSectionType
from validation.obstacle_stop.recorded_motion import direction_of, last_curvature, turning_points
from validation.obstacle_stop.swept_path import arc

ODOM_NS = 20_000_000
STEP_M = 0.25
SMOOTH_S = 0.5
MIN_POSES = 3


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses (N, 4, 4) of base in a continuous frame at increasing stamps (N,), and motion (N, 5): forward and left
    speed, yaw rate, forward acceleration, and standard deviation of the forward speed, in SI units."""

    stamps_ns: Int64
    poses: Float64
    motion: Float64


@dataclass
class OdometrySamples:
    """Odometry messages of one topic as columns, which take a tenth of the memory of the messages."""

    stamps_ns: "array[int]" = field(default_factory=lambda: array("q"))
    values: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, message: Odometry) -> None:
        """Appends a message."""
        self.stamps_ns.append(message.stamp_ns)
        self.values.extend(message.T_odom_base.ravel().tolist())
        self.values.extend((message.speed_mps, message.lateral_mps))

    def by_stamp(self) -> tuple[Int64, Float64, Float64]:
        """Stamps (N,), poses (N, 4, 4), and forward and left speed (N, 2), sorted by stamp."""
        stamps = np.array(self.stamps_ns, np.int64)
        order = np.argsort(stamps, kind="stable")
        rows = np.array(self.values, np.float64).reshape(-1, 18)[order]
        return stamps[order], rows[:, :16].reshape(-1, 4, 4), rows[:, 16:]


def trajectory_of(samples: OdometrySamples, T_child_base: Float64, is_level_known: bool) -> Trajectory:
    """Trajectory from odometry of a frame fixed to the vehicle; projected to a plane without a gravity reference.

    Poses with NaN or a repeated stamp are dropped.
    """
    stamps, child_poses, _ = samples.by_stamp()
    is_real = np.isfinite(child_poses).all(axis=(1, 2))
    stamps, child_poses = stamps[is_real], child_poses[is_real]
    is_new = np.diff(stamps, prepend=-1) > 0
    stamps = stamps[is_new]
    poses = np.array([T @ T_child_base for T in child_poses[is_new]]).reshape(-1, 4, 4)
    poses = poses if is_level_known else flattened(poses)
    return Trajectory(stamps, poses, motion_of(stamps, poses))


def flattened(poses: Float64) -> Float64:
    """Poses with the same steps projected to a plane: scan matching has no gravity reference, its tilt drifts."""
    out = [np.eye(4)] * len(poses)
    for k, (before, after) in enumerate(pairwise(poses)):
        step = invert(before) @ after
        yaw = yaw_of(step)
        flat = np.eye(4)
        flat[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
        flat[:2, 3] = step[:2, 3]
        out[k + 1] = out[k] @ flat
    return np.array(out).reshape(-1, 4, 4)


def steps_of(poses: Float64) -> Float64:
    """Cumulated forward, left and yaw steps (N, 3) since the first pose, each in its mean heading."""
    yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    d, middle = np.diff(poses[:, :2, 3], axis=0), 0.5 * (yaw[1:] + yaw[:-1])
    c, s = np.cos(middle), np.sin(middle)
    steps = np.column_stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]])
    summed = np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([summed, yaw - yaw[0]])


def motion_of(stamps_ns: Int64, poses: Float64) -> Float64:
    """Motion (N, 5) by a local parabola fit: scan matching has 2 cm of noise, which is 0.3 m/s over 0.1 s.

    The residuals of the fits give the standard deviation of the speed.
    """
    out, variance_factor, residuals = np.zeros((len(poses), 5)), np.zeros(len(poses)), []
    if len(poses) < 2:
        return out
    t = (stamps_ns - stamps_ns[0]) * 1e-9
    half_s = max(SMOOTH_S, 1.6 * float(np.median(np.diff(t))))
    summed = steps_of(poses)
    for k in range(len(t)):
        first, last = np.searchsorted(t, [t[k] - half_s, t[k] + half_s])
        first, last = min(first, max(0, last - MIN_POSES)), max(last, min(len(t), first + MIN_POSES))
        degree = min(2, last - first - 1)
        design = np.vander(t[first:last] - t[k], degree + 1, increasing=True)
        fit = np.linalg.lstsq(design, summed[first:last], rcond=None)[0]
        out[k, :3] = fit[1]
        out[k, 3] = 2.0 * fit[2, 0] if degree == 2 else 0.0
        variance_factor[k] = np.linalg.pinv(design.T @ design)[1, 1]
        free = last - first - degree - 1
        if free > 0:
            residuals.append(float(np.sum((summed[first:last, 0] - design @ fit[:, 0]) ** 2)) / free)
    out[:, 4] = np.sqrt(variance_factor * (float(np.median(residuals)) if residuals else 0.0))
    return out


def is_steady(samples: OdometrySamples, max_jump_m: float) -> bool:
    """Whether pose steps agree with the speeds to `max_jump_m`; GNSS without corrections jumps."""
    stamps, poses, speeds = samples.by_stamp()
    dt_s, speed_mps = np.diff(stamps) * 1e-9, np.hypot(*speeds.T)
    distance_m = np.hypot(*np.diff(poses[:, :2, 3], axis=0).T)
    off_m = np.abs(distance_m - 0.5 * (speed_mps[1:] + speed_mps[:-1]) * dt_s)
    return not ((dt_s < 1.0) & (off_m > max_jump_m)).any()  # a comparison with NaN is false


def sample_times(trajectory: Trajectory) -> Int64:
    """Stamps (N,) of the odometry of a trajectory: at 50 Hz and at every pose."""
    stamps = trajectory.stamps_ns
    return np.union1d(np.arange(stamps[0], stamps[-1], ODOM_NS, dtype=np.int64), stamps)


def odometry_of(trajectory: Trajectory) -> Iterator[Odometry]:
    """Odometry at the sample times of a trajectory of at least two poses."""
    stamps, sample_ns = trajectory.stamps_ns, sample_times(trajectory)
    after = np.clip(np.searchsorted(stamps, sample_ns), 1, len(stamps) - 1)
    for stamp_ns, k in zip(sample_ns.tolist(), after.tolist(), strict=True):
        share = (stamp_ns - stamps[k - 1]) / max(int(stamps[k] - stamps[k - 1]), 1)
        T = interpolate(trajectory.poses[k - 1], trajectory.poses[k], float(share))
        motion = (1.0 - share) * trajectory.motion[k - 1] + share * trajectory.motion[k]
        yield _odometry(stamp_ns, T, motion)


def _odometry(stamp_ns: int, T: Float64, motion: Float64) -> Odometry:
    speed, lateral, turn, acceleration, sigma = motion.tolist()
    curvature = turn / speed if abs(speed) > 0.5 else 0.0
    covariance = np.diag([1e-4, 1e-4, 1e-4, max(1e-4, sigma**2), 1e-4, 1e-4])
    return Odometry(stamp_ns, T, speed, lateral, acceleration, turn, curvature, covariance)


def map_pose_of(odom: Odometry) -> MapPose:
    """Pose with `map` equal to `odom`."""
    return MapPose(
        odom.stamp_ns,
        np.eye(4),
        odom.T_odom_base.copy(),
        np.zeros((6, 6)),
        PositionSource.DEAD_RECKONING,
        0.0,
        0.0,
        True,
    )


@dataclass(frozen=True, eq=False)
class DrivenSection:
    """Interval of driving in one direction: its path, and the path positions (K,) at stamps (K,)."""

    path: Path
    stamps_ns: Int64
    s_m: Float64


def driven_sections(trajectory: Trajectory, extension_m: float) -> list[DrivenSection]:
    """Driven line as paths, forward and reverse, split at reversals; the last one is extended by `extension_m`."""
    ahead = steps_of(trajectory.poses)[:, 0]
    bounds = [*turning_points(ahead), len(ahead) - 1]
    return [
        _section(trajectory, np.arange(first, last + 1), number, extension_m if last == len(ahead) - 1 else 0.0)
        for number, (first, last) in enumerate(pairwise(bounds))
        if last > first
    ]


def _section(trajectory: Trajectory, run: Int64, number: int, extension_m: float) -> DrivenSection:
    stamps, poses = trajectory.stamps_ns[run], trajectory.poses[run]
    ahead = steps_of(poses)[:, 0]
    direction = direction_of(ahead)
    s = np.maximum.accumulate(np.maximum(direction * ahead, 0.0))
    yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    rows = np.column_stack([s, poses[:, 0, 3], poses[:, 1, 3], yaw])
    rows = rows[np.concatenate([[True], np.diff(s) > 1e-3])]
    curvature = last_curvature(stamps, direction * s, yaw)
    rows = np.vstack([rows, _continued(rows[-1], curvature, direction, extension_m)])
    if len(rows) < 2:
        rows = np.vstack([rows, _continued(rows[-1], 0.0, direction, STEP_M)])
    grid = np.append(np.arange(0.0, rows[-1, 0], STEP_M), rows[-1, 0])
    grid = grid[np.concatenate([[True], np.diff(grid) > 1e-6])]
    x, y, heading = (np.interp(grid, rows[:, 0], rows[:, k]) for k in (1, 2, 3))
    n = len(grid)
    path = Path(
        int(stamps[0]), number, direction, np.column_stack([x, y]), heading, direction * np.gradient(heading, grid),
        grid, np.ones(n), np.zeros(n, np.uint8), (PathSection(PathSectionType.LANE, -1, 0, n - 1),),
        np.zeros(n, np.int32), False,
    )  # fmt: skip
    return DrivenSection(path, stamps, s)


def _continued(row: Float64, curvature_radpm: float, direction: int, distance_m: float) -> Float64:
    """Rows (K, 4: distance, x, y, heading) that continue a row on a circle in the direction of driving."""
    ds = np.arange(STEP_M, distance_m + 0.5 * STEP_M, STEP_M)
    return np.column_stack([row[0] + ds, arc(row[1:], curvature_radpm, direction * ds)])
