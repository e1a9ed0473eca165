"""Returns brought into `base` at the stamp, without those that are no measurement and those of the machine itself."""

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Implement, Vehicle
from geometry.jit import kernel
from messages.message import Float32, Float64, UInt8
from messages.motion import Odometry
from perception.lidar.grid import ZERO
from perception.self_filter import own_outline

NEAREST = np.float32(1e-4)  # m²: nearer returns lie at the sensor itself


class MaskConfig(Config):
    """How much is added to the machine's own bodies before returns inside them are dropped."""

    margin_m: float = Field(ge=0.0, le=1.0)
    implement_height_m: float = Field(gt=0.0, le=5.0)


def own_boxes(vehicle: Vehicle, implement: Implement | None, config: MaskConfig) -> Float64:
    """Machine and implement as boxes in `base`, (K, 2, 3): lowest and highest corner, margin included."""
    flat = own_outline(vehicle, implement, config.margin_m)
    top = np.array([vehicle.body.height_m, config.implement_height_m])[: len(flat)] + config.margin_m
    heights = np.stack([np.full(len(flat), -np.inf), top], axis=1)
    return np.asarray(np.concatenate([flat, heights[:, :, None]], axis=2), np.float64)


def motion_of(odom: Odometry | None) -> tuple[float, float, float]:
    """Forward and left speed and yaw rate; standing when odometry is missing."""
    return (0.0, 0.0, 0.0) if odom is None else (odom.speed_mps, odom.lateral_mps, odom.yaw_rate_radps)


def to_base(
    points_m: Float32, offset_s: Float32, T_base_sensor: Float64, motion: tuple[float, float, float], own: Float64
) -> tuple[Float32, UInt8]:
    """Returns in `base` at the stamp, (N, 3) laid out by columns, and which of them may be used, (N,).

    A return is not usable when a coordinate is not finite, when it lies at the sensor itself, or inside one of the
    `own` boxes (K, 2, 3). `offset_s` (N,) is the time of firing against the stamp, `motion` as from `motion_of`.
    """
    out = np.empty((len(points_m), 3), np.float32, order="F")  # loops over columns use the processor's vectors
    usable = np.empty(len(points_m), np.uint8)
    T = T_base_sensor[:3].astype(np.float32)
    # before the motion is taken out: the machine's own parts move along with the sensor
    _turn(np.ascontiguousarray(points_m), T, own.astype(np.float32), out, usable)
    if offset_s.any():
        _take_back(offset_s, np.array(motion), out)
    return out, usable


@kernel
def _turn(points: Float32, T: Float32, own: Float32, out: Float32, usable: UInt8) -> None:
    """One thing a loop, over columns: so each of them uses the processor's vectors."""
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
        # infinite less infinite is NaN, which equals nothing
        usable[i] = (total - total == ZERO) & (x * x + y * y + z * z > NEAREST)
    for n in range(own.shape[0]):
        x0, y0, z0 = own[n, 0, 0], own[n, 0, 1], own[n, 0, 2]
        x1, y1, z1 = own[n, 1, 0], own[n, 1, 1], own[n, 1, 2]
        for i in range(points.shape[0]):
            x, y, z = xs[i], ys[i], zs[i]
            is_own = (x0 < x) & (x < x1) & (y0 < y) & (y < y1) & (z0 < z) & (z < z1)
            usable[i] = 0 if is_own else usable[i]


@kernel
def _take_back(offset: Float32, motion: Float64, out: Float32) -> None:
    """`base` as it was at the time of firing, seen from `base` at the stamp."""
    for i in range(out.shape[0]):
        x, y, t = out[i, 0], out[i, 1], float(offset[i])
        # the series is exact to 1e-6 rad within 0.3 rad
        a = motion[2] * t
        s, c = a * (1.0 - a * a / 6.0), 1.0 - a * a / 2.0 + a * a * a * a / 24.0
        along, across = t * (1.0 - a * a / 6.0), t * a / 2.0
        out[i, 0] = c * x - s * y + motion[0] * along - motion[1] * across
        out[i, 1] = s * x + c * y + motion[0] * across + motion[1] * along
