"""Returns in `base` at the stamp, without invalid returns and those of the machine itself."""

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Implement, Vehicle
from geometry.arrays import Float32, Float64, UInt8
from geometry.jit import kernel
from messages.motion import Odometry
from perception.lidar.grid import ZERO
from perception.self_filter import own_outline

MIN_RANGE_SQUARED_M2 = np.float32(1e-4)  # nearer returns lie at the sensor itself


class SelfFilterConfig(Config):
    """Margin around machine and implement inside which returns are dropped."""

    margin_m: float = Field(ge=0.0, le=1.0)
    implement_height_m: float = Field(gt=0.0, le=5.0)


def self_boxes(vehicle: Vehicle, implement: Implement | None, config: SelfFilterConfig) -> Float64:
    """Machine and implement as boxes in `base`, (K, 2, 3): lowest and highest corner, margin included."""
    flat = own_outline(vehicle, implement, config.margin_m)
    top = np.array([vehicle.body.height_m, config.implement_height_m])[: len(flat)] + config.margin_m
    heights = np.stack([np.full(len(flat), -np.inf), top], axis=1)
    return np.asarray(np.concatenate([flat, heights[:, :, None]], axis=2), np.float64)


def motion_of(odom: Odometry | None) -> tuple[float, float, float]:
    """Forward speed, left speed and yaw rate; zeros without odometry."""
    return (0.0, 0.0, 0.0) if odom is None else (odom.speed_mps, odom.lateral_mps, odom.yaw_rate_radps)


def to_base(
    points_m: Float32, offset_s: Float32, T_base_sensor: Float64, motion: tuple[float, float, float], own: Float64
) -> tuple[Float32, UInt8]:
    """Returns in `base` at the stamp, (N, 3) in column-major order, and which of them are usable, (N,).

    A return is not usable when a coordinate is not finite, when it lies at the sensor itself, or inside one of the
    `own` boxes (K, 2, 3). `offset_s` (N,) is the firing time relative to the stamp, `motion` is from `motion_of`.
    """
    out = np.empty((len(points_m), 3), np.float32, order="F")  # loops over columns are vectorized
    usable = np.empty(len(points_m), np.uint8)
    T = T_base_sensor[:3].astype(np.float32)
    # before deskewing: the machine's own bodies move with the sensor
    _transform_and_mask(np.ascontiguousarray(points_m), T, own.astype(np.float32), out, usable)
    if offset_s.any():
        _deskew(offset_s, np.array(motion), out)
    return out, usable


@kernel
def _transform_and_mask(points: Float32, T: Float32, own: Float32, out: Float32, usable: UInt8) -> None:
    """One operation per loop over columns, so that each loop is vectorized."""
    a, b, c, d, e, f, g, h, k = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2], T[2, 0], T[2, 1], T[2, 2]
    x0, y0, z0 = T[0, 3], T[1, 3], T[2, 3]
    row, xs, ys, zs = points.reshape(-1), out[:, 0], out[:, 1], out[:, 2]
    for i in range(points.shape[0]):
        px, py, pz = row[3 * i], row[3 * i + 1], row[3 * i + 2]
        xs[i] = a * px + b * py + c * pz + x0
        ys[i] = d * px + e * py + f * pz + y0
        zs[i] = g * px + h * py + k * pz + z0
    for i in range(points.shape[0]):
        x, y, z, total = xs[i] - x0, ys[i] - y0, zs[i] - z0, xs[i] + ys[i] + zs[i]
        # inf - inf is NaN, which is not equal to zero
        usable[i] = (total - total == ZERO) & (x * x + y * y + z * z > MIN_RANGE_SQUARED_M2)
    for n in range(own.shape[0]):
        x0, y0, z0 = own[n, 0, 0], own[n, 0, 1], own[n, 0, 2]
        x1, y1, z1 = own[n, 1, 0], own[n, 1, 1], own[n, 1, 2]
        for i in range(points.shape[0]):
            x, y, z = xs[i], ys[i], zs[i]
            is_own = (x0 < x) & (x < x1) & (y0 < y) & (y < y1) & (z0 < z) & (z < z1)
            usable[i] = 0 if is_own else usable[i]


@kernel
def _deskew(offset: Float32, motion: Float64, out: Float32) -> None:
    """Transforms points from `base` at the firing time to `base` at the stamp."""
    for i in range(out.shape[0]):
        x, y, t = out[i, 0], out[i, 1], float(offset[i])
        # the series is exact to 1e-6 rad within 0.3 rad
        a = motion[2] * t
        s, c = a * (1.0 - a * a / 6.0), 1.0 - a * a / 2.0 + a * a * a * a / 24.0
        along, across = t * (1.0 - a * a / 6.0), t * a / 2.0
        out[i, 0] = c * x - s * y + motion[0] * along - motion[1] * across
        out[i, 1] = s * x + c * y + motion[0] * across + motion[1] * along
