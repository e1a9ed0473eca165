"""Ground plane around the machine in base, by the lowest returns of cells: roll, pitch and height of the mount.

Where the machine stands, the ground is the plane z = 0 of base. Bumps, furrows and the start of a slope tilt the plane
of single scans by some degrees in both directions; their median over a drive does not. Intervals of 3 m of travel count
as independent (a standing machine sees the same ground again). A tilt or height must exceed its limit by the 99 %
quantile of Student's distribution times the standard error of the median; few intervals hardly show how much they
scatter, so that the scatter of usual ground counts as `USUAL` more of them. Or all intervals exceed the limit in one
direction and differ by at most three times the usual scatter: waves of the ground that last for a short drive differ
more.
"""

import math

import numpy as np
from scipy import stats

from configs.vehicle import Lidar
from geometry.arrays import Bool, Float32, Float64
from geometry.jit import kernel
from validation.obstacle_stop.consistency.config import MountLimits
from validation.obstacle_stop.consistency.finding import Finding, not_checked

RADIUS_M = 14.0
CELLS = 28  # of 1 m per side
MIN_CELLS, MIN_INTERVALS = 15, 3
BLOCK_M = 3.0
USUAL, USUAL_SCATTER = 4, np.array([math.radians(0.5), math.radians(0.5), 0.03, 0.0])  # roll, pitch, height, share
BELOW_M = 0.4
INLIER_M = 0.08
LAYER_M = 0.2  # half thickness of the layer of ground returns
TRIPLES = np.random.default_rng(1).random((150, 3))  # places in the list of cells


@kernel
def lowest_of_cells(points_m: Float32) -> Float64:
    """Lowest return (K, 3) of each cell around base within 15° below and above z = 0 ± 1.5 m."""
    best = np.full((CELLS, CELLS), -1, np.int32)
    for k in range(len(points_m)):
        x, y, z = points_m[k]
        i, j = int(x + RADIUS_M), int(y + RADIUS_M)
        if not (abs(x) < RADIUS_M and abs(y) < RADIUS_M) or abs(z) > 1.5 + 0.27 * math.sqrt(x * x + y * y):
            continue
        if best[i, j] < 0 or z < points_m[best[i, j], 2]:
            best[i, j] = k
    out = np.empty((CELLS * CELLS, 3))
    count = 0
    for i in range(CELLS):
        for j in range(CELLS):
            if best[i, j] >= 0:
                for a in range(3):
                    out[count, a] = points_m[best[i, j], a]
                count += 1
    return out[:count]


@kernel
def plane_through(cells_m: Float64, triples: Float64) -> Float64:
    """Slopes by x and y, height at base, share of inliers (4,): best of random triples of the lowest returns."""
    best: Float64 = np.zeros(3)
    best_count, n = 0, len(cells_m)
    A, b = np.empty((3, 3)), np.empty(3)
    for t in range(len(triples)):
        for r in range(3):
            k = int(triples[t, r] * n)
            A[r, 0], A[r, 1], A[r, 2], b[r] = cells_m[k, 0], cells_m[k, 1], 1.0, cells_m[k, 2]
        if abs(np.linalg.det(A)) < 8.0:
            continue
        p: Float64 = np.linalg.solve(A, b).astype(np.float64)
        if abs(p[0]) > 0.27 or abs(p[1]) > 0.27:
            continue
        count = 0
        for k in range(n):
            if abs(p[0] * cells_m[k, 0] + p[1] * cells_m[k, 1] + p[2] - cells_m[k, 2]) < INLIER_M:
                count += 1
        if count > best_count:
            best, best_count = p, count
    return np.array([best[0], best[1], best[2], best_count / n])


@kernel
def refined(points_m: Float32, plane: Float64) -> Float64:
    """Plane (3,) by least squares through the mean of each cell; a plane of lowest returns lies below the ground."""
    out = plane[:3].copy()
    for _ in range(4):
        sums = np.zeros((CELLS, CELLS, 4))
        for k in range(len(points_m)):
            x, y, z = points_m[k]
            if abs(x) < RADIUS_M and abs(y) < RADIUS_M and abs(z - out[0] * x - out[1] * y - out[2]) < LAYER_M:
                i, j = int(x + RADIUS_M), int(y + RADIUS_M)
                sums[i, j, 0] += x
                sums[i, j, 1] += y
                sums[i, j, 2] += z
                sums[i, j, 3] += 1.0
        H, g, row = 1e-6 * np.eye(3), np.zeros(3), np.ones(3)
        for i in range(CELLS):
            for j in range(CELLS):
                n = sums[i, j, 3]
                if n < 1.0:
                    continue
                row[0], row[1] = sums[i, j, 0] / n, sums[i, j, 1] / n
                e = sums[i, j, 2] / n - out[0] * row[0] - out[1] * row[1] - out[2]
                w = min(n, 5.0) / (1.0 + (e / INLIER_M) ** 2)
                for a in range(3):
                    g[a] += w * e * row[a]
                    for c in range(3):
                        H[a, c] += w * row[a] * row[c]
        out = out + np.linalg.solve(H, g)
    return out


class GroundPlane:
    """Call `add` with the reduced points of scans of one lidar; `findings` compares the planes with z = 0."""

    def __init__(self, name: str, lidar: Lidar) -> None:
        self._name, self._lidar = name, lidar
        self._planes: dict[int, list[Float64]] = {}
        self._scans = 0

    def add(self, points_m: Float32, driven_m: float) -> None:
        """Fits the plane of one scan; `driven_m` is the distance travelled so far."""
        self._scans += 1
        cells = lowest_of_cells(points_m)
        if len(cells) < MIN_CELLS or min(np.ptp(cells[:, 0]), np.ptp(cells[:, 1])) < 4.0:
            return
        plane = plane_through(cells, TRIPLES)
        if plane[3] < 0.3:
            return
        a, b, height = refined(points_m, plane)
        near = np.hypot(points_m[:, 0], points_m[:, 1]) < RADIUS_M
        below = points_m[near, 2] < points_m[near, 0] * a + points_m[near, 1] * b + height - BELOW_M
        row = np.array([math.atan(b), -math.atan(a), height, below.mean()])
        self._planes.setdefault(int(driven_m / BLOCK_M), []).append(row)

    def _blocks(self) -> Float64:
        return np.array([np.median(rows, axis=0) for rows in self._planes.values()])

    def findings(self, limits: MountLimits) -> list[Finding]:
        """Contradictions of mount and ground."""
        if not self._planes:
            return [self._without_ground()]
        blocks = self._blocks()
        roll, pitch, height, below = np.median(blocks, axis=0)
        n = len(blocks)
        squares = USUAL * USUAL_SCATTER**2 + ((blocks - blocks.mean(axis=0)) ** 2).sum(axis=0)
        error = 1.25 * np.sqrt(squares / (USUAL + n - 1) / n)
        numbers = {
            "roll_deg": math.degrees(roll), "pitch_deg": math.degrees(pitch), "height_m": height,
            "share_below": below, "intervals": float(n), "scans": float(self._scans),
        }  # fmt: skip
        allowed = np.array([math.radians(limits.tilt_deg), math.radians(limits.tilt_deg), limits.height_m])
        is_shown = _is_shown(blocks[:, :3], allowed, error[:3])
        return self._tilt(numbers, np.degrees(error[:2]), is_shown, limits) + self._height(numbers, is_shown, limits)

    def _tilt(
        self, numbers: dict[str, float], error_deg: Float64, is_shown: Bool, limits: MountLimits
    ) -> list[Finding]:
        out = []
        for k, axis in enumerate(("roll", "pitch")):
            angle, error = numbers[f"{axis}_deg"], float(error_deg[k])
            if abs(angle) <= limits.tilt_deg:
                continue
            text = (
                f"lidar {self._name}: the ground is tilted by {angle:+.1f}° in {axis} against the machine (median of "
                f"{numbers['intervals']:.0f} intervals, standard error {error:.1f}°): the {axis} of its mount is wrong "
                f"by about {-angle:+.1f}°"
            )
            found = Finding(f"mount_{axis}", text, numbers, True)
            out.append(found if is_shown[k] else self._unsure(axis, numbers))
        return out

    def _unsure(self, what: str, numbers: dict[str, float]) -> Finding:
        return not_checked(f"{what} of lidar {self._name}", "too few intervals in motion, or they differ", numbers)

    def _height(self, numbers: dict[str, float], is_shown: Bool, limits: MountLimits) -> list[Finding]:
        height, out = numbers["height_m"], []
        if abs(height) > limits.height_m:
            text = (
                f"lidar {self._name}: the ground at the machine lies at {height:+.2f} m, not 0 (median of "
                f"{numbers['intervals']:.0f} intervals): the height of its mount is wrong by about {-height:+.2f} m"
            )
            found = Finding("mount_height", text, numbers, True)
            out.append(found if is_shown[2] else self._unsure("height", numbers))
        if numbers["share_below"] > limits.max_share_below:
            text = (
                f"lidar {self._name}: {100 * numbers['share_below']:.0f} % of the returns within {RADIUS_M:.0f} m lie "
                f"more than {BELOW_M} m below the ground: no mount explains them"
            )
            out.append(Finding("returns_below_ground", text, numbers, True))
        return out

    def _without_ground(self) -> Finding:
        """Blocking where the mount and the rings let most of a ring fall on near ground."""
        height = float(self._lidar.mount.T_base_sensor[2, 3])
        down = [-e for e in self._lidar.elevation_deg if e < -1.0]
        rings = sum(height / math.tan(math.radians(e)) < 0.7 * RADIUS_M for e in down) if height > 0.2 else 0
        numbers = {"rings_on_near_ground": float(rings), "scans": float(self._scans)}
        if rings < 4 or self._scans < 10:
            return not_checked(f"roll, pitch and height of lidar {self._name}", "no ground in its scans", numbers)
        text = (
            f"lidar {self._name}: no ground within {RADIUS_M:.0f} m in {self._scans} scans, although {rings} of its "
            "rings should meet it: its mount or its ring model is wrong"
        )
        return Finding("mount_without_ground", text, numbers, True)


def _is_shown(blocks: Float64, limit: Float64, error: Float64) -> Bool:
    """Whether the medians of intervals (N, K) exceed limits (K,), by their errors (K,) or in all intervals alike."""
    n, median = len(blocks), np.median(blocks, axis=0)
    if n < MIN_INTERVALS:
        return np.zeros(len(limit), bool)
    is_significant = np.abs(median) > limit + stats.t.ppf(0.99, USUAL + n - 1) * error
    is_alike = (np.sign(median) * blocks > limit).all(axis=0) & (np.ptp(blocks, axis=0) <= 3.0 * USUAL_SCATTER[:3])
    return np.asarray(is_significant | is_alike)
