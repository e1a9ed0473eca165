"""Planar conversions between base, odom and map, and first-order deskewing."""

import math

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.pose2 import from_frame, to_frame
from messages.sensors import LidarScan


def deskew(scan: LidarScan, T_base_lidar: Float64, speed_mps: float, turn_radps: float) -> Float32:
    """Returns (N, 3) in base, motion-compensated to the stamp to first order."""
    p = scan.points_m @ T_base_lidar[:3, :3].T.astype(np.float32) + T_base_lidar[:3, 3].astype(np.float32)
    dt = scan.point_offset_s
    turn = dt * np.float32(turn_radps)
    x, y = p[:, 0] - turn * p[:, 1] + dt * np.float32(speed_mps), p[:, 1] + turn * p[:, 0]
    return np.column_stack([x, y, p[:, 2]]).astype(np.float32, copy=False)


def odom_pose_to_map(T_map_odom: Float64, pose: Float64) -> Float64:
    """Pose (3,) from odom to map."""
    yaw = math.atan2(T_map_odom[1, 0], T_map_odom[0, 0])
    xy = to_frame(np.array([T_map_odom[0, 3], T_map_odom[1, 3], yaw]), pose[None, :2])[0]
    return np.array([xy[0], xy[1], pose[2] + yaw])


def map_pose_to_odom(T_map_odom: Float64, poses: Float64) -> Float64:
    """Poses (N, 3) from map to odom."""
    yaw = math.atan2(T_map_odom[1, 0], T_map_odom[0, 0])
    xy = from_frame(np.array([T_map_odom[0, 3], T_map_odom[1, 3], yaw]), poses[:, :2])
    return np.column_stack([xy, poses[:, 2] - yaw])


def is_in_ring(xy_m: Float64, ring_m: Float64) -> np.ndarray:
    """Mask of the points (N, 2) inside a ring (K, 2), even-odd rule."""
    inside = np.zeros(len(xy_m), bool)
    for a, b in zip(ring_m, np.roll(ring_m, -1, axis=0), strict=True):
        crosses = (a[1] > xy_m[:, 1]) != (b[1] > xy_m[:, 1])
        rise = b[1] - a[1] if b[1] != a[1] else 1.0
        inside ^= crosses & (xy_m[:, 0] < a[0] + (xy_m[:, 1] - a[1]) / rise * (b[0] - a[0]))
    return inside
