"""Slow motion: velocity of a compact body by a straight line through its last lidar detections.

The filter allows for a body that starts to walk: its velocity remains uncertain by 0.4 to 0.6 m/s, and a slow one never
counts as moving. The centre of the box of a small body moves with the view by a few centimetres only, so a line through
one second of detections gives its velocity to 0.1 m/s.
"""

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Bool, Float64, Int64

KEPT, FITTED = 24, 12  # detections of a track, and those of a line
TRAVEL_S, TRAVEL = 1.5, 1.5  # within which a body goes on by how many times its length


class FittedMotionConfig(Config):
    """When a line through the last detections of a track is motion."""

    window_s: float = Field(gt=0.0, le=10.0)
    detections: int = Field(ge=3, le=KEPT, description="fewest")
    max_length_m: float = Field(gt=0.0, le=20.0, description="of a body; the visible part of a longer one changes")
    min_height_m: float = Field(ge=0.0, le=2.0, description="of a body; the visible part of a wire moves with the view")
    max_residual_m: float = Field(gt=0.0, le=1.0, description="root mean square in each axis")
    min_residual_m: float = Field(gt=0.0, le=1.0, description="assumed at least, for sigma")
    min_speed_mps: float = Field(gt=0.0, le=5.0)
    sigmas: float = Field(gt=0.0, le=20.0, description="of a speed that is motion")
    length_share: float = Field(ge=0.0, le=5.0, description="least distance, over the length of the body")


def remember(recent: tuple[Int64, Float64, Float64], stamp_ns: int, p_m: Float64, view: Float64) -> None:
    """Adds detections (T, 2) of tracks, with sensor and length (T, 2), in place to their stamps (T, K), places and
    views (T, K, 2); empty ones have stamp 0."""
    stamps_ns, places_m, views = recent
    for last in (stamps_ns, places_m, views):
        last[:, :-1] = last[:, 1:].copy()
    stamps_ns[:, -1], places_m[:, -1], views[:, -1] = stamp_ns, p_m, view


def length_in_view(recent_ns: Int64, recent_view: Float64, sensor: int, since_ns: int) -> Float64:
    """Length (T,) of tracks as a sensor saw them last, NaN where that was before a time."""
    is_its = (recent_view[:, :, 0] == sensor) & (recent_ns >= max(since_ns, 1))
    last = is_its.shape[1] - 1 - np.argmax(is_its[:, ::-1], axis=1)
    return np.where(is_its.any(axis=1), recent_view[np.arange(len(last)), last, 1], np.nan)


def has_travelled(recent_ns: Int64, recent_m: Float64, now_ns: int, now_m: Float64, length_m: Float64) -> Bool:
    """Whether tracks (T,), now at (T, 2), went on in both halves of the last `TRAVEL_S` by more than parts of a body
    of a length (T,) are apart: of which part each detection was does not matter then.
    """
    age_s = np.where(recent_ns > 0, (now_ns - recent_ns) * 1e-9, 2.0 * TRAVEL_S)
    rows = np.arange(len(recent_ns))
    first = np.argmax(age_s <= TRAVEL_S, axis=1)
    start_m, age = recent_m[rows, first], age_s[rows, first]
    middle_m = recent_m[rows, np.argmin(np.abs(age_s - 0.5 * age[:, None]), axis=1)]
    way = now_m - start_m
    distance_m = np.hypot(*way.T)
    along = way / np.maximum(distance_m, 1e-9)[:, None]
    halves_m = ((middle_m - start_m) * along).sum(axis=1), ((now_m - middle_m) * along).sum(axis=1)
    is_far = (distance_m > TRAVEL * length_m) & (np.minimum(*halves_m) > TRAVEL / 3.0 * length_m)
    return np.asarray(is_far & (age <= TRAVEL_S))


def fitted_motion(
    recent_ns: Int64, recent_m: Float64, since_ns: Int64, size_m: Float64, config: FittedMotionConfig
) -> tuple[Float64, Float64, Bool]:
    """Velocity (T, 2), its sigma (T,) in each axis, and whether that is motion (T,), of tracks of a size (T, 3)."""
    recent_ns, recent_m = recent_ns[:, -FITTED:], recent_m[:, -FITTED:]
    t = (recent_ns - recent_ns[:, -1:]) * 1e-9
    used = (recent_ns > 0) & (recent_ns >= since_ns[:, None]) & (t >= -config.window_s)
    n = used.sum(axis=1)
    share = used / np.maximum(n, 1)[:, None]
    t = np.where(used, t - (t * share).sum(axis=1, keepdims=True), 0.0)
    p = np.where(used[:, :, None], recent_m - (recent_m * share[:, :, None]).sum(axis=1, keepdims=True), 0.0)
    square = np.maximum((t**2).sum(axis=1), 1e-9)
    velocity = (t[:, :, None] * p).sum(axis=1) / square[:, None]
    residual = np.sqrt(((p - t[:, :, None] * velocity[:, None]) ** 2).sum(axis=1) / np.maximum(n - 2, 1)[:, None])
    sigma = np.maximum(residual.max(axis=1), config.min_residual_m) / np.sqrt(square)
    speed = np.hypot(*velocity.T)
    moves = (n >= config.detections) & (residual.max(axis=1) <= config.max_residual_m)
    length_m, height_m = size_m[:, 0], size_m[:, 2]
    moves &= (length_m <= config.max_length_m) & (height_m >= config.min_height_m)
    moves &= speed >= np.maximum(config.min_speed_mps, config.sigmas * sigma)
    moves &= speed * (t.max(axis=1) - t.min(axis=1)) >= config.length_share * length_m
    return velocity, sigma, moves
