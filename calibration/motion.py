"""Motion of a recorded trial: straight pieces, base positions, and values at times."""

from dataclasses import dataclass

import numpy as np

from calibration.recording import Recording
from configs.vehicle import Mount, Vehicle
from geometry.arrays import Float64

MIN_MPS = 0.5
STRAIGHT_RADPM = 0.01  # of the mean over `SMOOTH_S`
STEADY_MPS2 = 0.35
SMOOTH_S = 1.0
RAISED = 0.95  # hitch: the tool has no draft


@dataclass(frozen=True)
class Motion:
    """Speed, turn rate and distance by the wheels at the times of the wheel samples, all (N,).

    `yaw_rate_radps` is that of the IMU without its bias at standstill; `is_free`: the implement is raised.
    """

    t_s: Float64
    speed_mps: Float64
    angle_rad: Float64
    yaw_rate_radps: Float64
    acceleration_mps2: Float64
    distance_m: Float64
    is_free: Float64

    @property
    def is_straight(self) -> Float64:
        """Whether the machine drives straight at a steady speed with raised implement, (N,) of 0 and 1."""
        speed = np.maximum(np.abs(self.speed_mps), 1e-3)
        is_straight = (self.speed_mps > MIN_MPS) & (np.abs(self.yaw_rate_radps) < STRAIGHT_RADPM * speed)
        return np.asarray(is_straight & (np.abs(self.acceleration_mps2) < STEADY_MPS2) & (self.is_free > 0.5), float)


def motion_of(recording: Recording, vehicle: Vehicle) -> Motion:
    """Motion of a recording; empty without wheels or IMU."""
    wheel, imu = recording.wheel, recording.imu
    if len(wheel) < 10 or len(imu) < 10 or vehicle.sensors.imu is None:
        empty = np.zeros(0)
        return Motion(empty, empty, empty, empty, empty, empty, empty)
    t, speed = wheel[:, 0], wheel[:, 1]
    up_imu = vehicle.sensors.imu.mount.T_base_sensor[2, :3]
    rate = imu[:, 4:7] @ up_imu
    still = np.interp(imu[:, 0], t, (np.abs(smoothed(t, speed)) < 1e-3).astype(float)) > 0.99
    bias = float(np.mean(rate[still])) if still.sum() > 50 else 0.0
    yaw_rate = np.interp(t, imu[:, 0], smoothed(imu[:, 0], rate - bias))
    smooth = smoothed(t, speed)
    distance = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))])
    hitch = (
        np.interp(t, recording.machine[:, 0], recording.machine[:, 1]) if len(recording.machine) else np.ones(len(t))
    )
    acceleration = np.gradient(smooth, t)
    return Motion(t, speed, wheel[:, 2], yaw_rate, acceleration, distance, (hitch > RAISED).astype(float))


def straight_pieces(motion: Motion, length_m: float) -> list[slice]:
    """Samples of straight pieces, each of this length."""
    pieces, first = [], None
    for k, is_straight in enumerate(motion.is_straight > 0.5):
        if not is_straight:
            first = None
        elif first is None:
            first = k
        elif motion.distance_m[k] - motion.distance_m[first] >= length_m:
            pieces.append(slice(first, k + 1))
            first = k
    return pieces


def base_positions(recording: Recording, vehicle: Vehicle) -> Float64:
    """Time, x, y, z and heading of `base` at each fix with a heading, (N, 5), the antenna above a level machine."""
    gnss = recording.gnss[np.isfinite(recording.gnss[:, 6])]
    x, y, z = antenna_of(vehicle).xyz_m
    c, s = np.cos(gnss[:, 6]), np.sin(gnss[:, 6])
    return np.column_stack([
        gnss[:, 0], gnss[:, 1] - c * x + s * y, gnss[:, 2] - s * x - c * y, gnss[:, 3] - z, gnss[:, 6]
    ])  # fmt: skip


def fix_steps(recording: Recording, motion: Motion) -> Float64:
    """Steps between fixes with a heading, (N, 6): end and duration (s), turned angle (left positive), distance by the
    wheels and of the antenna along the heading (m), and heading in the middle (rad)."""
    fixes = recording.gnss[np.isfinite(recording.gnss[:, 6])]
    if len(motion.t_s) == 0 or len(fixes) < 2:
        return np.zeros((0, 6))
    yaw_rad = np.concatenate([[0.0], np.cumsum(motion.yaw_rate_radps[1:] * np.diff(motion.t_s))])
    turned, wheels_m = (np.diff(np.interp(fixes[:, 0], motion.t_s, values)) for values in (yaw_rad, motion.distance_m))
    heading = np.unwrap(fixes[:, 6])
    middle, way = 0.5 * (heading[1:] + heading[:-1]), np.diff(fixes[:, 1:3], axis=0)
    antenna_m = way[:, 0] * np.cos(middle) + way[:, 1] * np.sin(middle)
    return np.column_stack([fixes[1:, 0], np.diff(fixes[:, 0]), turned, wheels_m, antenna_m, middle])


def antenna_of(vehicle: Vehicle) -> Mount:
    """Mount of the first antenna."""
    return next(iter(vehicle.sensors.gnss.values())).mount


def smoothed(t_s: Float64, values: Float64, window_s: float = SMOOTH_S) -> Float64:
    """Mean over a window of time around each sample, (N,)."""
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t_s))])
    low, high = np.maximum(t_s - 0.5 * window_s, t_s[0]), np.minimum(t_s + 0.5 * window_s, t_s[-1])
    mean = (np.interp(high, t_s, integral) - np.interp(low, t_s, integral)) / np.maximum(high - low, 1e-9)
    return np.asarray(mean)
