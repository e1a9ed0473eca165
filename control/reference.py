"""Reference of the lateral controller: the path smoothed where curvature steps, and the position on it.

All values are in the direction of travel: for a path in reverse the heading is that of the motion, left is left of the
motion, and positive curvature turns the motion left.
"""

import math
from typing import NamedTuple

import numpy as np

from control.scalars import as_floats
from control.zero_phase import low_pass
from geometry.angles import wrap
from geometry.arrays import Float64
from messages.plan import Path

SPACING_M = 0.1
EXTENSION_M = 8.0  # several wavelengths of the smoothing: its boundary effects lie outside the path


class FrenetPosition(NamedTuple):
    """Frenet coordinates of a pose (left positive), and the curvature of the path there."""

    s_m: float
    offset_m: float
    heading_error_rad: float
    curvature_radpm: float


class Reference:
    """Smoothed path at steps of 0.1 m; `deviation_m` is its offset from the path itself, left positive."""

    def __init__(self, path: Path, smoothing_radpm: float) -> None:
        self.path_id, self.direction = path.path_id, path.direction
        self.length_m = float(path.s_m[-1] - path.s_m[0])
        self._first_m = float(path.s_m[0])
        count = max(2, round(self.length_m / SPACING_M) + 1)
        self._s = np.linspace(path.s_m[0], path.s_m[-1], count)
        self._step_m = self.length_m / (count - 1) if self.length_m > 0.01 else SPACING_M
        raw = np.stack([np.interp(self._s, path.s_m, path.p_map_m[:, k]) for k in (0, 1)], axis=1)
        self._fill(
            raw, smooth(raw, self._step_m, smoothing_radpm, self._end_headings(path), self._end_curvatures(path))
        )

    @property
    def end_m(self) -> float:
        """Arc length at the end."""
        return self._first_m + self.length_m

    def locate(self, x_m: float, y_m: float, heading_rad: float, near: int) -> tuple[FrenetPosition, int]:
        """Position of a pose, by descent from the index `near`, and the index found."""
        k = self._nearest_index(x_m, y_m, near)
        c, s = self._cos[k], self._sin[k]
        dx, dy = x_m - self._x[k], y_m - self._y[k]
        along, across = c * dx + s * dy, c * dy - s * dx
        curvature = self._curvature_at(k, along)
        position = FrenetPosition(
            s_m=self._first_m + k * self._step_m + along,
            offset_m=across - 0.5 * curvature * along * along,
            heading_error_rad=wrap(heading_rad - self._heading[k] - curvature * along),
            curvature_radpm=curvature,
        )
        return position, k

    def deviation_m(self, near: int) -> float:
        """Offset of the smoothed path from the path at an index, left positive."""
        return self._deviation[near]

    def steering_rates(self, wheelbase_m: float) -> tuple[Float64, Float64]:
        """Arc length, (M,), and change of the front-wheel angle per distance there, (M,), rad/m."""
        angle = np.arctan(wheelbase_m * np.array(self._curvature))
        return self._s, np.abs(np.gradient(angle, self._step_m))

    def start_index(self, x_m: float, y_m: float, heading_rad: float, within_m: float) -> int:
        """Index of the nearest point within `within_m` with a heading within 90 degrees, else 0."""
        count = max(1, min(len(self._x), round(within_m / self._step_m)))
        best, nearest = 0, math.inf
        for k in range(count):
            distance = math.hypot(x_m - self._x[k], y_m - self._y[k])
            if distance < nearest and abs(wrap(heading_rad - self._heading[k])) < 0.5 * math.pi:
                best, nearest = k, distance
        return best

    def _fill(self, raw: Float64, p: Float64) -> None:
        beyond = (len(p) - len(raw)) // 2
        inner = slice(beyond, beyond + len(raw))
        tangent = np.gradient(p, self._step_m, axis=0)
        turned = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
        p, heading, curvature = p[inner], turned[inner], np.gradient(turned, self._step_m)[inner]
        normal = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        self._x, self._y = as_floats(p[:, 0]), as_floats(p[:, 1])
        self._heading = as_floats(heading)
        self._cos, self._sin = as_floats(np.cos(heading)), as_floats(np.sin(heading))
        self._curvature = as_floats(curvature)
        self._deviation = as_floats(np.sum((p - raw) * normal, axis=1))

    def _end_headings(self, path: Path) -> tuple[float, float]:
        turn = 0.0 if path.direction > 0 else math.pi
        return float(path.heading_rad[0]) + turn, float(path.heading_rad[-1]) + turn

    def _end_curvatures(self, path: Path) -> tuple[float, float]:
        return self.direction * float(path.curvature_radpm[0]), self.direction * float(path.curvature_radpm[-1])

    def _nearest_index(self, x_m: float, y_m: float, near: int) -> int:
        """Local minimum of distance: no jump to another branch at crossings and loops."""
        k, last = near, len(self._x) - 1
        here = self._square(k, x_m, y_m)
        while k < last and (after := self._square(k + 1, x_m, y_m)) < here:
            k, here = k + 1, after
        while k > 0 and (before := self._square(k - 1, x_m, y_m)) < here:
            k, here = k - 1, before
        return k

    def _square(self, k: int, x_m: float, y_m: float) -> float:
        return (x_m - self._x[k]) ** 2 + (y_m - self._y[k]) ** 2

    def _curvature_at(self, k: int, along_m: float) -> float:
        beside = min(max(k + (1 if along_m > 0.0 else -1), 0), len(self._x) - 1)
        share = min(abs(along_m) / self._step_m, 1.0)
        return self._curvature[k] + share * (self._curvature[beside] - self._curvature[k])


def smooth(
    p_m: Float64, step_m: float, cutoff_radpm: float, headings: tuple[float, float], curvatures: tuple[float, float]
) -> Float64:
    """Points (N, 2) low-pass filtered at `cutoff_radpm` without phase shift, extended at both ends.

    Third-order Butterworth, forward and backward: 1 / (1 + (ω/ω₀)⁶) is the response of the optimal preview controller
    that weighs offset against rate of curvature; straights and circles are unchanged.
    """
    count = math.ceil(EXTENSION_M / step_m)
    before = _arc(p_m[0], headings[0], curvatures[0], np.arange(-count, 0, dtype=np.float64) * step_m)
    after = _arc(p_m[-1], headings[1], curvatures[1], np.arange(1, count + 1, dtype=np.float64) * step_m)
    return low_pass(np.vstack([before, p_m, after]), min(cutoff_radpm * step_m / math.pi, 0.99))


def _arc(p_m: Float64, heading_rad: float, curvature_radpm: float, s_m: Float64) -> Float64:
    half = 0.5 * curvature_radpm * s_m
    chord = s_m * np.sinc(half / math.pi)
    return np.stack([p_m[0] + chord * np.cos(heading_rad + half), p_m[1] + chord * np.sin(heading_rad + half)], axis=1)
