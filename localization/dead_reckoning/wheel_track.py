"""Wheel track: wheel speeds of the last seconds, and the displacement they measure."""

from collections import deque

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from configs.strict import Config
from geometry.arrays import Float64
from localization.dead_reckoning.imu_track import Steps
from messages.sensors import WheelSample

KEEP = 400
NO_SLIP = np.array([1.0, 0.0, 0.0, 0.0])  # without wheels; the third is then the vertical over the forward speed


class WheelConfig(Config):
    """Section `wheels` of odometry; densities of white velocity noise, slip model and limits."""

    longitudinal_m_per_rts: float = Field(gt=0.0, le=1.0, description="along x, in addition to the sensor noise")
    lateral_m_per_rts: float = Field(gt=0.0, le=1.0)
    vertical_m_per_rts: float = Field(gt=0.0, le=1.0)
    standstill_m: float = Field(gt=0.0, le=1.0, description="motion between keyframes while the wheels stand")
    standstill_rad: float = Field(gt=0.0, le=1.0)
    scale_sigma: float = Field(gt=0.0, le=0.5, description="initial")
    scale_per_rts: float = Field(gt=0.0, le=0.5, description="change of slip")
    drift_sigma: float = Field(gt=0.0, le=0.5, description="lateral over forward speed, initial")
    drift_per_rts: float = Field(gt=0.0, le=0.5)
    slip_per_longitudinal_force: float = Field(ge=0.0, le=1.0, description="slip per force over weight, initial")
    slip_per_longitudinal_force_sigma: float = Field(gt=0.0, le=1.0)
    slip_angle_per_lateral_force: float = Field(ge=0.0, le=1.0, description="rad per force over weight, initial")
    slip_angle_per_lateral_force_sigma: float = Field(gt=0.0, le=1.0)
    force_response_per_rts: float = Field(gt=0.0, le=0.1, description="change of these two with the ground")
    max_slip_mps: float = Field(gt=0.0, le=5.0, description="against the IMU; above, it is their sigma")
    max_speed_mps: float = Field(gt=0.0, le=50.0)
    standstill_mps: float = Field(gt=0.0, le=0.5, description="lower speeds are standstill")
    max_gap_s: float = Field(gt=0.0, le=1.0)
    sideslip_mps: float = Field(gt=0.0, le=5.0, description="sigma of the velocity across base, without wheel speeds")

    @property
    def start(self) -> Float64:
        """Initial slip (4,): scale, drift, slip per longitudinal force, slip angle per lateral force."""
        return np.array([1.0, 0.0, self.slip_per_longitudinal_force, self.slip_angle_per_lateral_force])

    @property
    def start_sigma(self) -> Float64:
        """Sigmas (4,) of the initial slip."""
        forces = self.slip_per_longitudinal_force_sigma, self.slip_angle_per_lateral_force_sigma
        return np.array([self.scale_sigma, self.drift_sigma, *forces])

    @property
    def walk(self) -> Float64:
        """Random walk (4,) of the slip, per √s."""
        force = self.force_response_per_rts
        return np.array([self.scale_per_rts, self.drift_per_rts, force, force])


class WheelTrack:
    """Speeds of the last seconds in time order."""

    def __init__(self, max_speed_mps: float) -> None:
        self._limit = max_speed_mps
        self._stamps: deque[int] = deque(maxlen=KEEP)
        self._speeds: deque[float] = deque(maxlen=KEEP)

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample."""
        return self._stamps[-1]

    def clear(self) -> None:
        """Drops all samples."""
        self._stamps.clear()
        self._speeds.clear()

    def add(self, sample: WheelSample) -> bool:
        """Takes a sample; False when it is out of order, too fast, or its speed is unknown; the angle may be (NaN)."""
        if not abs(sample.speed_mps) <= self._limit or abs(sample.steering_angle_rad) > 1.57:
            return False
        if self._stamps and sample.stamp_ns <= self._stamps[-1]:
            return False
        self._stamps.append(sample.stamp_ns)
        self._speeds.append(sample.speed_mps)
        return True

    def speed_at(self, stamp_ns: Float64, origin_ns: int) -> Float64:
        """Speeds (n,) at times after `origin_ns`; the newest sample is held."""
        low = len(self._stamps) - 1
        while low > 0 and self._stamps[low] > origin_ns:
            low -= 1
        picked = range(low, len(self._stamps))
        stamps = np.array([self._stamps[k] - origin_ns for k in picked], np.float64)
        return np.asarray(np.interp(stamp_ns, stamps, np.array([self._speeds[k] for k in picked])))


def displacement_columns(steps: Steps, speed_mps: Float64, gyro_bias_radps: Float64) -> Float64:
    """Displacement of base per slip parameter, (3, 4), in base at the start.

    The displacement is `columns @ (scale, drift, slip per longitudinal force, slip angle per lateral force)`: traction
    shortens it, and a force to the left (left curve, slope rising to the left) gives a slide to the right. The order
    of small rotations is neglected: the error is the path length times half the product of two rotation angles about
    different axes, below 0.1 mm in 0.2 s.
    """
    turn = (steps.rate_radps - gyro_bias_radps) * steps.dt_s[:, None]
    before = np.cumsum(turn, axis=0) - 0.5 * turn
    R = Rotation.from_rotvec(before).as_matrix()
    path = speed_mps * steps.dt_s
    forward, left = R[:, :, 0].T, R[:, :, 1].T
    longitudinal, lateral = steps.tyre_force[:, 0] * path, steps.tyre_force[:, 1] * path
    return np.stack([forward @ path, left @ path, -(forward @ longitudinal), -(left @ lateral)], axis=1)
