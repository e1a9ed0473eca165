"""The first pose, found at standstill: gravity gives roll and pitch, two antennas the heading, the fixes the place."""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.angles import wrap
from geometry.transforms import Float64, transform
from localization.dead_reckoning.imu_track import InertialTrack
from localization.gnss_gate import Position


class AlignmentConfig(Config):
    """When the machine counts as standing and what the first state is trusted with."""

    window_s: float = Field(gt=0.1, le=7.0)
    largest_rate_radps: float = Field(gt=0.0, le=1.0, description="turning faster is not standing")
    largest_shake_mps2: float = Field(gt=0.0, le=10.0, description="standard deviation of the specific force")
    fixes: int = Field(ge=2, le=200)
    tilt_sigma_deg: float = Field(gt=0.0, le=10.0)
    heading_sigma_deg: float = Field(gt=0.0, le=20.0)
    velocity_sigma_mps: float = Field(gt=0.0, le=1.0)


@dataclass(frozen=True)
class Level:
    """What standstill says of an inertial unit: roll, pitch, gyro bias (3,) and the length of the specific force."""

    roll_rad: float
    pitch_rad: float
    gyro_bias_radps: Float64
    gravity_mps2: float


@dataclass(frozen=True)
class Placed:
    """Where the antenna stands and which way the machine looks, from fixes at standstill."""

    p_map_m: Float64
    sigma_m: Float64
    heading_rad: float


def level_of(specific_force_mps2: Float64, rate_radps: Float64) -> Level:
    """Roll and pitch from the mean specific force (3,) at standstill, which points upwards."""
    x, y, z = specific_force_mps2.tolist()
    return Level(
        math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), rate_radps.copy(), math.sqrt(x * x + y * y + z * z)
    )


def place_of(positions: list[Position]) -> Placed | None:
    """The mean of fixes at standstill; None without headings in most of them or when they lie apart."""
    headings = [p.heading_rad for p in positions if math.isfinite(p.heading_rad)]
    if 2 * len(headings) <= len(positions):
        return None
    points = np.array([p.p_map_m for p in positions])
    sigma = np.array([np.hypot(p.sigma_m, p.slow_m) for p in positions])
    if bool(np.any(np.ptp(points, axis=0) > 8.0 * np.max(sigma, axis=0))):
        return None
    middle = headings[0]
    turned = np.array([wrap(h - middle) for h in headings])
    if float(np.ptp(turned)) > 8.0 * positions[-1].heading_sigma_rad:
        return None
    return Placed(points.mean(axis=0), np.max(sigma, axis=0), wrap(middle + float(turned.mean())))


def pose_of(level: Level, placed: Placed, arm_m: Float64) -> Float64:
    """Pose in `map` of the body whose antenna stands `arm_m` from its origin."""
    T = transform((0.0, 0.0, 0.0), (level.roll_rad, level.pitch_rad, placed.heading_rad))
    T[:3, 3] = placed.p_map_m - T[:3, :3] @ arm_m
    return T


class Standstill:
    """Watches for how long the machine has stood, and collects the fixes of that time."""

    def __init__(self, config: AlignmentConfig) -> None:
        self._config = config
        self.since_ns: int | None = None
        self._positions: list[Position] = []

    def reset(self) -> None:
        """Counts anew."""
        self.since_ns = None
        self._positions.clear()

    def watch(self, stamp_ns: int, rate_radps: Float64, is_rolling: bool) -> None:
        """Takes the newest turn rate and whether the wheels turn."""
        if is_rolling or float(np.max(np.abs(rate_radps))) > self._config.largest_rate_radps:
            self.reset()
        elif self.since_ns is None:
            self.since_ns = stamp_ns

    def add(self, position: Position) -> None:
        """Takes a fix; those of a worse kind than the newest are let go."""
        if self.since_ns is None or position.stamp_ns < self.since_ns:
            return
        same = [p for p in self._positions if p.solution == position.solution]
        self._positions = [*same, position][-self._config.fixes :]

    def level(self, track: InertialTrack) -> Level | None:
        """Roll, pitch and bias once the machine has stood for the window, None before or when it shakes."""
        end, window_ns = track.last_ns, int(self._config.window_s * 1e9)
        if self.since_ns is None or end - max(self.since_ns, track.first_ns) < window_ns:
            return None
        steps = track.between(end - window_ns, end)
        if float(np.max(np.std(steps.acceleration_mps2, axis=0))) > self._config.largest_shake_mps2:
            return None
        return level_of(steps.acceleration_mps2.mean(axis=0), steps.rate_radps.mean(axis=0))

    def place(self) -> Placed | None:
        """The place, once there are enough fixes."""
        return place_of(self._positions) if len(self._positions) >= self._config.fixes else None

    @property
    def lacks_heading(self) -> bool:
        """Whether fixes are there but no heading comes with them."""
        enough = len(self._positions) >= self._config.fixes
        return enough and not any(math.isfinite(p.heading_rad) for p in self._positions)

    @property
    def newest(self) -> Position | None:
        """The newest fix of the standstill."""
        return self._positions[-1] if self._positions else None
