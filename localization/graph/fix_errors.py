"""Correlated error of fixes as a variable of the graph, one per keyframe: Gauss-Markov, with their sigma and time.

Without it a fix of 2.5 m at 10 Hz, correlated over 60 s, needs 35 times its sigma, and says nothing while dead
reckoning drifts.
"""

import math

import gtsam
import numpy as np

from geometry.arrays import Float64
from localization.gnss_gate import Position
from localization.graph.factors import E, X, antenna_factor, decay_factor
from localization.graph.smoother import Smoother


class FixErrors:
    """Begins at the first fix whose error is estimated, and ends at one whose error is not."""

    def __init__(self, white_share: float) -> None:
        self._white_share = white_share
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
            self.guess = np.zeros(3)
            sigmas = gtsam.noiseModel.Diagonal.Sigmas(kind.total_m)
            return [gtsam.PriorFactorVector(E(key), np.zeros(3), sigmas)]
        keep = math.exp(-(stamp_ns - last[1]) * 1e-9 / kind.correlation_s)
        return [decay_factor(E(key - 1), E(key), keep, kind.change_m * math.sqrt(1.0 - keep**2))]

    def position_factor(self, key: int, fix: Position, arm_m: Float64) -> gtsam.CustomFactor:
        """Factor of a fix beside the error at its keyframe."""
        return antenna_factor(X(key), E(key), fix.p_map_m, arm_m, self._white_share * fix.change_m)

    def read(self, key: int, smoother: Smoother) -> None:
        """Takes the solution, from which the next keyframe begins."""
        if self.guess is not None:
            self.guess = smoother.value(E(key))
