"""The recent turn rates and specific forces, checked, in the axes of `base`."""

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
    largest_gap_s: float = Field(gt=0.0, le=1.0, description="a longer silence ends dead reckoning")


@dataclass(frozen=True)
class Steps:
    """A stretch of time cut into n steps: length (n,), middle against the start (n,), mean specific force and rate (n, 3)."""

    dt_s: Float64
    middle_ns: Float64
    acceleration_mps2: Float64
    rate_radps: Float64


class InertialTrack:
    """Samples of the last seconds in time order, turned into `base` axes; the origin stays at the IMU."""

    def __init__(self, imu: Imu) -> None:
        self._R_base_imu = imu.mount.T_base_sensor[:3, :3].copy()
        self._limit = np.repeat([imu.accelerometer_range_g * STANDARD_GRAVITY_MPS2, np.radians(imu.gyro_range_dps)], 3)
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
        """The newest sample: specific force, then rate, (6,)."""
        return self._values[-1]

    def clear(self) -> None:
        """Forgets everything, as after a gap or a clock that jumped."""
        self._stamps.clear()
        self._values.clear()

    def add(self, sample: ImuSample) -> bool:
        """Takes a sample; False when it is out of order, not finite or beyond the sensor's range."""
        value = np.concatenate([sample.acceleration_mps2, sample.rate_radps])
        if value.shape != (6,) or not bool(np.all(np.abs(value) <= self._limit)):  # NaN compares false
            return False
        if self._stamps and sample.stamp_ns <= self._stamps[-1]:
            return False
        turned = np.concatenate([self._R_base_imu @ value[:3], self._R_base_imu @ value[3:]])
        self._stamps.append(sample.stamp_ns)
        self._values.append(turned)
        return True

    def between(self, start_ns: int, end_ns: int) -> Steps:
        """The steps from `start_ns` to `end_ns`, both within what is kept; values are means of neighbouring samples."""
        stamps, values = self._window(start_ns, end_ns)
        relative = (stamps - start_ns).astype(np.float64)
        inner = (stamps > start_ns) & (stamps < end_ns)
        edges = np.concatenate([[0.0], relative[inner], [float(end_ns - start_ns)]])
        at = np.stack([np.interp(edges, relative, values[:, k]) for k in range(6)], axis=1)
        mean = 0.5 * (at[1:] + at[:-1])
        return Steps(np.diff(edges) * 1e-9, 0.5 * (edges[1:] + edges[:-1]), mean[:, :3], mean[:, 3:])

    def _window(self, start_ns: int, end_ns: int) -> tuple[np.ndarray, Float64]:
        """Samples from the last at or before the start to the first at or after the end."""
        low = len(self._stamps) - 1
        while low > 0 and self._stamps[low] > start_ns:
            low -= 1
        picked = range(low, len(self._stamps))
        stamps = np.array([self._stamps[k] for k in picked], np.int64)
        return stamps, np.array([self._values[k] for k in picked])
