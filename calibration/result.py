"""Result of a calibration: values with their errors, a comparison of two halves of the trial, and a plot."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from messages.errors import HeadlandError

MAX_RATIO = 3.0  # two halves that differ by more sigmas do not confirm a value
PLOT_POINTS = 400


class NotEnough(HeadlandError):
    """The recording does not determine the value; `key` names what is missing, `has` of `needs` was recorded."""

    def __init__(self, key: str, has: float, needs: float) -> None:
        super().__init__(f"{key}: {has:g} of {needs:g}")
        self.key, self.has, self.needs = key, has, needs


@dataclass(frozen=True)
class Estimate:
    """A value of the configuration by its dotted key, in its unit there, with standard deviation and present value."""

    key: str
    value: float
    sigma: float
    present: float


@dataclass(frozen=True)
class Plot:
    """What the value was read from: points (N, 2) and a line (M, 2), with the keys of the axes' names."""

    x: str
    y: str
    points: Float64
    line: Float64


@dataclass(frozen=True)
class CalibrationResult:
    """Values of one trial; `ratio` is the difference of two independent halves over its standard deviation."""

    estimates: tuple[Estimate, ...]
    ratio: float
    plot: Plot

    @property
    def is_verified(self) -> bool:
        """Whether the halves agree."""
        return math.isfinite(self.ratio) and self.ratio <= MAX_RATIO


def weighted_mean(values: Float64, least_sigma: float) -> tuple[float, float]:
    """Mean of (N,) and its standard deviation: by the scatter, of one value at least `least_sigma`."""
    n = len(values)
    scatter = float(np.std(values, ddof=1)) if n > 1 else math.inf
    return float(np.mean(values)), max(scatter, least_sigma) / math.sqrt(n)


def half_ratio(values: Float64, least_sigma: float) -> float:
    """Difference of the means of first and second half over its standard deviation; infinite for few values."""
    if len(values) < 4:
        return math.inf
    (a, sigma_a), (b, sigma_b) = (weighted_mean(half, least_sigma) for half in np.array_split(values, 2))
    return abs(a - b) / math.hypot(sigma_a, sigma_b)


def plot_of(x: str, y: str, xs: Float64, ys: Float64, line: Sequence[tuple[float, float]]) -> Plot:
    """Plot of at most `PLOT_POINTS` points."""
    step = max(1, math.ceil(len(xs) / PLOT_POINTS))
    return Plot(x, y, np.column_stack([xs, ys])[::step], np.array(line, np.float64).reshape(-1, 2))
