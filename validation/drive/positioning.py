"""Localization error against the estimated sigma."""

from dataclasses import dataclass

import numpy as np

from geometry.angles import wrap
from geometry.arrays import Float64, Int64
from geometry.transforms import yaw_of
from validation.drive.record import DriveRecord, stamps_of, true_poses


@dataclass(frozen=True)
class PositionError:
    """Per map pose: longitudinal, lateral and heading error, their estimated sigmas, and NEES, (N,) each."""

    stamp_ns: Int64
    along_m: Float64
    across_m: Float64
    heading_rad: Float64
    sigma_across_m: Float64
    sigma_heading_rad: Float64
    nees: Float64


def measure_position(record: DriveRecord) -> PositionError:
    """Errors against the truth interpolated to each pose; poses outside the time span of the truth are dropped."""
    truth = record.truth
    stamps = stamps_of(truth)
    poses = [p for p in record.poses if p.is_initialized and len(stamps) and stamps[0] <= p.stamp_ns <= stamps[-1]]
    true = true_poses(truth)
    true[:, 2] = np.unwrap(true[:, 2])
    at = np.array([p.stamp_ns for p in poses], np.int64)
    x, y, yaw = (np.interp(at - at[:1], stamps - at[:1], true[:, k]) if len(at) else np.empty(0) for k in range(3))
    rows = [_errors(p.T_map_base, p.covariance, *q) for p, *q in zip(poses, x, y, yaw, strict=True)]
    columns = np.array(rows, float).reshape(-1, 6).T
    return PositionError(at, *columns)


def _errors(T: Float64, covariance: Float64, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, ...]:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    dx, dy = T[0, 3] - x_m, T[1, 3] - y_m
    error = np.array([c * dx + s * dy, -s * dx + c * dy, wrap(yaw_of(T) - yaw_rad)])
    planar = covariance[np.ix_((3, 4, 2), (3, 4, 2))]
    nees = float(error @ np.linalg.solve(planar, error))
    return (*error, float(np.sqrt(planar[1, 1])), float(np.sqrt(planar[2, 2])), nees)
