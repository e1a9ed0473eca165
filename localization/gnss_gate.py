"""GNSS gate: accuracy by type of solution, and a test of each fix against the prediction."""

import math
from collections import deque
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.geodesy import Datum
from geometry.transforms import yaw_of
from messages.motion import PositionSource
from messages.sensors import GnssFix, GnssSolution

Sigma = Field(gt=0.0, le=100.0)
MAX_SPEED_MPS = 515.0  # at which civil receivers stop, by law: more is no measurement


class SolutionConfig(Config):
    """Accuracy of one type of solution; lower bound of the sigmas that a receiver reports."""

    horizontal_m: float = Sigma
    vertical_m: float = Sigma
    slow_share: float = Field(ge=0.0, lt=1.0, description="share of sigma that varies too slowly to average out")
    correlation_s: float = Field(ge=0.0, le=600.0, description="0: the rest is white from fix to fix")
    fast_share: float = Field(gt=0.0, lt=1.0, description="share of sigma that reflections change, beside the rest")
    is_used: bool
    is_estimated: bool = Field(description="its correlated error is a variable of the graph, else its sigma is widened")


class GnssConfig(Config):
    """Section `gnss` of map alignment."""

    sensor: str = Field(description="key of `sensors.gnss` of the machine")
    rtk_fixed: SolutionConfig
    rtk_float: SolutionConfig
    ppp: SolutionConfig
    sbas: SolutionConfig
    single: SolutionConfig
    fast_s: float = Field(gt=0.0, le=600.0, description="correlation time of the fast share of sigma")
    white_share: float = Field(gt=0.0, lt=1.0, description="share of sigma that is white, beside an estimated error")
    gate_sigma: float = Field(gt=1.0, le=10.0)
    gate_floor_m: float = Field(gt=0.0, le=1.0, description="innovations below are never rejected by sigma alone")
    heading_gate_sigma: float = Field(gt=1.0, le=10.0)
    heading_floor_deg: float = Field(gt=0.0, le=10.0)
    heading_sigma_deg: float = Field(gt=0.0, le=10.0, description="lower bound of the reported sigma")
    heading_slow_share: float = Field(ge=0.0, lt=1.0, description="as slow_share of a solution")
    stamp_s: float = Field(ge=0.0, le=0.5, description="error of the stamps of fixes, for good")
    min_satellites: int = Field(ge=4, le=30)
    max_correction_age_s: float = Field(gt=0.0, le=600.0)
    unknown_sigma_factor: float = Field(ge=1.0, le=10.0, description="of a solution's accuracy, for unknown sigmas")
    confirmation_fixes: int = Field(ge=1, le=100, description="consistent fixes after an outage or upgrade")
    outage_s: float = Field(gt=0.0, le=60.0)

    def at_rate(self, rate_hz: float) -> "GnssConfig":
        """The same for a receiver whose fixes are further apart than `outage_s`: two may be missing."""
        return self.model_copy(update={"outage_s": max(self.outage_s, 2.5 / rate_hz)})

    def of(self, solution: GnssSolution) -> SolutionConfig | None:
        """Configuration of a type of solution, None when it is unknown or not used."""
        rows = {
            GnssSolution.RTK_FIXED: self.rtk_fixed, GnssSolution.RTK_FLOAT: self.rtk_float,
            GnssSolution.PPP: self.ppp, GnssSolution.SBAS: self.sbas, GnssSolution.SINGLE: self.single,
        }  # fmt: skip
        row = rows.get(solution)
        return row if row is not None and row.is_used else None


class RejectionReason(StrEnum):
    """Reason why a fix was not used."""

    NONE = ""
    INVALID = "not finite or impossible"
    NO_SOLUTION = "no solution, or a kind not to be used"
    FEW_SATELLITES = "too few satellites"
    OLD_CORRECTIONS = "corrections too old"
    CONFIRMATION = "first fixes after an outage must agree"
    OUTLIER = "contradicts the prediction"
    SUSPECTED = "has contradicted what is independent of it, and not yet agreed with it again"
    REPEATED = "equal to the last one while the machine moves"
    STAMP = "stamp too far from the time of arrival"
    LATE = "not newer than the last one, or from before a gap"
    BEFORE_START = "before the first position, or while it was lost"
    SHED = "beside the shed, where UWB gives the position"


@dataclass(frozen=True)
class Position:
    """A fix in `map`: `sigma_m` (3,) for one factor, `slow_m` (3,) the slowly varying error.

    `velocity_mps` (3,) of the antenna with sigma, NaN when unknown. `total_m` (3,) is the sigma of the fix alone, and
    `change_m` (3,) that from which its changes follow: an unknown accuracy does not make it change faster; `fast_m`
    and `white_m` (3,) are shares of it. The correlated parts have the times `correlation_s` (0: not known) and `fast_s`
    and, where `is_estimated`, are a variable of the graph. Without `has_height` z is 0, where a start begins, and no
    measurement.
    """

    stamp_ns: int
    p_map_m: Float64
    sigma_m: Float64
    slow_m: Float64
    heading_rad: float
    heading_sigma_rad: float
    heading_slow_rad: float
    solution: GnssSolution
    velocity_mps: Float64
    velocity_sigma_mps: float
    total_m: Float64
    change_m: Float64 = field(default_factory=lambda: np.full(3, math.nan))
    fast_m: Float64 = field(default_factory=lambda: np.full(3, math.nan))
    white_m: Float64 = field(default_factory=lambda: np.full(3, math.nan))
    correlation_s: float = 0.0
    fast_s: float = 0.0
    is_estimated: bool = False
    has_height: bool = True

    @property
    def expected_m(self) -> Float64:
        """Sigma (3,) of the difference from the truth, by the errors that the graph assumes."""
        parts = (self.total_m, self.fast_m, self.white_m) if self.is_estimated else (self.total_m,)
        return np.asarray(np.linalg.norm(parts, axis=0))


def source_of(solution: GnssSolution) -> PositionSource:
    """Position source of a type of solution."""
    if solution is GnssSolution.RTK_FIXED:
        return PositionSource.RTK_FIXED
    return PositionSource.RTK_FLOAT if solution in (GnssSolution.RTK_FLOAT, GnssSolution.PPP) else PositionSource.SINGLE


def is_sane(fix: GnssFix) -> bool:
    """Whether the position is finite and all values are in range (NaN height, sigmas, heading, velocity: unknown)."""
    on_earth = (
        abs(fix.latitude_rad) <= math.pi / 2 and abs(fix.longitude_rad) <= math.pi and not abs(fix.height_m) >= 2e4
    )
    sigmas = fix.sigma_enu_m.shape == (3,) and not np.any((fix.sigma_enu_m < 0.0) | np.isinf(fix.sigma_enu_m))
    is_known = fix.latitude_rad != 0.0 or fix.longitude_rad != 0.0  # zeros are what receivers state without a position
    return on_earth and sigmas and is_known


def repeats(fix: GnssFix, last: GnssFix) -> bool:
    """Whether position, velocity and heading are those of an older fix to the bit: held by receiver or driver."""
    now, then = (
        [f.latitude_rad, f.longitude_rad, f.height_m, f.heading_rad, *f.velocity_enu_mps.tolist()] for f in (fix, last)
    )
    return fix.stamp_ns > last.stamp_ns and np.array_equal(now, then, equal_nan=True)


def check(fix: GnssFix, config: GnssConfig) -> RejectionReason:
    """Checks a fix by what is known of it: an unknown value is no reason to refuse it, and vouches for nothing."""
    if config.of(fix.solution) is None:  # a receiver without a position reports NaN
        return RejectionReason.NO_SOLUTION
    if not is_sane(fix):
        return RejectionReason.INVALID
    if fix.satellites is not None and fix.satellites < config.min_satellites:
        return RejectionReason.FEW_SATELLITES
    needs_corrections = fix.solution in (GnssSolution.RTK_FIXED, GnssSolution.RTK_FLOAT)
    if needs_corrections and fix.correction_age_s > config.max_correction_age_s:
        return RejectionReason.OLD_CORRECTIONS
    return RejectionReason.NONE


def position_of(fix: GnssFix, datum: Datum, config: GnssConfig, rate_hz: float) -> Position:
    """A checked fix in `map`, with sigmas widened for time correlation.

    Unknown sigmas are those of the solution times `unknown_sigma_factor`.
    Noise of correlation time τ sampled at rate f has the information of one independent sample per 2 τ (2 τ f > 1).
    """
    row = config.of(fix.solution)
    assert row is not None, "check comes first"
    floor = np.array([row.horizontal_m, row.horizontal_m, row.vertical_m])
    unknown = config.unknown_sigma_factor * floor
    sigma = np.where(np.isnan(fix.sigma_enu_m), unknown, np.maximum(fix.sigma_enu_m, floor))
    fast = sigma * math.sqrt(1.0 - row.slow_share**2) * math.sqrt(max(1.0, 2.0 * row.correlation_s * rate_hz))
    heading_sigma = max(fix.sigma_heading_rad, math.radians(config.heading_sigma_deg))  # NaN sigma: stays NaN, not used
    has_heading = math.isfinite(fix.heading_rad) and math.isfinite(fix.sigma_heading_rad)
    has_height = math.isfinite(fix.height_m)
    p = np.array(datum.to_map(fix.latitude_rad, fix.longitude_rad, fix.height_m if has_height else datum.height_m))
    heading = fix.heading_rad if has_heading else math.nan
    share = config.heading_slow_share
    heading_fast, heading_slow = heading_sigma * math.sqrt(1.0 - share**2), heading_sigma * share
    is_possible = bool(np.all(np.abs(fix.velocity_enu_mps) <= MAX_SPEED_MPS))
    velocity_mps = fix.velocity_enu_mps if is_possible else np.full(3, math.nan)
    change = np.where(np.isnan(fix.sigma_enu_m), floor, sigma)
    fast_m, white_m = row.fast_share * change, config.white_share * change
    return Position(
        fix.stamp_ns, p, fast, sigma * row.slow_share, heading, heading_fast, heading_slow, fix.solution,
        velocity_mps, fix.sigma_velocity_mps, sigma, change, fast_m, white_m, row.correlation_s,
        config.fast_s, row.is_estimated, has_height,
    )  # fmt: skip


def propagate(fix: Position, T_then: Float64, T_now: Float64, arm_m: Float64, T_map_odom: Float64) -> Position:
    """Propagates a fix from one pose of base in `odom` to another; `arm_m` is the antenna in base."""
    displacement = (T_now - T_then)[:3, :3] @ arm_m + (T_now - T_then)[:3, 3]
    turn = yaw_of(T_now) - yaw_of(T_then)
    p = fix.p_map_m + T_map_odom[:3, :3] @ displacement
    return replace(fix, p_map_m=p, heading_rad=wrap(fix.heading_rad + turn))


def distance(innovation_m: Float64, covariance: Float64) -> float:
    """Mahalanobis distance of an innovation."""
    return math.sqrt(max(0.0, float(innovation_m @ np.linalg.solve(covariance, innovation_m))))


class GnssGate:
    """Rejects fixes that contradict the prediction, and fixes after an outage until several are consistent."""

    def __init__(self, config: GnssConfig) -> None:
        self._config = config
        self._recent: deque[tuple[Float64, Float64]] = deque(maxlen=config.confirmation_fixes)  # and variance
        self._trusted = GnssSolution.NONE
        self._accepted_ns: int | None = None

    def trust(self, position: Position) -> None:
        """Records an accepted fix."""
        self._trusted, self._accepted_ns = position.solution, position.stamp_ns

    def is_recent(self, stamp_ns: int) -> bool:
        """Whether a fix was accepted within the outage time."""
        return self._accepted_ns is not None and stamp_ns - self._accepted_ns <= self._config.outage_s * 1e9

    @property
    def innovation_m(self) -> float:
        """Horizontal distance of the newest fix from its prediction."""
        return float(np.linalg.norm(self._recent[-1][0][:2])) if self._recent else 0.0

    def evaluate(self, position: Position, predicted_m: Float64, covariance: Float64) -> RejectionReason:
        """Tests a fix against the predicted antenna position with its covariance (3, 3)."""
        innovation = position.p_map_m - predicted_m
        if not position.has_height:
            innovation[2] = 0.0
        self._recent.append((innovation, np.diag(covariance)))
        own = np.diag(position.expected_m**2)
        if self._is_new(position) and not self._are_consistent(np.diag(own)):
            return RejectionReason.CONFIRMATION
        tested = slice(0, 2) if position.is_estimated or not position.has_height else slice(0, 3)  # see `has_height`
        if not self.passes(innovation[tested], (covariance + own)[tested, tested]):
            return RejectionReason.OUTLIER
        self.trust(position)
        return RejectionReason.NONE

    def passes(self, innovation_m: Float64, covariance: Float64) -> bool:
        """Whether an innovation is inside the gate."""
        floor = self._config.gate_floor_m / self._config.gate_sigma
        return distance(innovation_m, covariance + floor**2 * np.eye(len(innovation_m))) <= self._config.gate_sigma

    def has_height(self, position: Position, predicted_m: Float64, covariance: Float64) -> bool:
        """Whether the height agrees with the prediction too.

        That of code wanders by tens of metres while the position is right; one of wrong ambiguities refuses the fix.
        """
        if not position.has_height:
            return False
        variance = covariance[2:, 2:] + position.expected_m[2] ** 2
        return self.passes((position.p_map_m - predicted_m)[2:], variance)

    def _is_new(self, position: Position) -> bool:
        if self._accepted_ns is None or position.solution > self._trusted:
            return True
        return not self.is_recent(position.stamp_ns)

    def _are_consistent(self, variance: Float64) -> bool:
        """Whether the spread of the last innovations agrees with their variance, and its growth in the prediction."""
        if len(self._recent) < self._config.confirmation_fixes:
            return False
        innovations, predicted = np.array(self._recent).swapaxes(0, 1)
        sigma_m = np.sqrt(variance + np.maximum(predicted[-1] - predicted[0], 0.0))
        return bool(np.all(np.ptp(innovations, axis=0) <= 2.0 * self._config.gate_sigma * sigma_m))
