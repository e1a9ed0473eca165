"""Fixed-lag smoother: adds keyframes and returns the newest state with its covariance."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64
from localization.graph.factors import B, C, S, V, X
from localization.graph.imu_preintegration import constant_bias

POSE, VELOCITY, BIAS, SLIP = 6, 3, 6, 4
FAILURES = RuntimeError, IndexError, ValueError


class SmootherConfig(Config):
    """Section `smoother` of map alignment."""

    lag_s: float = Field(gt=0.2, le=60.0)
    period_s: float = Field(gt=0.0, le=1.0, description="between keyframes without fixes")
    wait_s: float = Field(ge=0.0, le=1.0, description="for a late fix before a keyframe is added without it")
    relinearize_threshold: float = Field(gt=0.0, le=1.0)
    bend_m: float = Field(gt=0.0, le=1.0, description="turn times shift by a fix that needs a new linearization of all")
    wide_m: float = Field(gt=0.0, le=100.0, description="sigma of a start above which QR replaces Cholesky")
    max_jump_sigmas: float = Field(gt=1.0, le=100.0, description="of a solution from its prediction, beyond wide_m")
    wide_mps2: float = Field(gt=0.0, le=100.0, description="the same for the accelerometer bias")


@dataclass(frozen=True)
class State:
    """State of a keyframe; the body has `base` axes and its origin at the IMU.

    `covariance` (6, 6) of the pose, rotation then translation in the body; `sigmas` (19,): pose, velocity, bias, slip.
    """

    stamp_ns: int
    T_map_body: Float64
    velocity_mps: Float64
    bias: Float64
    slip: Float64
    covariance: Float64
    sigmas: Float64

    @property
    def is_finite(self) -> bool:
        """Whether all values are finite and all variances positive."""
        parts = (self.T_map_body, self.velocity_mps, self.bias, self.slip, self.covariance, self.sigmas)
        return all(bool(np.all(np.isfinite(p))) for p in parts) and bool(np.all(np.diag(self.covariance) > 0.0))


class SmootherFailure(Exception):
    """The graph could not be solved; nothing may be added before `Smoother.start`."""


class Smoother:
    """Wraps gtsam's IncrementalFixedLagSmoother."""

    def __init__(self, config: SmootherConfig) -> None:
        self._config = config
        self._index = 0
        self._origin_ns = 0
        self._stamps: OrderedDict[int, int] = OrderedDict()
        self._graph = self._new_graph()
        self.state: State | None = None

    def start(self, state: State) -> None:
        """Starts a new graph at `state`, with its covariance and the sigmas of the rest as priors.

        Raises SmootherFailure.
        """
        # Cholesky takes 60 % of the time of QR, and fails at priors of metres beside standstill factors of 0.5 mm,
        # and at biases that nothing has measured yet beside their random walk
        state = replace(state, sigmas=np.concatenate([np.sqrt(np.diag(state.covariance)), state.sigmas[6:]]))
        self._begin(state)
        self._index += 1
        k, sigma = self._index, gtsam.noiseModel.Diagonal.Sigmas
        factors = gtsam.NonlinearFactorGraph()
        pose_noise = gtsam.noiseModel.Gaussian.Covariance(state.covariance)
        factors.add(gtsam.PriorFactorPose3(X(k), gtsam.Pose3(state.T_map_body), pose_noise))
        factors.add(gtsam.PriorFactorPoint3(V(k), state.velocity_mps, sigma(state.sigmas[6:9])))
        factors.add(gtsam.PriorFactorConstantBias(B(k), constant_bias(state.bias), sigma(state.sigmas[9:15])))
        factors.add(gtsam.PriorFactorVector(S(k), state.slip, sigma(state.sigmas[15:19])))
        try:
            self._update(k, state, factors)
        except FAILURES as error:
            raise SmootherFailure(_line(error)) from error
        self.state = state

    def relinearize(self) -> None:
        """Starts a new graph at the newest keyframe with all that the old one knows of it.

        The oldest keyframe of a graph keeps the values at which its past was linearized. When a fix turns and shifts
        the others by more than a little, they no longer fit to it, and the solution turns away by any angle.
        Raises SmootherFailure.
        """
        old, state = self._graph, self.state
        assert state is not None, "start comes first"
        at, solution = gtsam.Values(old.getLinearizationPoint()), old.calculateEstimate()
        keys = solution.keys()
        newest = [key for key in keys if gtsam.symbolIndex(key) == self._index]
        for key in set(keys).difference(newest):
            at.erase(key)
            solution.erase(key)
        factors = gtsam.NonlinearFactorGraph()
        try:
            known = old.getFactors().linearize(old.getLinearizationPoint()).marginal(newest)
            for number in range(known.size()):
                factors.add(gtsam.LinearContainerFactor(known.at(number), at))
            self._begin(state)
            self._graph.update(factors, solution, dict.fromkeys(newest, 0.0))
        except FAILURES as error:
            raise SmootherFailure(_line(error)) from error
        self._stamps[self._index] = state.stamp_ns

    def _begin(self, state: State) -> None:
        cfg, bias_sigma = self._config, float(np.max(state.sigmas[9:12]))
        is_wide = float(np.max(state.sigmas[3:6])) > cfg.wide_m or bias_sigma > cfg.wide_mps2
        self._graph, self._origin_ns = self._new_graph(is_wide), state.stamp_ns
        self._stamps.clear()

    def key_near(self, stamp_ns: int, tolerance_ns: int) -> tuple[int, int] | None:
        """Key and stamp of the keyframe nearest to a time, at least 0.5 s inside the lag."""
        oldest = next(reversed(self._stamps.values()), 0) - int((self._config.lag_s - 0.5) * 1e9)
        near = [(abs(s - stamp_ns), k, s) for k, s in self._stamps.items() if s >= oldest]
        best = min(near, default=None)
        return (best[1], best[2]) if best is not None and best[0] <= tolerance_ns else None

    def is_within_lag(self, key: int) -> bool:
        """Whether a keyframe is at least 0.5 s inside the lag, so that a factor may refer to it."""
        newest = next(reversed(self._stamps.values()), 0)
        return key in self._stamps and self._stamps[key] >= newest - int((self._config.lag_s - 0.5) * 1e9)

    def calibration(self, key: int) -> tuple[Float64, Float64]:
        """Scale and bias of the anchors at a keyframe added with a calibration, and their covariance."""
        return self._graph.calculateEstimateVector(C(key)), self._graph.marginalCovariance(C(key))

    @property
    def next_key(self) -> int:
        """Key of the next keyframe."""
        return self._index + 1

    def add(
        self,
        guess: State,
        imu_factor: gtsam.CombinedImuFactor,
        slip_sigma: Float64,
        factors: Sequence[gtsam.NonlinearFactor],
        variables: Mapping[int, Float64] | None = None,
    ) -> State:
        """Adds the keyframe `next_key` at `guess`; `variables`: first values of the others to which `factors` refer.

        Raises SmootherFailure.
        """
        k = self._index + 1
        graph = gtsam.NonlinearFactorGraph()
        graph.add(imu_factor)
        graph.add(
            gtsam.BetweenFactorVector(S(k - 1), S(k), np.zeros(SLIP), gtsam.noiseModel.Diagonal.Sigmas(slip_sigma))
        )
        for factor in factors:
            graph.add(factor)
        try:
            self._update(k, guess, graph, variables)
            state = self._read(k, guess.stamp_ns)
            self._check_jump(guess, state)
        except FAILURES as error:
            raise SmootherFailure(_line(error)) from error
        self._index, self.state = k, state
        return state

    def value(self, variable: int) -> Float64:
        """Solution of one of the `variables` with which a keyframe was added."""
        return np.asarray(self._graph.calculateEstimateVector(variable))

    def _check_jump(self, guess: State, state: State) -> None:
        """Raises ValueError for a solution far from what was expected: the solver has lost its way."""
        jump_m = float(np.linalg.norm(state.T_map_body[:3, 3] - guess.T_map_body[:3, 3]))
        limit_m = self._config.wide_m + self._config.max_jump_sigmas * float(np.linalg.norm(guess.sigmas[3:6]))
        if jump_m > limit_m:
            raise ValueError(f"the solution jumps by {jump_m:.1f} m")

    def _new_graph(self, is_wide: bool = False) -> gtsam.IncrementalFixedLagSmoother:
        parameters = gtsam.ISAM2Params()
        parameters.findUnusedFactorSlots = True
        parameters.setFactorization("QR" if is_wide else "CHOLESKY")
        parameters.relinearizeSkip = 1
        parameters.setRelinearizeThreshold(self._config.relinearize_threshold)
        return gtsam.IncrementalFixedLagSmoother(self._config.lag_s, parameters)

    def _update(
        self, k: int, state: State, factors: gtsam.NonlinearFactorGraph, variables: Mapping[int, Float64] | None = None
    ) -> None:
        time_s = (state.stamp_ns - self._origin_ns) * 1e-9
        values = gtsam.Values()
        values.insert(X(k), gtsam.Pose3(state.T_map_body))
        values.insert(V(k), np.asarray(state.velocity_mps, np.float64))
        values.insert(B(k), constant_bias(state.bias))
        values.insert(S(k), np.asarray(state.slip, np.float64))
        keys = [X(k), V(k), B(k), S(k)]
        for key, value in (variables or {}).items():
            values.insert(key, value)
            keys.append(key)
        self._graph.update(factors, values, dict.fromkeys(keys, time_s))
        self._stamps[k] = state.stamp_ns
        limit_ns = state.stamp_ns - int(self._config.lag_s * 1e9)
        while self._stamps and next(iter(self._stamps.values())) < limit_ns:
            self._stamps.popitem(last=False)

    def _read(self, k: int, stamp_ns: int) -> State:
        graph = self._graph
        covariance = graph.marginalCovariance(X(k))
        sigmas = self._sigmas(k, covariance)
        state = State(
            stamp_ns,
            np.asarray(graph.calculateEstimatePose3(X(k)).matrix()),
            np.asarray(graph.calculateEstimateVector(V(k))),
            np.asarray(graph.calculateEstimateConstantBias(B(k)).vector()),
            np.asarray(graph.calculateEstimateVector(S(k))),
            0.5 * (covariance + covariance.T),
            sigmas,
        )
        if not state.is_finite:
            raise ValueError("the solution is not finite")
        return state

    def _sigmas(self, k: int, covariance: Float64) -> Float64:
        """Sigmas (19,): those of the pose are updated every time, the others, which change slowly, one part in turn."""
        sigmas = self.state.sigmas.copy() if self.state is not None else np.zeros(19)
        sigmas[:6] = np.sqrt(np.diag(covariance))
        key, part = ((V, slice(6, 9)), (B, slice(9, 15)), (S, slice(15, 19)))[k % 3]
        sigmas[part] = np.sqrt(np.diag(self._graph.marginalCovariance(key(k))))
        return sigmas


def _line(error: Exception) -> str:
    lines = [line for line in str(error).splitlines() if line]
    return lines[0] if lines else "unknown"
