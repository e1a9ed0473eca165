"""Path tracking law at the rear axle: curvature from offset and heading error.

In the direction of travel (control/reference.py), forward and reverse are equal: at the rear axle
e' = sin ψ and ψ' = κ − κ_p cos ψ / (1 − e κ_p), with ' by distance. A desired heading against the path, ψ_w(e),
reduces the offset, and κ makes ψ − ψ_w decay (backstepping):

    κ = κ_p cos ψ / (1 − e κ_p) + dψ_w/de · sin ψ − (ψ − ψ_w) / l_ψ

      e                       near the line  ψ_w = −e / l_e : e decays over the length l_e
      │ ╲  up to approach     further out    an arc of the landing radius that ends on the line
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
    """Decay lengths of the law: constant at low speed, time × speed at high speed; the larger applies."""

    smoothing_radpm: float = Field(gt=0.1, le=20.0, description="cut-off of the path smoothing")
    offset_decay_m: float = Field(gt=0.2, le=20.0)
    offset_decay_s: float = Field(gt=0.0, le=5.0)
    heading_decay_m: float = Field(gt=0.2, le=20.0)
    heading_decay_s: float = Field(gt=0.0, le=5.0)
    landing_share: float = Field(ge=1.0, le=10.0, description="landing radius over minimum turning radius")
    landing_m: float = Field(
        gt=0.1, le=10.0, description="distance in which the steering must reach the landing curvature"
    )
    correction_m: float = Field(gt=0.1, le=10.0, description="distance over which the steering may turn to correct, or")
    correction_s: float = Field(gt=0.05, le=5.0, description="time; more causes oscillation at the limited rate")
    approach_deg: float = Field(gt=5.0, le=80.0)
    integral_m: float = Field(gt=1.0, le=1000.0)
    integral_max_m: float = Field(ge=0.0, le=0.5)
    integral_offset_m: float = Field(gt=0.0, le=1.0, description="integration only within this offset")
    integral_curvature_radpm: float = Field(gt=0.0, le=1.0, description="and only below this curvature of the path")
    start_window_m: float = Field(
        gt=0.0, le=100.0, description="beginning of a new path in which the position is searched"
    )


@dataclass(frozen=True)
class TrackingLaw:
    """Tracking law at one speed."""

    offset_decay_m: float
    heading_decay_m: float
    landing_radius_m: float
    approach_rad: float
    correction_radpm: float

    @classmethod
    def at(cls, config: TrackingConfig, speed_mps: float, min_radius_m: float, rate_radpmps: float) -> "TrackingLaw":
        """The law at a speed, for a steering whose curvature rate is at most `rate_radpmps`."""
        return cls(
            max(config.offset_decay_m, config.offset_decay_s * speed_mps),
            max(config.heading_decay_m, config.heading_decay_s * speed_mps),
            max(config.landing_share * min_radius_m, speed_mps / (rate_radpmps * config.landing_m)),
            deg(config.approach_deg),
            rate_radpmps * max(config.correction_s, config.correction_m / max(speed_mps, 0.1)),
        )

    def approach(self, offset_m: float) -> tuple[float, float]:
        """Desired heading against the path, rad, and its derivative by the offset, rad/m."""
        decay, radius = self.offset_decay_m, self.landing_radius_m
        bend_rad = math.asin(min(decay / radius, 1.0))  # arc and exponential have equal slopes here
        beyond_m = abs(offset_m) - decay * bend_rad
        if beyond_m <= 0.0:
            return -offset_m / decay, -1.0 / decay
        cosine = math.cos(bend_rad) - beyond_m / radius
        if cosine <= math.cos(self.approach_rad):
            return -math.copysign(self.approach_rad, offset_m), 0.0
        angle = math.acos(cosine)
        return -math.copysign(angle, offset_m), -1.0 / (radius * math.sin(angle))

    def curvature(self, offset_m: float, heading_error_rad: float, path_radpm: float) -> float:
        """Curvature to drive, rad/m, left positive in the direction of travel."""
        desired_rad, slope = self.approach(offset_m)
        shrink = max(1.0 - offset_m * path_radpm, 0.2)  # undefined beyond the centre of curvature
        forward = path_radpm * math.cos(heading_error_rad) / shrink
        error_rad = clamp(heading_error_rad - desired_rad, 0.5 * math.pi)
        correction = slope * math.sin(heading_error_rad) - error_rad / self.heading_decay_m
        return forward + clamp(correction, self.correction_radpm)


class OffsetIntegral:
    """Mean residual offset, integrated on the line and held elsewhere."""

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self.offset_m = 0.0

    def update(self, offset_m: float, curvature_radpm: float, driven_m: float) -> float:
        """Integrates over `driven_m` (0 holds); returns the correction of the offset, m."""
        config = self._config
        is_on_line = abs(offset_m) < config.integral_offset_m
        if is_on_line and abs(curvature_radpm) < config.integral_curvature_radpm:
            change = offset_m * driven_m / config.integral_m
            self.offset_m = clamp(self.offset_m + change, config.integral_max_m)
        return self.offset_m
