"""Path tracking at the rear axle: from offset and heading error to the curvature to drive.

All in the direction of travel (control/reference.py), where forward and reverse are the same: at the rear axle
e' = sin ψ and ψ' = κ − κ_p cos ψ / (1 − e κ_p), with ' by the way driven. A wanted heading against the path,
ψ_w(e), brings the offset down, and κ makes ψ − ψ_w decay (backstepping):

    κ = κ_p cos ψ / (1 − e κ_p) + dψ_w/de · sin ψ − (ψ − ψ_w) / l_ψ

      e                       near the line  ψ_w = −e / l_e : e decays over the length l_e
      │ ╲  at most approach   further out    an arc of the landing radius that ends on the line
      │  ╲ angle              far            straight at the approach angle
      │   ╲
      │     ╲_ arc
      └────────═════ line
"""

import math
from dataclasses import dataclass

from pydantic import Field

from configs.strict import Config
from configs.vehicle import deg
from control.scalars import clamp


class TrackingConfig(Config):
    """Lengths of decay: at low speed in metres, at high speed as time; the larger counts."""

    smoothing_radpm: float = Field(gt=0.1, le=20.0, description="what of the path turns faster is smoothed")
    offset_decay_m: float = Field(gt=0.2, le=20.0)
    offset_decay_s: float = Field(gt=0.0, le=5.0)
    heading_decay_m: float = Field(gt=0.2, le=20.0)
    heading_decay_s: float = Field(gt=0.0, le=5.0)
    landing_share: float = Field(ge=1.0, le=10.0, description="landing radius over the least turning radius")
    landing_m: float = Field(
        gt=0.1, le=10.0, description="way in which the steering must reach the landing's curvature"
    )
    correction_m: float = Field(gt=0.1, le=10.0, description="way over which the steering may turn to correct, or")
    correction_s: float = Field(gt=0.05, le=5.0, description="time: more makes it swing at its limited rate")
    approach_deg: float = Field(gt=5.0, le=80.0)
    integral_m: float = Field(gt=1.0, le=1000.0)
    integral_max_m: float = Field(ge=0.0, le=0.5)
    integral_offset_m: float = Field(gt=0.0, le=1.0, description="integrates only within this offset")
    integral_curvature_radpm: float = Field(gt=0.0, le=1.0, description="and only where the path is not tighter")
    start_window_m: float = Field(gt=0.0, le=100.0, description="of a new path, in which the machine is looked for")


@dataclass(frozen=True)
class Law:
    """The law at one speed."""

    offset_decay_m: float
    heading_decay_m: float
    landing_radius_m: float
    approach_rad: float
    correction_radpm: float

    @classmethod
    def at(cls, config: TrackingConfig, speed_mps: float, min_radius_m: float, rate_radpmps: float) -> "Law":
        """The law's lengths at a speed, for a steering that changes curvature by `rate_radpmps` at most."""
        return cls(
            max(config.offset_decay_m, config.offset_decay_s * speed_mps),
            max(config.heading_decay_m, config.heading_decay_s * speed_mps),
            max(config.landing_share * min_radius_m, speed_mps / (rate_radpmps * config.landing_m)),
            deg(config.approach_deg),
            rate_radpmps * max(config.correction_s, config.correction_m / max(speed_mps, 0.1)),
        )

    def approach(self, offset_m: float) -> tuple[float, float]:
        """Wanted heading against the path, and its slope over the offset."""
        decay, radius = self.offset_decay_m, self.landing_radius_m
        bend_rad = math.asin(min(decay / radius, 1.0))  # where arc and line have the same slope
        beyond_m = abs(offset_m) - decay * bend_rad
        if beyond_m <= 0.0:
            return -offset_m / decay, -1.0 / decay
        cosine = math.cos(bend_rad) - beyond_m / radius
        if cosine <= math.cos(self.approach_rad):
            return -math.copysign(self.approach_rad, offset_m), 0.0
        angle = math.acos(cosine)
        return -math.copysign(angle, offset_m), -1.0 / (radius * math.sin(angle))

    def curvature(self, offset_m: float, heading_error_rad: float, path_radpm: float) -> float:
        """The curvature to drive, left positive in the direction of travel."""
        wanted_rad, slope = self.approach(offset_m)
        shrink = max(1.0 - offset_m * path_radpm, 0.2)  # beyond the path's own centre there is no place on it
        forward = path_radpm * math.cos(heading_error_rad) / shrink
        error_rad = clamp(heading_error_rad - wanted_rad, 0.5 * math.pi)
        correction = slope * math.sin(heading_error_rad) - error_rad / self.heading_decay_m
        return forward + clamp(correction, self.correction_radpm)


class OffsetIntegral:
    """What is left of the offset in the mean, learned slowly on the line and held everywhere else."""

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self.offset_m = 0.0

    def update(self, offset_m: float, curvature_radpm: float, driven_m: float) -> float:
        """Go on by `driven_m` (0 holds); returns what to add to the offset."""
        config = self._config
        is_on_line = abs(offset_m) < config.integral_offset_m
        if is_on_line and abs(curvature_radpm) < config.integral_curvature_radpm:
            change = offset_m * driven_m / config.integral_m
            self.offset_m = clamp(self.offset_m + change, config.integral_max_m)
        return self.offset_m
