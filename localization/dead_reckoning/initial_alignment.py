"""Initial alignment at standstill: roll and pitch from gravity, heading and position from GNSS fixes."""

import math
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.transforms import transform
from localization.dead_reckoning.imu_track import STANDARD_GRAVITY_MPS2, ImuTrack
from localization.gnss_gate import Position


class InitialAlignmentConfig(Config):
    """Standstill criteria and sigmas of the first state."""

    window_s: float = Field(gt=0.1, le=7.0)
    max_rate_radps: float = Field(gt=0.0, le=1.0, description="faster rotation is no standstill")
    max_noise_mps2: float = Field(gt=0.0, le=10.0, description="standard deviation of the specific force")
    vibration_s: float = Field(gt=0.0, le=1.0, description="time in which the vibration is correlated")
    fixes: int = Field(ge=2, le=200)
    max_tilt_deg: float = Field(gt=0.0, le=90.0, description="no machine works beyond: mount of the IMU")
    tilt_sigma_deg: float = Field(gt=0.0, le=10.0)
    heading_sigma_deg: float = Field(gt=0.0, le=20.0)
    velocity_sigma_mps: float = Field(gt=0.0, le=1.0)
    max_gravity_error_mps2: float = Field(gt=0.0, le=5.0, description="of the specific force at standstill")


@dataclass(frozen=True)
class TiltEstimate:
    """Roll, pitch, gyro bias (3,) and magnitude of the specific force at standstill.

    `sigma_rad`: of roll and pitch by vibration, in addition to the configured sigma.
    """

    roll_rad: float
    pitch_rad: float
    gyro_bias_radps: Float64
    gravity_mps2: float
    sigma_rad: float = 0.0


@dataclass(frozen=True)
class InitialPosition:
    """Antenna position in `map` with sigma (3,), and heading of the machine, from fixes at standstill."""

    p_map_m: Float64
    sigma_m: Float64
    heading_rad: float


def tilt_from_gravity(specific_force_mps2: Float64, rate_radps: Float64) -> TiltEstimate:
    """Tilt from the mean specific force (3,) and rate (3,) at standstill; the force points up."""
    x, y, z = specific_force_mps2.tolist()
    return TiltEstimate(
        math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), rate_radps.copy(), math.sqrt(x * x + y * y + z * z)
    )


def excess_tilt(up: float, limit_deg: float) -> str:
    """What is awaited of a tilt, by the share `up` of the vertical along the z axis; "" for one below the limit."""
    tilt_deg = math.degrees(math.acos(min(1.0, max(-1.0, up))))
    return (
        "" if tilt_deg <= limit_deg else f"a tilt below {limit_deg:.0f} deg: is {tilt_deg:.0f} deg (mount of the IMU?)"
    )


def wrong_gravity(force_mps2: float, limit_mps2: float) -> str:
    """What is awaited of a specific force at standstill; "" for one that is gravity."""
    is_gravity = abs(force_mps2 - STANDARD_GRAVITY_MPS2) <= limit_mps2
    return (
        "" if is_gravity else f"gravity: the specific force at standstill is {force_mps2:.1f} m/s2 (unit of the IMU?)"
    )


def mean_position(positions: list[Position]) -> InitialPosition | None:
    """Mean of fixes at standstill; None when most have no heading or when they are inconsistent."""
    headings = [p.heading_rad for p in positions if math.isfinite(p.heading_rad)]
    if 2 * len(headings) <= len(positions):
        return None
    points = np.array([p.p_map_m for p in positions])
    heights_m = [p.p_map_m[2] for p in positions if p.has_height]
    if heights_m:
        points[[not p.has_height for p in positions], 2] = np.mean(heights_m)
    sigma = np.array([np.hypot(p.sigma_m, p.slow_m) for p in positions])
    if bool(np.any(np.ptp(points, axis=0) > 8.0 * np.max(sigma, axis=0))):
        return None
    first = headings[0]
    offsets = np.array([wrap(h - first) for h in headings])
    if float(np.ptp(offsets)) > 8.0 * positions[-1].heading_sigma_rad:
        return None
    return InitialPosition(points.mean(axis=0), np.max(sigma, axis=0), wrap(first + float(offsets.mean())))


def initial_pose(tilt: TiltEstimate, position: InitialPosition, arm_m: Float64) -> Float64:
    """Pose in `map` of the body with antenna lever arm `arm_m`."""
    T = transform((0.0, 0.0, 0.0), (tilt.roll_rad, tilt.pitch_rad, position.heading_rad))
    T[:3, 3] = position.p_map_m - T[:3, :3] @ arm_m
    return T


class Standstill:
    """Duration of the present standstill, its fixes, and `obstacle`: what hides the tilt, "" when nothing does."""

    def __init__(self, config: InitialAlignmentConfig) -> None:
        self._config = config
        self.since_ns: int | None = None
        self.obstacle = ""
        self._positions: list[Position] = []

    def reset(self) -> None:
        """Ends the standstill."""
        self.since_ns = None
        self._positions.clear()

    def update(self, stamp_ns: int, rate_radps: Float64, is_rolling: bool) -> None:
        """Takes the newest turn rate (3,) and whether the wheels roll."""
        if is_rolling or float(np.max(np.abs(rate_radps))) > self._config.max_rate_radps:
            self.reset()
        elif self.since_ns is None:
            self.since_ns = stamp_ns

    def add(self, position: Position) -> None:
        """Takes a fix; drops fixes of another solution type."""
        if self.since_ns is None or position.stamp_ns < self.since_ns:
            return
        same = [p for p in self._positions if p.solution == position.solution]
        self._positions = [*same, position][-self._config.fixes :]

    def tilt(self, track: ImuTrack) -> TiltEstimate | None:
        """Tilt and bias after a standstill of the window; None before, or where something hides the tilt."""
        self.obstacle = ""
        cfg, end, window_ns = self._config, track.last_ns, int(self._config.window_s * 1e9)
        if self.since_ns is None or end - max(self.since_ns, track.first_ns) < window_ns:
            return None
        steps = track.between(end - window_ns, end)
        noise_mps2 = float(np.max(np.std(steps.acceleration_mps2, axis=0)))
        if noise_mps2 > cfg.max_noise_mps2:
            self.obstacle = "less vibration, which hides the tilt"
            return None
        mean_mps2 = steps.acceleration_mps2.mean(axis=0)
        found = tilt_from_gravity(mean_mps2, steps.rate_radps.mean(axis=0))
        self.obstacle = wrong_gravity(found.gravity_mps2, cfg.max_gravity_error_mps2) or excess_tilt(
            float(mean_mps2[2]) / found.gravity_mps2, cfg.max_tilt_deg
        )
        if self.obstacle:
            return None
        sigma_mps2 = noise_mps2 * math.sqrt(min(1.0, cfg.vibration_s / cfg.window_s))
        return replace(found, sigma_rad=sigma_mps2 / found.gravity_mps2)

    def position(self) -> InitialPosition | None:
        """Mean position, once there are enough fixes."""
        return mean_position(self._positions) if len(self._positions) >= self._config.fixes else None

    @property
    def lacks_heading(self) -> bool:
        """Whether there are enough fixes but none has a heading."""
        enough = len(self._positions) >= self._config.fixes
        return enough and not any(math.isfinite(p.heading_rad) for p in self._positions)

    @property
    def newest(self) -> Position | None:
        """The newest fix of the standstill."""
        return self._positions[-1] if self._positions else None
