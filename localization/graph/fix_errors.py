"""Correlated error of fixes as a variable of the graph, one per keyframe: Gauss-Markov, with their sigma and time.

Without it a fix of 2.5 m at 10 Hz, correlated over 60 s, needs 35 times its sigma, and says nothing while dead
reckoning drifts. It has two parts, each (3,): the atmosphere, over minutes, and reflections and the filter of the
receiver, over seconds. Without the second, fixes would tell the heading ten times better than they do.
"""

import gtsam
import numpy as np

from geometry.arrays import Float64
from localization.gnss_gate import Position
from localization.graph.factors import E, X, antenna_factor, decay_factor
from localization.graph.smoother import Smoother

ERROR = 6
NO_HEIGHT_M = 1e3  # sigma of a height that says nothing


def prior_factor(key: int, fix: Position) -> gtsam.NonlinearFactor:
    """Factor of the error at the first fix, of which nothing is known."""
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([fix.total_m, fix.fast_m]))
    return gtsam.PriorFactorVector(E(key), np.zeros(ERROR), sigmas)


def change_factor(start: int, end: int, fix: Position, age_s: float, correlation_s: float) -> gtsam.NonlinearFactor:
    """Factor of the errors at two keyframes that are `age_s` apart."""
    keep = np.repeat(np.exp([-age_s / correlation_s, -age_s / fix.fast_s]), 3)
    sigma_m = np.concatenate([fix.change_m, fix.fast_m]) * np.sqrt(1.0 - keep**2)
    return decay_factor(E(start), E(end), keep, sigma_m)


def position_factor(key: int, fix: Position, arm_m: Float64, has_height: bool = True) -> gtsam.NonlinearFactor:
    """Factor of a fix beside the error at its keyframe."""
    return antenna_factor(X(key), E(key), fix.p_map_m, arm_m, with_height(fix.white_m, has_height))


def with_height(sigma_m: Float64, has_height: bool) -> Float64:
    """Sigmas (3,) of a position in `map` whose height may say nothing."""
    return sigma_m if has_height else np.array([*sigma_m[:2], NO_HEIGHT_M])


class FixErrors:
    """Begins at the first fix whose error is estimated, and ends at one whose error is not."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None  # key and stamp
        self._kind: Position | None = None
        self.guess: Float64 | None = None

    def clear(self) -> None:
        """Ends the chain; at a restart of the graph."""
        self._last = self._kind = self.guess = None

    def factors(self, key: int, stamp_ns: int, used: list[Position]) -> list[gtsam.NonlinearFactor]:
        """Factors of the error at the next keyframe, with the accepted fixes there; none without a chain."""
        if used and not used[-1].is_estimated:
            self.clear()
        elif used:
            if self._kind is not None and used[-1].solution is not self._kind.solution:
                self.clear()
            self._kind = used[-1]
        kind, last = self._kind, self._last
        if kind is None:
            return []
        self._last = key, stamp_ns
        if last is None or last[0] != key - 1:
            self.guess = np.zeros(ERROR)
            return [prior_factor(key, kind)]
        return [change_factor(key - 1, key, kind, (stamp_ns - last[1]) * 1e-9, kind.correlation_s)]

    def read(self, key: int, smoother: Smoother) -> None:
        """Takes the solution, from which the next keyframe begins."""
        if self.guess is not None:
            self.guess = smoother.value(E(key))
