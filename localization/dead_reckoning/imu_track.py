"""The recent turn rates and specific forces, checked, in the axes of `base`.

A sample is the mean over the interval that ends at its stamp, as units give that sum up increments inside.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Imu
from geometry.transforms import Float64
from messages.sensors import ImuSample

STANDARD_GRAVITY_MPS2 = 9.80665
KEEP = 800


class InertialConfig(Config):
    """How inertial samples enter; the factors widen the data sheet's noise for vibration and mounting."""

    gyro_noise_factor: float = Field(ge=1.0, le=100.0)
    accelerometer_noise_factor: float = Field(ge=1.0, le=1000.0)
    bias_time_s: float = Field(gt=0.0, le=10000.0, description="time in which a bias wanders by its instability")
    pull_time_s: float = Field(gt=0.0, le=5.0, description="smoothing of the force that makes tyres slip")
    largest_gap_s: float = Field(gt=0.0, le=1.0, description="a longer silence ends dead reckoning")


@dataclass(frozen=True)
class Steps:
    """A stretch of time cut into n steps: length and middle against the start (n,), mean force and rate (n, 3).

    `pull` (n, 2) is the smoothed specific force forwards and to the left, in units of weight: what the tyres give.
    """

    dt_s: Float64
    middle_ns: Float64
    acceleration_mps2: Float64
    rate_radps: Float64
    pull: Float64


class InertialTrack:
    """Samples of the last seconds in time order, turned into `base` axes; the origin stays at the IMU."""

    def __init__(self, imu: Imu, pull_time_s: float) -> None:
        self._turn = np.kron(np.eye(2), imu.mount.T_base_sensor[:3, :3])
        self._limit = np.repeat([imu.accelerometer_range_g * STANDARD_GRAVITY_MPS2, np.radians(imu.gyro_range_dps)], 3)
        self._pull, self._pull_time_s = np.zeros(2), pull_time_s
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
        """The newest sample: specific force, then rate, then pull, (8,)."""
        return self._values[-1]

    def clear(self) -> None:
        """Forgets everything, as after a gap or a clock that jumped."""
        self._stamps.clear()
        self._values.clear()

    def add(self, sample: ImuSample) -> bool:
        """Takes a sample; False when it is out of order, not finite or beyond the sensor's range."""
        if sample.acceleration_mps2.shape != (3,) or sample.rate_radps.shape != (3,):
            return False
        value = np.concatenate([sample.acceleration_mps2, sample.rate_radps])
        if not bool((np.abs(value) <= self._limit).all()):  # NaN compares false
            return False
        if self._stamps and sample.stamp_ns <= self._stamps[-1]:
            return False
        turned = self._turn @ value
        self._smooth(turned[:2] / STANDARD_GRAVITY_MPS2, sample.stamp_ns)
        self._stamps.append(sample.stamp_ns)
        self._values.append(np.concatenate([turned, self._pull]))
        return True

    def _smooth(self, pull: Float64, stamp_ns: int) -> None:
        share = (stamp_ns - self._stamps[-1]) * 1e-9 / self._pull_time_s if self._stamps else 1.0
        self._pull = self._pull + min(1.0, share) * (pull - self._pull)

    def between(self, start_ns: int, end_ns: int) -> Steps:
        """The steps from `start_ns` to `end_ns`, both within what is kept; beyond the newest sample it is held."""
        edges, values = [start_ns], []
        for k in range(self._first_after(start_ns), len(self._stamps)):
            edges.append(min(self._stamps[k], end_ns))
            values.append(self._values[k])
            if edges[-1] == end_ns:
                break
        if edges[-1] < end_ns:
            edges.append(end_ns)
            values.append(self._values[-1])
        at, time_ns = np.array(values), np.array(edges, np.int64) - start_ns
        return Steps(
            np.diff(time_ns) * 1e-9,
            0.5 * (time_ns[1:] + time_ns[:-1]).astype(np.float64),
            at[:, :3].copy(),
            at[:, 3:6].copy(),
            at[:, 6:].copy(),
        )

    def _first_after(self, stamp_ns: int) -> int:
        """Index of the oldest sample after a time."""
        k = len(self._stamps)
        while k > 0 and self._stamps[k - 1] > stamp_ns:
            k -= 1
        return k
