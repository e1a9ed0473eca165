"""Camera: pixel rows of a removed object are interpolated from its left to its right neighbours."""

import math

import cv2
import numpy as np

from configs.vehicle import Camera
from geometry.arrays import UInt8
from geometry.transforms import apply, invert
from messages.sensors import CameraImage
from validation.obstacle_stop.boxes import Box

RECTANGLE_PX = 12
BESIDE_PX = 6
RANGE_M = 60.0  # evaluated range


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Half the field of view (rad) and the evaluated range (m)."""
    return math.atan(0.5 * camera.size_px[0] / camera.focal_px[0]), RANGE_M


def remove_object(image: CameraImage, box: Box, camera: Camera) -> CameraImage:
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
