"""A path as it can be steered: smoothed where curvature steps, with the machine's place on it followed step by step.

Everything here is in the direction of travel: for a path driven in reverse the heading is that of the motion, left is
left of the motion, and curvature turns the motion to the left.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, filtfilt

from control.scalars import as_floats
from geometry.angles import wrap
from geometry.arrays import Float64
from messages.plan import Path

SPACING_M = 0.1
EXTENSION_M = 8.0  # several wavelengths of the smoothing, so that its ends lie outside the path


class Place(NamedTuple):
    """Where a point lies against the path; `offset_m` left of it, `heading_error_rad` left of its heading."""

    s_m: float
    offset_m: float
    heading_error_rad: float
    curvature_radpm: float


class Reference:
    """Points every 0.1 m of the smoothed path; `deviation_m` is how far left of the path itself they lie."""

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

    def place(self, x_m: float, y_m: float, heading_rad: float, near: int) -> tuple[Place, int]:
        """The place of a point, searched for from the index `near` on downhill only, and the index found."""
        k = self._descend(x_m, y_m, near)
        c, s = self._cos[k], self._sin[k]
        dx, dy = x_m - self._x[k], y_m - self._y[k]
        along, across = c * dx + s * dy, c * dy - s * dx
        curvature = self._curvature_at(k, along)
        place = Place(
            s_m=self._first_m + k * self._step_m + along,
            offset_m=across - 0.5 * curvature * along * along,
            heading_error_rad=wrap(heading_rad - self._heading[k] - curvature * along),
            curvature_radpm=curvature,
        )
        return place, k

    def deviation_m(self, near: int) -> float:
        """How far left of the path the smoothed one lies there."""
        return self._deviation[near]

    def steering_rates(self, wheelbase_m: float) -> tuple[Float64, Float64]:
        """Arc length, (M,), and how fast the front wheels turn there by the way, in rad/m."""
        angle = np.arctan(wheelbase_m * np.array(self._curvature))
        return self._s, np.abs(np.gradient(angle, self._step_m))

    def find(self, x_m: float, y_m: float, heading_rad: float, within_m: float) -> int:
        """The nearest point within the first metres that is driven in about this direction, else the first."""
        most = max(1, min(len(self._x), round(within_m / self._step_m)))
        best, nearest = 0, math.inf
        for k in range(most):
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

    def _descend(self, x_m: float, y_m: float, near: int) -> int:
        """The local minimum of distance: crossings and loops of the path are never jumped over."""
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
    """The points (N, 2) without what turns faster than `cutoff_radpm`, shifted nowhere; with as many more at both ends.

    Third-order Butterworth forth and back: 1 / (1 + (ω/ω₀)⁶) is what a controller that weighs offset against rate of
    curvature would drive (the optimum with full preview), and it leaves straights and circles as they are.
    """
    count = math.ceil(EXTENSION_M / step_m)
    before = _arc(p_m[0], headings[0], curvatures[0], np.arange(-count, 0, dtype=np.float64) * step_m)
    after = _arc(p_m[-1], headings[1], curvatures[1], np.arange(1, count + 1, dtype=np.float64) * step_m)
    b, a = butter(3, min(cutoff_radpm * step_m / math.pi, 0.99))
    return np.asarray(filtfilt(b, a, np.vstack([before, p_m, after]), axis=0), np.float64)


def _arc(p_m: Float64, heading_rad: float, curvature_radpm: float, s_m: Float64) -> Float64:
    half = 0.5 * curvature_radpm * s_m
    chord = s_m * np.sinc(half / math.pi)
    return np.stack([p_m[0] + chord * np.cos(heading_rad + half), p_m[1] + chord * np.sin(heading_rad + half)], axis=1)
