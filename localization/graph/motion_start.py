"""Start in motion: pose, velocity, biases and slip from the fixes of one antenna, IMU and wheels of a window.

All keyframes of the window are solved at once, from four headings about the course of the fixes. A start is proven when
one solution is left: those that end elsewhere fit worse, the residuals agree with their sigmas, and the heading is
known. Forwards and backwards are distinguished by the sign of the wheel speeds, without wheels by the accelerometer.
"""

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.transforms import transform, yaw_of
from localization.dead_reckoning.initial_alignment import excess_tilt
from localization.gnss_gate import Position
from localization.graph.factors import (
    B,
    E,
    S,
    V,
    X,
    heading_factor,
    no_sideslip_factor,
    standstill_factor,
    wheel_factor,
)
from localization.graph.fix_errors import ERROR, change_factor, position_factor, prior_factor
from localization.graph.motion_window import Interval, MotionWindow
from localization.graph.smoother import FAILURES, SLIP, State

STATE = 19
HEADINGS_RAD = (0.0, math.pi, 0.5 * math.pi, -0.5 * math.pi)
Degrees = Field(gt=0.0, le=90.0)


class MotionStartConfig(Config):
    """Section `motion_start` of map alignment."""

    spacing_s: float = Field(gt=0.0, le=10.0, description="between the fixes that are used")
    longest_s: float = Field(gt=0.0, le=2.0, description="between keyframes, without a fix")
    keyframes: int = Field(ge=5, le=200, description="in the window")
    period_s: float = Field(gt=0.0, le=60.0, description="between attempts")
    period_share: float = Field(ge=0.0, le=1.0, description="the same per age of the window: long ones take longer")
    iterations: int = Field(ge=1, le=200)
    fixes: int = Field(ge=3, le=100, description="fewest")
    distance_m: float = Field(gt=0.0, le=100.0, description="fewest metres between two fixes of the window")
    distance_sigmas: float = Field(ge=0.0, le=100.0, description="the same, in sigmas of a fix against the first")
    tilt_prior_deg: float = Degrees
    velocity_prior_mps: float = Field(gt=0.0, le=200.0)
    gyro_bias_dps: float = Field(gt=0.0, le=10.0, description="sigma at power-on")
    accelerometer_bias_mps2: float = Field(gt=0.0, le=2.0, description="sigma at power-on")
    correlation_s: float = Field(gt=0.0, le=1000.0, description="of fixes whose solution has none")
    heading_sigma_deg: float = Degrees
    tilt_sigma_deg: float = Degrees
    ratio: float = Field(gt=1.0, le=100.0, description="largest squared residual over its expectation")
    worse: float = Field(gt=0.0, le=1000.0, description="squared residuals of other headings, more than the best")
    apart_deg: float = Degrees


@dataclass(frozen=True)
class Model:
    """What the solver needs of the vehicle: lever arms from the IMU, wheel noise and slip, standstill sigmas."""

    antenna_m: Float64
    base_m: Float64
    wheel_density: Float64
    slip: Float64
    slip_sigma: Float64
    slip_walk: Float64
    standstill_rad: float
    standstill_m: float
    sideslip_mps: float
    max_tilt_deg: float


@dataclass(frozen=True)
class _Solution:
    cost: float
    values: gtsam.Values

    def heading_rad(self, key: int) -> float:
        return yaw_of(self.values.atPose3(X(key)).matrix())


class MotionStart:
    """Gathers the window while nothing is known, and tries to start from it; `awaited` names what is missing."""

    def __init__(self, config: MotionStartConfig, model: Model, window: MotionWindow) -> None:
        self._config, self._model, self.window = config, model, window
        self._tried_ns: int | None = None
        self.awaited = ""

    def clear(self) -> None:
        """Drops the window."""
        self.window.clear()
        self._tried_ns = None
        self.awaited = ""

    def state(self) -> State | None:
        """The proven state at the newest fix, None while it is not; tried once per period."""
        window, cfg = self.window, self._config
        if window.first is None or not window.intervals or window.intervals[-1].fix is None:
            return None
        age_s = (window.last_ns - window.first.stamp_ns) * 1e-9
        period_ns = round(max(cfg.period_s, cfg.period_share * age_s) * 1e9)
        if self._tried_ns is not None and 0 <= window.last_ns - self._tried_ns < period_ns:
            return None
        self._tried_ns = window.last_ns
        self.awaited = self._too_short()
        return None if self.awaited else self._solve()

    def _too_short(self) -> str:
        """What the window lacks, before anything is solved."""
        cfg, fixes = self._config, self.window.fixes
        if len(fixes) < cfg.fixes:
            return f"{cfg.fixes - len(fixes)} more fixes"
        points = np.array([f.p_map_m[:2] for f in fixes])
        age_s = (fixes[-1].stamp_ns - fixes[0].stamp_ns) * 1e-9
        needed_m = max(cfg.distance_m, cfg.distance_sigmas * self._relative_sigma_m(fixes[-1], age_s))
        moved_m = float(np.max(np.linalg.norm(points - points[-1], axis=1)))
        return "" if moved_m >= needed_m else f"motion: {moved_m:.1f} of {needed_m:.1f} m for the heading"

    def _relative_sigma_m(self, fix: Position, age_s: float) -> float:
        """Sigma of the displacement between two fixes."""
        slow_m = fix.change_m * math.sqrt(1.0 - math.exp(-age_s / self._correlation_s(fix)))
        fast_m = fix.fast_m * math.sqrt(1.0 - math.exp(-age_s / fix.fast_s))
        return math.sqrt(2.0 * float(np.max((slow_m**2 + fast_m**2 + fix.white_m**2)[:2])))

    def _correlation_s(self, fix: Position) -> float:
        return fix.correlation_s or self._config.correlation_s

    def _solve(self) -> State | None:
        graph, size = self._graph()
        found: list[_Solution] = []
        for offset_rad in HEADINGS_RAD:
            try:
                found.append(self._optimized(graph, self._guess(offset_rad)))
            except FAILURES:
                continue
        if not found:
            self.awaited = "motion: nothing fits yet"
            return None
        return self._proven(graph, size, sorted(found, key=lambda s: s.cost))

    def _optimized(self, graph: gtsam.NonlinearFactorGraph, guess: gtsam.Values) -> _Solution:
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(self._config.iterations)
        parameters.setLinearSolverType("MULTIFRONTAL_QR")
        parameters.setRelativeErrorTol(1e-3)
        parameters.setAbsoluteErrorTol(1e-2)
        values = gtsam.LevenbergMarquardtOptimizer(graph, guess, parameters).optimize()
        return _Solution(2.0 * graph.error(values), values)

    def _proven(self, graph: gtsam.NonlinearFactorGraph, size: int, found: list[_Solution]) -> State | None:
        """The state of the best solution, unless another is left or its residuals or sigmas are too large."""
        cfg, best, key = self._config, found[0], len(self.window.intervals)
        up = float(best.values.atPose3(X(key)).matrix()[2, 2])
        self.awaited = excess_tilt(up, self._model.max_tilt_deg)
        if self.awaited:
            return None
        if not best.cost <= cfg.ratio * size:
            self.awaited = f"agreement of fixes, IMU and wheels: {math.sqrt(best.cost / size):.1f} sigma apart"
            return None
        for other in found[1:]:
            apart_deg = abs(math.degrees(wrap(other.heading_rad(key) - best.heading_rad(key))))
            if apart_deg > cfg.apart_deg and other.cost - best.cost < cfg.worse:
                self.awaited = f"motion: a heading {apart_deg:.0f} deg apart fits too"
                return None
        state = self._state(graph, best.values)
        if state is None:
            self.awaited = "motion: nothing is observable yet"
            return None
        tilt_deg, heading_deg = np.degrees([float(np.max(state.sigmas[:2])), float(state.sigmas[2])])
        if not (tilt_deg <= cfg.tilt_sigma_deg and heading_deg <= cfg.heading_sigma_deg):
            self.awaited = f"motion: heading known to {heading_deg:.1f} deg, tilt to {tilt_deg:.1f} deg"
            return None
        return state

    def _state(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> State | None:
        """State of the newest keyframe, None when it is not observable.

        The covariance is by QR: biases walk by 1e-6 beside priors of metres, and Cholesky loses the difference.
        """
        key, order = len(self.window.intervals), gtsam.Ordering()
        mine = [symbol(key) for symbol in (X, V, B, S)]
        for other in sorted(set(values.keys()) - set(mine)):
            order.push_back(other)
        for one in mine:
            order.push_back(one)
        jacobian = np.asarray(graph.linearize(values).jacobian(order)[0])
        root = np.asarray(np.linalg.qr(jacobian, mode="r"))[-STATE:, -STATE:]
        if float(np.min(np.abs(np.diag(root)))) < 1e-6:
            return None
        inverse = np.linalg.inv(root)
        joint = inverse @ inverse.T
        covariance, sigmas = joint[:6, :6], np.sqrt(np.diag(joint))
        return State(
            self.window.last_ns, np.asarray(values.atPose3(X(key)).matrix()), np.asarray(values.atVector(V(key))),
            np.asarray(values.atConstantBias(B(key)).vector()), np.asarray(values.atVector(S(key))),
            0.5 * (covariance + covariance.T), sigmas,
        )  # fmt: skip

    def _graph(self) -> tuple[gtsam.NonlinearFactorGraph, int]:
        """All factors of the window, and their expected squared residual."""
        window, graph = self.window, gtsam.NonlinearFactorGraph()
        assert window.first is not None, "checked by the caller"
        self._add_priors(graph, window.first)
        last: tuple[int, Position] = 0, window.first
        for key, interval in enumerate(window.intervals, start=1):
            graph.add(
                gtsam.CombinedImuFactor(X(key - 1), V(key - 1), X(key), V(key), B(key - 1), B(key),
                                        interval.preintegrated)
            )  # fmt: skip
            root = math.sqrt(interval.dt_s)
            graph.add(
                gtsam.BetweenFactorVector(S(key - 1), S(key), np.zeros(SLIP), _sigmas(root * self._model.slip_walk))
            )
            graph.add(self._motion_factor(key, interval))
            if interval.fix is not None:
                self._add_fix(graph, key, interval.fix, last)
                last = key, interval.fix
        values = sum(graph.at(k).dim() for k in range(graph.size()))
        unknowns = STATE * (len(window.intervals) + 1) + ERROR * len(window.fixes)
        return graph, max(1, values - unknowns)

    def _add_priors(self, graph: gtsam.NonlinearFactorGraph, first: Position) -> None:
        cfg, model = self._config, self._model
        tilt, free = math.radians(cfg.tilt_prior_deg), 1e3
        pose = gtsam.Pose3(transform(first.p_map_m, (0.0, 0.0, 0.0)))
        # roll and pitch alone: the heading is free whatever the guess
        graph.add(gtsam.PoseTranslationPrior3D(X(0), pose, _sigmas(np.full(3, free))))
        up = gtsam.Unit3(np.array([0.0, 0.0, 1.0]))
        graph.add(gtsam.AttitudeFactorPose3(X(0), up, _sigmas(np.full(2, tilt)), up))
        graph.add(gtsam.PriorFactorPoint3(V(0), np.zeros(3), _sigmas(np.full(3, cfg.velocity_prior_mps))))
        bias = np.repeat([cfg.accelerometer_bias_mps2, math.radians(cfg.gyro_bias_dps)], 3)
        graph.add(gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), _sigmas(bias)))
        graph.add(gtsam.PriorFactorVector(S(0), model.slip, _sigmas(model.slip_sigma)))
        graph.add(prior_factor(0, first))
        self._add_position(graph, 0, first)

    def _motion_factor(self, key: int, interval: Interval) -> gtsam.NonlinearFactor:
        model = self._model
        if interval.is_standstill:
            return standstill_factor(key - 1, key, np.full(3, model.standstill_rad), np.full(3, model.standstill_m))
        if interval.columns is not None:
            sigma = model.wheel_density * math.sqrt(interval.dt_s)
            return wheel_factor(key - 1, key, interval.columns, model.base_m, sigma)
        return no_sideslip_factor(key, interval.rate_radps, model.base_m, model.sideslip_mps)

    def _add_fix(self, graph: gtsam.NonlinearFactorGraph, key: int, fix: Position, last: tuple[int, Position]) -> None:
        age_s = (fix.stamp_ns - last[1].stamp_ns) * 1e-9
        graph.add(change_factor(last[0], key, fix, age_s, self._correlation_s(fix)))
        self._add_position(graph, key, fix)

    def _add_position(self, graph: gtsam.NonlinearFactorGraph, key: int, fix: Position) -> None:
        begins = key == 0 and not any(f.has_height for f in self.window.fixes)  # at height 0, by definition
        graph.add(position_factor(key, fix, self._model.antenna_m, fix.has_height or begins))
        if math.isfinite(fix.heading_rad):
            graph.add(heading_factor(key, fix.heading_rad, math.hypot(fix.heading_sigma_rad, fix.heading_slow_rad)))

    def _guess(self, offset_rad: float) -> gtsam.Values:
        """Level poses along the fixes, with headings by the gyro from the course between the two farthest fixes."""
        window = self.window
        assert window.first is not None, "checked by the caller"
        stamps = np.array([window.first.stamp_ns, *(i.stamp_ns for i in window.intervals)], np.int64)
        t_s = (stamps - stamps[0]) * 1e-9
        fixes = window.fixes
        fix_s = np.array([(f.stamp_ns - stamps[0]) * 1e-9 for f in fixes])
        points = np.column_stack([np.interp(t_s, fix_s, [f.p_map_m[k] for f in fixes]) for k in range(3)])
        velocity = np.gradient(points, t_s, axis=0)
        turned = np.concatenate([[0.0], np.cumsum([i.turn_rad for i in window.intervals])])
        fastest = int(np.argmax(np.hypot(velocity[:, 0], velocity[:, 1])))
        course = math.atan2(velocity[fastest, 1], velocity[fastest, 0])
        yaw = course - turned[fastest] + turned + offset_rad
        values, at_fix = gtsam.Values(), {0, *(k for k, i in enumerate(window.intervals, start=1) if i.fix is not None)}
        for key in range(len(stamps)):
            T = transform(points[key], (0.0, 0.0, float(yaw[key])))
            T[:3, 3] -= T[:3, :3] @ self._model.antenna_m
            values.insert(X(key), gtsam.Pose3(T))
            values.insert(V(key), velocity[key].copy())
            values.insert(B(key), gtsam.imuBias.ConstantBias())
            values.insert(S(key), self._model.slip.copy())
            if key in at_fix:
                values.insert(E(key), np.zeros(ERROR))
        return values


def _sigmas(sigmas: Float64) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigmas, np.float64))
