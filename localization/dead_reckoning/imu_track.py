"""IMU track: checked specific forces and turn rates of the last seconds in `base` axes.

A sample is the mean over the interval that ends at its stamp, as of IMUs that output increments.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Imu
from geometry.arrays import Float64
from messages.sensors import ImuSample

STANDARD_GRAVITY_MPS2 = 9.80665
KEEP = 800
VIBRATION_S = 2.0  # over which the noise of samples is determined


class ImuTrackConfig(Config):
    """Section `imu` of odometry; the factors widen the noise of the data sheet for vibration and mounting."""

    gyro_noise_factor: float = Field(ge=1.0, le=100.0)
    accelerometer_noise_factor: float = Field(ge=1.0, le=1000.0)
    bias_time_s: float = Field(gt=0.0, le=10000.0, description="time in which a bias changes by its instability")
    tyre_force_time_s: float = Field(gt=0.0, le=5.0, description="smoothing of the tyre force")
    tyre_force_sigma: float = Field(gt=0.0, le=1.0, description="typical tyre force over weight: what is no vibration")
    max_gap_s: float = Field(gt=0.0, le=1.0, description="a longer gap ends dead reckoning")


@dataclass(frozen=True)
class Steps:
    """An interval in n steps: duration and middle from its start (n,), mean specific force and rate (n, 3).

    `tyre_force` (n, 2) is the longitudinal and lateral specific force (forward, left) over gravity, smoothed, as
    expected beside the vibration.
    """

    dt_s: Float64
    middle_ns: Float64
    acceleration_mps2: Float64
    rate_radps: Float64
    tyre_force: Float64


class ImuTrack:
    """Samples of the last seconds in time order, rotated to `base` axes; the origin stays at the IMU."""

    def __init__(self, imu: Imu, config: ImuTrackConfig) -> None:
        self._rotation = np.kron(np.eye(2), imu.mount.T_base_sensor[:3, :3])
        self._limit = np.repeat([imu.accelerometer_range_g * STANDARD_GRAVITY_MPS2, np.radians(imu.gyro_range_dps)], 3)
        self._config, self._force, self._newest, self._change2 = config, np.zeros(2), np.zeros(2), np.zeros(2)
        self._tyre_force = np.zeros(2)
        self._stamps: deque[int] = deque(maxlen=KEEP)
        self._values: deque[Float64] = deque(maxlen=KEEP)

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def first_ns(self) -> int:
        """Stamp of the oldest sample kept."""
        return self._stamps[0]

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample."""
        return self._stamps[-1]

    @property
    def last(self) -> Float64:
        """The newest sample: specific force, rate, tyre force, (8,)."""
        return self._values[-1]

    def at(self, stamp_ns: int) -> Float64:
        """The sample (8,) whose interval holds a time; the newest one beyond its stamp."""
        return self._values[min(self._first_after(stamp_ns - 1), len(self._values) - 1)]

    def clear(self) -> None:
        """Drops all samples, after a gap or clock jump."""
        self._stamps.clear()
        self._values.clear()

    def is_valid(self, sample: ImuSample) -> bool:
        """Whether a sample is finite and in range."""
        if sample.acceleration_mps2.shape != (3,) or sample.rate_radps.shape != (3,):
            return False
        value = np.concatenate([sample.acceleration_mps2, sample.rate_radps])
        return bool((np.abs(value) <= self._limit).all())  # NaN compares false

    def add(self, sample: ImuSample) -> bool:
        """Takes a valid sample; False when it is out of order."""
        if self._stamps and sample.stamp_ns <= self._stamps[-1]:
            return False
        rotated = self._rotation @ np.concatenate([sample.acceleration_mps2, sample.rate_radps])
        self._smooth(rotated[:2] / STANDARD_GRAVITY_MPS2, sample.stamp_ns)
        self._stamps.append(sample.stamp_ns)
        self._values.append(np.concatenate([rotated, self._tyre_force]))
        return True

    def _smooth(self, force: Float64, stamp_ns: int) -> None:
        """Mean of the last forces, times the share of its variance that is no vibration.

        The noise of samples follows from their changes. Without that share it would hide the slip per force.
        """
        cfg, dt_s = self._config, (stamp_ns - self._stamps[-1]) * 1e-9 if self._stamps else math.inf
        share = min(1.0, dt_s / cfg.tyre_force_time_s)
        self._force = self._force + share * (force - self._force)
        if self._stamps:
            slow = min(1.0, dt_s / VIBRATION_S)
            self._change2 = self._change2 + slow * ((force - self._newest) ** 2 - self._change2)
        self._newest = force
        noise2 = 0.5 * self._change2 * share / (2.0 - share)
        self._tyre_force = self._force * cfg.tyre_force_sigma**2 / (cfg.tyre_force_sigma**2 + noise2)

    def between(self, start_ns: int, end_ns: int) -> Steps:
        """The steps from `start_ns` to `end_ns`; the newest sample is held beyond its stamp."""
        edges, values = [start_ns], []
        for k in range(self._first_after(start_ns), len(self._stamps)):
            edges.append(min(self._stamps[k], end_ns))
            values.append(self._values[k])
            if edges[-1] == end_ns:
                break
        if edges[-1] < end_ns:
            edges.append(end_ns)
            values.append(self._values[-1])
        samples, time_ns = np.array(values), np.array(edges, np.int64) - start_ns
        return Steps(
            np.diff(time_ns) * 1e-9,
            0.5 * (time_ns[1:] + time_ns[:-1]).astype(np.float64),
            samples[:, :3].copy(),
            samples[:, 3:6].copy(),
            samples[:, 6:].copy(),
        )

    def _first_after(self, stamp_ns: int) -> int:
        """Index of the oldest sample after a time."""
        k = len(self._stamps)
        while k > 0 and self._stamps[k - 1] > stamp_ns:
            k -= 1
        return k
