"""The recent wheel speeds, and the way they stand for."""

from collections import deque

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from configs.strict import Config
from geometry.transforms import Float64
from localization.dead_reckoning.imu_track import Steps
from messages.sensors import WheelSample

KEEP = 400


class WheelConfig(Config):
    """How far the rear axle's speed says where base goes; densities are of a velocity white in time."""

    longitudinal_m_per_rts: float = Field(gt=0.0, le=1.0, description="along x, over the sensor's own noise")
    lateral_m_per_rts: float = Field(gt=0.0, le=1.0)
    vertical_m_per_rts: float = Field(gt=0.0, le=1.0)
    standstill_m: float = Field(gt=0.0, le=1.0, description="moved from keyframe to keyframe while the wheels stand")
    standstill_rad: float = Field(gt=0.0, le=1.0)
    scale_sigma: float = Field(gt=0.0, le=0.5, description="at the start")
    scale_per_rts: float = Field(gt=0.0, le=0.5, description="how fast slip changes")
    drift_sigma: float = Field(gt=0.0, le=0.5, description="sideways speed over forward speed, at the start")
    drift_per_rts: float = Field(gt=0.0, le=0.5)
    slip_per_pull: float = Field(ge=0.0, le=1.0, description="slip over forward force in units of weight, at the start")
    slip_per_pull_sigma: float = Field(gt=0.0, le=1.0)
    crab_per_side: float = Field(ge=0.0, le=1.0, description="slip angle over sideways force in units of weight")
    crab_per_side_sigma: float = Field(gt=0.0, le=1.0)
    softness_per_rts: float = Field(gt=0.0, le=0.1, description="how fast these two change with the ground")
    largest_speed_mps: float = Field(gt=0.0, le=50.0)
    standing_mps: float = Field(gt=0.0, le=0.5, description="below this the wheels stand")
    largest_gap_s: float = Field(gt=0.0, le=1.0)

    @property
    def start(self) -> Float64:
        """Slip before anything is learnt: scale, drift, slip per pull, crab per side force."""
        return np.array([1.0, 0.0, self.slip_per_pull, self.crab_per_side])

    @property
    def start_sigma(self) -> Float64:
        """Its sigmas."""
        return np.array([self.scale_sigma, self.drift_sigma, self.slip_per_pull_sigma, self.crab_per_side_sigma])

    @property
    def walk(self) -> Float64:
        """How it wanders, per root second."""
        return np.array([self.scale_per_rts, self.drift_per_rts, self.softness_per_rts, self.softness_per_rts])


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
        return np.asarray(np.interp(stamp_ns, stamps, np.array([self._speeds[k] for k in picked])))


def displacement_columns(steps: Steps, speed_mps: Float64, gyro_bias_radps: Float64) -> Float64:
    """What each unit of slip moves base, in base at the start, (3, 4).

    The way of base is `columns @ (scale, drift, slip per pull, crab per side force)`: pulling makes it less than the
    wheels', and a force to the left (a left bend, a slope whose left side is high) comes with a slide to the right.
    Turns within one stretch are small, so their order is neglected: the error is the way times half the product of two
    turn angles about different axes, below 0.1 mm in 0.2 s.
    """
    turn = (steps.rate_radps - gyro_bias_radps) * steps.dt_s[:, None]
    before = np.cumsum(turn, axis=0) - 0.5 * turn
    R = Rotation.from_rotvec(before).as_matrix()
    way = speed_mps * steps.dt_s
    ahead, aside = R[:, :, 0].T, R[:, :, 1].T
    pull, side = steps.pull[:, 0] * way, steps.pull[:, 1] * way
    return np.stack([ahead @ way, aside @ way, -(ahead @ pull), -(aside @ side)], axis=1)
