"""How far the stated pose can be trusted: covariance at the output, and the bound that follows from it."""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.transforms import Float64
from localization.gnss_gate import Position, source_of
from localization.lidar.pose_measurement import SightingConfig
from messages.motion import PositionSource

Metres = Field(ge=0.0, le=100.0)


class IntegrityConfig(Config):
    """The factor for 1e-4 an hour, and what no covariance knows of (a wrong fix, multipath) by source."""

    factor: float = Field(ge=1.0, le=10.0)
    rtk_fixed_m: float = Metres
    rtk_float_m: float = Metres
    uwb_m: float = Metres
    single_m: float = Metres
    dead_reckoning_m: float = Metres
    outage_s: float = Field(gt=0.0, le=60.0, description="without an accepted fix for longer it is dead reckoning")

    def floor_m(self, source: PositionSource) -> float:
        """The part that comes with the source."""
        return {
            PositionSource.NONE: math.inf, PositionSource.DEAD_RECKONING: self.dead_reckoning_m,
            PositionSource.SINGLE: self.single_m, PositionSource.UWB: self.uwb_m,
            PositionSource.RTK_FLOAT: self.rtk_float_m, PositionSource.RTK_FIXED: self.rtk_fixed_m,
        }[source]  # fmt: skip


def position_source(fix: Position | None, age_s: float, is_ranged: bool, outage_s: float) -> PositionSource:
    """What the position rests on: fixed ambiguities, else UWB where it holds, else the last fix for a while."""
    fixed = PositionSource.DEAD_RECKONING if fix is None or age_s > outage_s else source_of(fix.solution)
    return PositionSource.UWB if is_ranged and fixed is not PositionSource.RTK_FIXED else fixed


def slow_part(source: PositionSource, fix: Position | None, sighting: SightingConfig) -> tuple[Float64, float]:
    """The part of the error in place (3,) and heading that no averaging removes."""
    if source is PositionSource.UWB or fix is None:
        return np.full(3, sighting.slow_m), math.radians(sighting.slow_deg)
    return fix.slow_m, fix.heading_slow_rad if math.isfinite(fix.heading_rad) else 0.0


def output_covariance(
    at_body: Float64, T_base_body: Float64, slow_base: Float64, age_s: float, speed_mps: float, rate_sigma_radps: float
) -> Float64:
    """Covariance (6, 6) of base from that of the graph's body, with what wanders slowly and what has come since.

    `slow_base` (3, 3) is the part of the fixes' error that no averaging removes, in base axes.
    """
    A = np.eye(6)
    x, y, z = T_base_body[:3, 3]
    A[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]  # adjoint of a pure shift
    out = A @ at_body @ A.T
    out[3:, 3:] += slow_base
    out[:3, :3] += np.eye(3) * (rate_sigma_radps * age_s) ** 2
    out[3:, 3:] += np.eye(3) * (0.01 * speed_mps * age_s) ** 2
    return 0.5 * (out + out.T)


def protection_level(
    covariance: Float64, T_map_base: Float64, source: PositionSource, config: IntegrityConfig
) -> float:
    """Bound of the horizontal error, metres: the factor times the larger half axis of the ellipse, and the floor."""
    R = T_map_base[:3, :3]
    flat = (R @ covariance[3:, 3:] @ R.T)[:2, :2]
    return config.factor * math.sqrt(max(0.0, float(np.linalg.eigvalsh(flat)[1]))) + config.floor_m(source)
