"""Polylines as (N, 2) float64 arrays: length, resampling, smoothing, curvature, projection and offsets."""

import numpy as np
import numpy.typing as npt
import shapely

from geometry.arrays import Float64

SHOWN_ERROR_M = 0.02  # of a line in a picture


def arc_length(points_m: Float64) -> Float64:
    """Arc length at each point, (N,), 0 at the first."""
    steps = np.hypot(*np.diff(points_m, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def resample(points_m: Float64, step_m: float) -> Float64:
    """Points at equal spacing of at most `step_m`, first and last kept."""
    return at_length(points_m, lengths_of(points_m, step_m))


def lengths_of(points_m: Float64, step_m: float) -> Float64:
    """Equally spaced arc lengths from start to end, at most `step_m` apart."""
    total = float(arc_length(points_m)[-1])
    return np.linspace(0.0, total, max(2, int(np.ceil(total / step_m - 1e-9)) + 1))


def at_length(points_m: Float64, s_m: Float64) -> Float64:
    """Points (M, 2) at the arc lengths `s_m` (M,)."""
    s = arc_length(points_m)
    return np.column_stack([np.interp(s_m, s, points_m[:, 0]), np.interp(s_m, s, points_m[:, 1])])


def simplified(points_m: Float64, error_m: float = SHOWN_ERROR_M) -> Float64:
    """Points (M, 2) of the polyline, first and last among them, so few that no point is further than `error_m` off."""
    if len(points_m) < 3:
        return points_m
    line = shapely.simplify(shapely.linestrings(points_m), error_m, preserve_topology=False)
    return np.asarray(shapely.get_coordinates(line), np.float64)


def without_repeats(points_m: Float64, min_step_m: float = 1e-6) -> Float64:
    """Polyline without points nearer than `min_step_m` to the one before."""
    far = np.hypot(*np.diff(points_m, axis=0).T) > min_step_m
    return np.asarray(points_m[np.concatenate([[True], far])], np.float64)


def headings(points_m: Float64, is_closed: bool = False) -> Float64:
    """Unwrapped direction at each point, (N,), from its neighbours; the ends of a closed line are equal."""
    if is_closed:
        ring = points_m[:-1]
        d = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
        d = np.vstack([d, d[:1]])
    else:
        d = np.gradient(points_m, axis=0)
    return np.unwrap(np.arctan2(d[:, 1], d[:, 0]))


def curvatures(heading_rad: Float64, s_m: Float64) -> Float64:
    """Change of heading per metre, (N,)."""
    return np.asarray(np.gradient(heading_rad, s_m), np.float64)


def smooth(points_m: Float64, window_m: float, is_closed: bool = False) -> Float64:
    """Polyline with continuous curvature: equally spaced points averaged twice over `window_m`.

    Straight parts stay in place, an arc of radius R moves inwards by about window² / (12 R). An open line keeps both
    ends (continued beyond them by point reflection); a closed one repeats its first point at the end.
    """
    n = len(points_m) - 1
    spacing = float(arc_length(points_m)[-1]) / max(n, 1)
    half = round(window_m / max(spacing, 1e-9) / 2.0)
    half = min(half, n // 2)
    if half < 1:
        return points_m
    reach = 2 * half
    if is_closed:
        ring = points_m[:-1]
        padded = np.vstack([ring[-reach:], ring, ring[: reach + 1]])
    else:
        before = 2.0 * points_m[0] - points_m[reach:0:-1]
        after = 2.0 * points_m[-1] - points_m[-2 : -reach - 2 : -1]
        padded = np.vstack([before, points_m, after])
    kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    kernel = np.convolve(kernel, kernel)
    out = np.column_stack([np.convolve(padded[:, k], kernel, "valid") for k in range(2)])
    if is_closed:
        out[-1] = out[0]
    return out


def project(points_m: Float64, p_m: Float64) -> tuple[float, float]:
    """Arc length of the point on the polyline nearest to `p_m` (2,), and the distance to it (left positive)."""
    a, d = points_m[:-1], np.diff(points_m, axis=0)
    length = np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-12)
    t = np.clip(((p_m - a) * d).sum(axis=1) / length**2, 0.0, 1.0)
    gap = p_m - (a + t[:, None] * d)
    k = int(np.argmin(np.hypot(gap[:, 0], gap[:, 1])))
    side = d[k, 0] * gap[k, 1] - d[k, 1] * gap[k, 0]
    distance = float(np.hypot(*gap[k])) * (1.0 if side >= 0.0 else -1.0)
    return float(arc_length(points_m)[k] + t[k] * length[k]), distance


def extend(points_m: Float64, before_m: float, after_m: float) -> Float64:
    """Polyline extended straight at both ends."""
    first, last = points_m[1] - points_m[0], points_m[-1] - points_m[-2]
    parts = [points_m]
    if before_m > 0.0:
        parts.insert(0, (points_m[0] - first / np.hypot(*first) * before_m)[None])
    if after_m > 0.0:
        parts.append((points_m[-1] + last / np.hypot(*last) * after_m)[None])
    return np.vstack(parts)


def polyline(points: npt.ArrayLike) -> Float64:
    """(N, 2) float64 array with N ≥ 2 finite points, consecutive ones distinct; raises ValueError."""
    array = np.array(points, np.float64)
    if array.ndim != 2 or array.shape[1] != 2 or not np.isfinite(array).all():
        raise ValueError(f"a polyline needs finite points (N, 2), not {array.shape}")
    array = without_repeats(array)
    if len(array) < 2:
        raise ValueError("a polyline needs two different points")
    return array
