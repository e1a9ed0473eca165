"""Removal of an object from sensor data, to provoke a miss.

lidar       ranges of the object are replaced by those of the neighbouring columns
camera      pixel rows of the object are interpolated from its left to its right neighbours
radar       detections at the object are deleted
ultrasonic  echoes from the object are deleted
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from configs.vehicle import Camera, Radar, Ultrasonic
from geometry.arrays import Float64, UInt8
from geometry.transforms import apply, invert
from messages.sensors import CameraImage, LidarScan, RadarScan, UltrasonicRange
from validation.obstacle_stop.boxes import Box

MARGIN_M = 0.5  # limbs, motion within a scan, and spread of radar detections
RECTANGLE_PX = 12
BESIDE_PX = 6


def remove_from_scan(scan: LidarScan, box: Box, T_base_lidar: Float64) -> LidarScan:
    """Scan without the returns in the box: they get the range measured beside the box in the same ring.

    The range is the larger of the medians of the nearest columns left and right, 0 without a return.
    """
    points = scan.points_m @ T_base_lidar[:3, :3].T.astype(np.float32) + T_base_lidar[:3, 3].astype(np.float32)
    # returns of the ground around the object stay
    ground_margin_m = box.center_m[2] - 0.5 * box.size_m[2] + 0.05
    mine = box.contains(points, MARGIN_M) & (points[:, 2] > ground_margin_m)
    if not mine.any():
        return scan
    if scan.ranges_mm.size == 0:
        return _turn_to_ground(scan, mine)
    ring, column = np.nonzero(scan.ranges_mm)
    ranges = scan.ranges_mm.copy()
    for r in np.unique(ring[mine]).tolist():
        ranges[r, column[mine & (ring == r)]] = range_behind(scan.ranges_mm[r], np.sort(column[mine & (ring == r)]))
    return replace(scan, ranges_mm=ranges, intensity=np.zeros(0, np.uint8))


def range_behind(row_mm: np.ndarray, columns: np.ndarray) -> int:
    """Range (mm) beside the columns of a ring: the larger median of both sides, 0 without returns."""
    n = len(row_mm)
    beside = (
        [int(row_mm[(columns[0] - k) % n]) for k in (2, 3, 4)],
        [int(row_mm[(columns[-1] + k) % n]) for k in (2, 3, 4)],
    )
    medians = [sorted(values)[1] for values in beside]
    return max(medians)


def _turn_to_ground(scan: LidarScan, gone: np.ndarray) -> LidarScan:
    """Moves the returns of a point list along their direction to the ground, at most 60 m away."""
    xyz = scan.xyz_m.copy()
    direction = xyz[gone] / np.maximum(np.linalg.norm(xyz[gone], axis=1, keepdims=True), 1e-6)
    xyz[gone] = direction * np.where(np.abs(direction[:, 2:]) > 1e-3, ground_range_m(direction), 60.0)
    return replace(scan, xyz_m=xyz.astype(np.float32))


def ground_range_m(direction: np.ndarray, height_m: float = 1.7, max_m: float = 60.0) -> np.ndarray:
    """Distance along each direction (N, 3) to level ground below the sensor, at most `max_m`, (N, 1)."""
    down = np.where(direction[:, 2:] < -math.sin(math.radians(0.5)), -direction[:, 2:], np.nan)
    range_m = np.nan_to_num(height_m / down, nan=max_m)
    return np.minimum(range_m, max_m)


def remove_from_radar(scan: RadarScan, box: Box, radar: Radar) -> RadarScan:
    """Cycle without the detections at the box, compared horizontally (radar elevation is inaccurate)."""
    level = scan.range_m * np.cos(scan.elevation_rad)
    p = np.column_stack([level * np.cos(scan.azimuth_rad), level * np.sin(scan.azimuth_rad), np.zeros(len(level))])
    at = np.asarray(apply(radar.mount.T_base_sensor, p)[:, :2], np.float64)
    keep = box.distance_m(at) > MARGIN_M
    columns = ("range_m", "azimuth_rad", "elevation_rad", "doppler_mps", "rcs_dbsm")
    return replace(scan, **{name: getattr(scan, name)[keep] for name in columns})


def remove_from_echo(echo: UltrasonicRange, box: Box, sensor: Ultrasonic) -> UltrasonicRange:
    """Measurement without the echo when the box is in the cone at its distance."""
    p = apply(invert(sensor.mount.T_base_sensor), np.column_stack([box.footprint_m(), np.full(25, box.center_m[2])]))
    away = np.hypot(p[:, 0], p[:, 1])
    is_in_cone = np.abs(np.arctan2(p[:, 1], p[:, 0])) <= 0.5 * math.radians(sensor.cone_deg) + np.arctan2(
        MARGIN_M, away
    )
    nearest, far = (f(away, initial=i, where=is_in_cone) for f, i in ((np.min, np.inf), (np.max, -np.inf)))
    is_mine = nearest - MARGIN_M <= echo.range_m <= far + MARGIN_M
    return replace(echo, range_m=math.nan) if is_mine else echo


def remove_from_image(image: CameraImage, box: Box, camera: Camera) -> CameraImage:
    """Image with the rectangle of the object interpolated from the pixels beside it."""
    corners = pixel_bounds(box, camera)
    if corners is None:
        return image
    left, top, right, bottom = corners
    bgr: UInt8 = image.bgr.copy()
    part = bgr[top:bottom]
    sides = [part[:, max(left - BESIDE_PX, 0) : left], part[:, right : right + BESIDE_PX]]
    means = [side.mean(axis=1) if side.shape[1] else None for side in sides]
    one, two = (m if m is not None else means[1 - k] for k, m in enumerate(means))
    if one is None or two is None:
        return image  # the object fills the image: no background to interpolate
    share = np.linspace(0.0, 1.0, right - left)[None, :, None]
    part[:, left:right] = np.round(one[:, None] * (1.0 - share) + two[:, None] * share).astype(np.uint8)
    return CameraImage(image.stamp_ns, bgr)


def pixel_bounds(box: Box, camera: Camera) -> tuple[int, int, int, int] | None:
    """Left, top, right and bottom pixel of a box with a margin; None outside the image."""
    x, y, z = (np.array([-0.5, 0.5]) * side for side in box.size_m)
    c, s = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
    corners = box.center_m + np.array([(c * a - s * b, s * a + c * b, h) for a in x for b in y for h in z])
    body = apply(invert(camera.mount.T_base_sensor), corners)
    if body[:, 0].min() < 0.1:
        return None
    optical = np.column_stack([-body[:, 1], -body[:, 2], body[:, 0]])
    (fx, fy), (cx, cy) = camera.focal_px, camera.center_px
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    zero = np.zeros(3)
    pixels = cv2.projectPoints(optical, zero, zero, K, np.array(camera.distortion))[0].reshape(-1, 2)
    low, high = pixels.min(axis=0) - RECTANGLE_PX, pixels.max(axis=0) + RECTANGLE_PX
    left, top = (int(v) for v in np.clip(low, 0, camera.size_px))
    right, bottom = (int(v) for v in np.clip(high, 0, camera.size_px))
    return (left, top, right, bottom) if left < right and top < bottom else None
