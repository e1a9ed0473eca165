"""The recent wheel speeds, and the way they stand for."""

from collections import deque

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from configs.strict import Config
from geometry.transforms import Float64
from localization.inertial import Steps
from messages.sensors import WheelSample

KEEP = 400


class WheelConfig(Config):
    """How far the rear axle's speed says where base goes; densities are of a velocity white in time."""

    longitudinal_m_per_rts: float = Field(gt=0.0, le=1.0, description="along x, over the sensor's own noise")
    lateral_m_per_rts: float = Field(gt=0.0, le=1.0)
    vertical_m_per_rts: float = Field(gt=0.0, le=1.0)
    standstill_m_per_rts: float = Field(gt=0.0, le=1.0, description="in each direction while the wheels stand")
    scale_sigma: float = Field(gt=0.0, le=0.5, description="at the start")
    scale_per_rts: float = Field(gt=0.0, le=0.5, description="how fast slip changes")
    drift_sigma: float = Field(gt=0.0, le=0.5, description="sideways speed over forward speed, at the start")
    drift_per_rts: float = Field(gt=0.0, le=0.5)
    largest_speed_mps: float = Field(gt=0.0, le=50.0)
    standing_mps: float = Field(gt=0.0, le=0.5, description="below this the wheels stand")
    largest_gap_s: float = Field(gt=0.0, le=1.0)


class WheelTrack:
    """Speeds of the last seconds in time order."""

    def __init__(self, largest_speed_mps: float) -> None:
        self._limit = largest_speed_mps
        self._stamps: deque[int] = deque(maxlen=KEEP)
        self._speeds: deque[float] = deque(maxlen=KEEP)

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample."""
        return self._stamps[-1]

    def clear(self) -> None:
        """Forgets everything."""
        self._stamps.clear()
        self._speeds.clear()

    def add(self, sample: WheelSample) -> bool:
        """Takes a sample; False when it is out of order, not finite or impossibly fast."""
        if not (abs(sample.speed_mps) <= self._limit and abs(sample.steering_angle_rad) <= 1.57):
            return False
        if self._stamps and sample.stamp_ns <= self._stamps[-1]:
            return False
        self._stamps.append(sample.stamp_ns)
        self._speeds.append(sample.speed_mps)
        return True

    def speed_at(self, stamp_ns: Float64, origin_ns: int) -> Float64:
        """Speeds at times after `origin_ns`, (n,); beyond the newest sample it is held."""
        low = len(self._stamps) - 1
        while low > 0 and self._stamps[low] > origin_ns:
            low -= 1
        picked = range(low, len(self._stamps))
        stamps = np.array([self._stamps[k] - origin_ns for k in picked], np.float64)
        return np.interp(stamp_ns, stamps, np.array([self._speeds[k] for k in picked]))


def displacement_columns(steps: Steps, speed_mps: Float64, gyro_bias_radps: Float64) -> Float64:
    """What one unit of scale and of sideways drift each move base, in base at the start, (3, 2).

    The way of base is `columns @ (scale, drift)`. Turns within one stretch are small, so their order is neglected:
    the error is the way times half the product of two turn angles about different axes, below 0.1 mm in 0.1 s.
    """
    turn = (steps.rate_radps - gyro_bias_radps) * steps.dt_s[:, None]
    before = np.cumsum(turn, axis=0) - 0.5 * turn
    R = Rotation.from_rotvec(before).as_matrix()
    way = speed_mps * steps.dt_s
    return np.stack([R[:, :, 0].T @ way, R[:, :, 1].T @ way], axis=1)
