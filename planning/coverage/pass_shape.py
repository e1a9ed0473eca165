"""Shape of a headland pass: the least inward displacement at which no body of the rig leaves the allowed area.

A pass is its base line displaced to the left by d(s). A body point at x ahead of `base` moves by d + x·d', so along an
edge the tail bounds how fast a pass may leave it. Clearance and curvature are linearized about the pass, the least sum
of d is a linear program, and both are repeated until the bodies are free (sequential linear programming).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array, vstack

from geometry.arrays import Bool, Float64, Int32, Int64, runs_of
from geometry.drawbar import Trailer, hitch_poses
from geometry.footprint import place
from geometry.jit import kernel
from geometry.polyline import arc_length, at_length, curvatures, extend, headings
from geometry.rectangle import Rectangle
from planning.turns.free_space import CELL_M, FreeSpace, edge_grid, edges_of

STEP_M = 0.1
KNOT = 5  # points of the base line between two knots, 0.5 m
ROUNDS, PATIENCE = 24, 5  # at most, and without progress
BEYOND, ENDS = 12, 6  # knots by which an open line is prolonged, for the way back to it, and of each of its ends
WINDOW = 40  # knots before and after a place without clearance: a pass leaves an edge slowly
NEAR_M = 0.8  # clearance beyond it is not constrained
SLACK_M = 0.002  # clearance asked for, doubled at places still outside: between knots a body may be nearer
MOST_SLACK_M = 0.1
MOST_M = 0.6  # displacement in one round
MOST_CURVATURE = 1.07  # of that of the smallest turning radius
MOST_JUMP_RADPM = 0.029  # between points: more would be eased when the path is made, and moved
LESS_BENT = 0.96  # of the curvature asked for, at places where it is too high
RATE_RADPM2 = 0.12  # change of curvature per metre: of a base line into an arc
VIOLATION_COST = 1000.0  # of a metre of clearance, and of MISSING_RADPM2 of curvature
MISSING_RADPM2 = 0.05
STEP_COST = 0.5  # of a change of curvature of 1 1/m


@dataclass(frozen=True)
class _Contacts:
    """Clearances (C,) of body points at knots `knot`, m, and their change per displacement and per its slope."""

    knot: Int64
    clearance_m: Float64
    by_shift: Float64
    by_slope: Float64


def displaced(line_m: Float64, space: FreeSpace, ends_m: float | None = None) -> tuple[Float64, Float64]:
    """Points (N, 2) and headings (N,) of the pass on a line, about 0.1 m apart, with the interior to its left.

    The line is closed, or with `ends_m` open: there the bodies come that far from the edges at both ends.
    Where there is no way past an edge some poses of it are not drivable.
    """
    is_closed = ends_m is None
    if not is_closed:
        line_m = extend(line_m, KNOT * STEP_M * BEYOND, KNOT * STEP_M * BEYOND)
    total = float(arc_length(line_m)[-1])
    size = max(8, math.ceil(total / (KNOT * STEP_M)))
    base = at_length(line_m, np.linspace(0.0, total, KNOT * size + 1))
    points, heading = base, headings(base, is_closed)
    normal = np.column_stack([-np.sin(heading), np.cos(heading)])
    d, slack_m = np.zeros(size), np.full(size, SLACK_M)
    limit_radpm = np.full(size, 1.0 / space.radius_m)
    is_inner, is_end = np.ones(size, np.bool_), np.zeros(size, np.bool_)
    if ends_m is not None:
        is_inner[:BEYOND] = is_inner[-BEYOND + 1 :] = False
        is_end[BEYOND : BEYOND + ENDS] = is_end[-BEYOND - ENDS + 1 : -BEYOND + 1] = True
        slack_m[is_end] = ends_m
    near = _Surroundings(space)
    best, best_round = (size + 1, points, heading), 0
    for number in range(ROUNDS):
        is_out = _near_knots(_is_out(points, heading, space, is_closed)) & is_inner
        is_bent = _near_knots(_is_too_bent(points, heading, space)) & is_inner
        wrong = int((is_out | is_bent).sum())
        is_shaped = is_closed or number > 0  # an open line first leaves the edge at its ends
        if wrong < best[0] and is_shaped:
            best, best_round = (wrong, points, heading), number
        if (wrong == 0 and is_shaped) or number - best_round > PATIENCE:
            break
        if space.trailer is None:
            contacts = near.contacts(points[:-1:KNOT], heading[:-1:KNOT], is_inner)
        else:
            contacts = near.contacts_of_all(points, heading, is_inner, is_closed)
            is_out = _before(is_out, space.trailer) & is_inner
        s = arc_length(points)
        bend, step_m = curvatures(heading, s)[:-1:KNOT], KNOT * np.gradient(s)[:-1:KNOT]
        is_wrong = is_out | is_bent | (is_end & (number == 0))
        for window in _windows(is_wrong, WINDOW, is_closed):
            d[window] += _increments(window, d, contacts, bend, step_m, slack_m, limit_radpm)
        slack_m[is_out] = np.maximum(slack_m[is_out], np.minimum(2.0 * slack_m[is_out], MOST_SLACK_M))
        limit_radpm[is_bent] *= LESS_BENT
        points = base + _between(d)[:, None] * normal
        heading = headings(points, is_closed)
    kept = slice(None) if is_closed else slice(BEYOND * KNOT, -BEYOND * KNOT)
    return best[1][kept], best[2][kept]


def _near_knots(is_wrong: Bool) -> Bool:
    """Knots before or after the marked points of a pass."""
    is_after = is_wrong[:-1].reshape(-1, KNOT).any(axis=1)
    return np.asarray(is_after | np.roll(is_after, 1), np.bool_)


def _before(is_out: Bool, trailer: Trailer) -> Bool:
    """Knots marked, and those before them where the path led a trailed implement that far."""
    count = _behind(trailer.drawbar.hitch_m + trailer.body.rear_m)
    return np.asarray(np.any([np.roll(is_out, -k) for k in range(-count + 1)], axis=0), np.bool_)


def _behind(x_m: float) -> int:
    """Knots from where the machine is to a place along x of `base`."""
    return round(x_m / (KNOT * STEP_M))


def _between(d: Float64) -> Float64:
    """The closed cubic B-spline of coefficients at knots, at all points of the base line."""
    u = np.arange(KNOT) / KNOT
    weights = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]) / 6.0
    values = np.column_stack([np.roll(d, 1 - k) for k in range(4)]) @ weights
    return np.append(values, values[0, 0])


def is_undrivable(points_m: Float64, heading_rad: Float64, space: FreeSpace, is_closed: bool = False) -> Bool:
    """Poses of a pass, (N,), at which a body is outside or the curvature is too high."""
    return _is_out(points_m, heading_rad, space, is_closed) | _is_too_bent(points_m, heading_rad, space)


def _is_out(points_m: Float64, heading_rad: Float64, space: FreeSpace, is_closed: bool) -> Bool:
    """Poses at which, or half a step before or after which, a body is outside: a path has poses between those of it."""
    turn = np.diff(np.unwrap(heading_rad))
    at = space.touching(points_m, heading_rad, is_closed=is_closed)
    if space.trailer is not None:  # it turns slowly: checked at all poses
        space = replace(space, trailer=None)
    between = space.touching(0.5 * (points_m[:-1] + points_m[1:]), heading_rad[:-1] + 0.5 * turn)
    return np.asarray(at | np.append(between, False) | np.append(False, between), np.bool_)


def _is_too_bent(points_m: Float64, heading_rad: Float64, space: FreeSpace) -> Bool:
    bend = curvatures(heading_rad, arc_length(points_m))
    jump = np.maximum(np.abs(np.diff(bend, prepend=bend[0])), np.abs(np.diff(bend, append=bend[-1])))
    return np.asarray((np.abs(bend) > MOST_CURVATURE / space.radius_m) | (jump > MOST_JUMP_RADPM), np.bool_)


class _Surroundings:
    """Edges of the allowed area around the bodies of the rig."""

    def __init__(self, space: FreeSpace) -> None:
        self._space = space
        self._grid = edge_grid(edges_of(space.allowed), space.reach_m + NEAR_M)

    def contacts(self, p_map_m: Float64, heading_rad: Float64, is_used: Bool) -> _Contacts:
        """Contacts of the corners of each body with edges, and of its sides with the nearest vertex, at knots used."""
        used = np.flatnonzero(is_used)
        p_map_m, heading_rad = p_map_m[used], heading_rad[used]
        found = [self._of_corners(body.corners_m, p_map_m, heading_rad) for body in self._space.bodies]
        found += [self._of_sides(body, p_map_m, heading_rad) for body in self._space.bodies]
        knot, *columns = (np.concatenate(column) for column in zip(*found, strict=True))
        return _Contacts(used[knot], *columns)

    def contacts_of_all(self, p_map_m: Float64, heading_rad: Float64, is_used: Bool, is_closed: bool) -> _Contacts:
        """Contacts of the rigid bodies, and those of a trailed implement; poses at all points of the pass.

        Each place of the implement is taken to move across as the path does where it is: it follows the path.
        """
        at_knots = p_map_m[:-1:KNOT], heading_rad[:-1:KNOT]
        rigid, trailer = self.contacts(*at_knots, is_used), self._space.trailer
        assert trailer is not None
        poses = hitch_poses(trailer.drawbar, p_map_m, heading_rad, is_closed=is_closed)[:-1:KNOT]
        body, used = trailer.body, np.flatnonzero(is_used)
        p, yaw = poses[used, :2].copy(), poses[used, 2].copy()
        knot, point, clearance, along, across = self._corners(body.corners_m, p, yaw)
        x = body.corners_m[point, 0]
        beside, apart, side, slope = self._of_sides(body, p, yaw)
        knot, x = np.concatenate([knot, beside]), np.concatenate([x, slope * side])
        clearance, along = np.concatenate([clearance, apart]), np.concatenate([along, np.zeros(len(beside))])
        across, knot = np.concatenate([across, side]), used[knot]
        owner = knot + np.round((trailer.drawbar.hitch_m + x) / (KNOT * STEP_M)).astype(np.int64)
        kept = is_closed | (owner >= 0)
        knot, owner = knot[kept], owner[kept] % len(is_used)
        turn = poses[knot, 2] - at_knots[1][owner]
        shift = across[kept] * np.cos(turn) + along[kept] * np.sin(turn)
        return _Contacts(
            np.concatenate([rigid.knot, owner]), np.concatenate([rigid.clearance_m, clearance[kept]]),
            np.concatenate([rigid.by_shift, shift]), np.concatenate([rigid.by_slope, np.zeros(len(owner))]),
        )  # fmt: skip

    def _of_corners(
        self, corners_m: Float64, p_map_m: Float64, heading_rad: Float64
    ) -> tuple[Int64, Float64, Float64, Float64]:
        knot, point, clearance, along, across = self._corners(corners_m, p_map_m, heading_rad)
        x, y = corners_m[point].T
        return knot, clearance, across, across * x - along * y

    def _corners(
        self, corners_m: Float64, p_map_m: Float64, heading_rad: Float64
    ) -> tuple[Int64, Int64, Float64, Float64, Float64]:
        """Knot, corner and clearance of each contact, and its direction inwards along and across the body."""
        at = place(corners_m, p_map_m, heading_rad)
        away = _from_edges(p_map_m, at, *self._grid)
        distance = np.minimum(np.hypot(away[..., 0], away[..., 1]), NEAR_M)
        is_in = shapely.contains_xy(self._space.allowed, at[..., 0].ravel(), at[..., 1].ravel()).reshape(at.shape[:2])
        clearance = np.where(is_in, distance, -distance)
        knot, point = np.nonzero(clearance < NEAR_M)
        c, s = np.cos(heading_rad[knot]), np.sin(heading_rad[knot])
        is_known = (distance[knot, point] > 1e-6) & (distance[knot, point] < NEAR_M)
        inwards = away[knot, point] / np.where(is_known, clearance[knot, point], 1.0)[:, None]
        along = np.where(is_known, c * inwards[:, 0] + s * inwards[:, 1], 0.0)
        across = np.where(is_known, c * inwards[:, 1] - s * inwards[:, 0], 1.0)
        return knot, point, clearance[knot, point], along, across

    def _of_sides(
        self, body: Rectangle, p_map_m: Float64, heading_rad: Float64
    ) -> tuple[Int64, Float64, Float64, Float64]:
        beyond_m = 0.5 * KNOT * STEP_M  # until the next knot
        vertex = _beside(p_map_m, heading_rad, body.rear_m - beyond_m, body.front_m + beyond_m, *self._grid)
        clearance = np.abs(vertex[:, 1]) - body.half_width_m
        knot = np.flatnonzero(clearance < NEAR_M)
        side = -np.sign(vertex[knot, 1])
        return knot, clearance[knot], side, side * vertex[knot, 0]


@kernel
def _beside(
    p_map_m: Float64, heading_rad: Float64, rear_m: float, front_m: float, edges_m: Float64, west_m: float,
    south_m: float, columns: int, rows: int, first: Int32, items: Int32,
) -> Float64:  # fmt: skip
    """The vertex nearest to the x axis of `base` between `rear_m` and `front_m` at each pose, (N, 2) in `base`."""
    found = np.full((len(p_map_m), 2), np.inf)
    for n in range(len(p_map_m)):
        i, j = math.floor((p_map_m[n, 0] - west_m) / CELL_M), math.floor((p_map_m[n, 1] - south_m) / CELL_M)
        if i < 0 or j < 0 or i >= columns or j >= rows:
            continue
        cell, c, s = j * columns + i, math.cos(heading_rad[n]), math.sin(heading_rad[n])
        for m in range(first[cell], first[cell + 1]):
            dx, dy = edges_m[items[m], 0] - p_map_m[n, 0], edges_m[items[m], 1] - p_map_m[n, 1]
            x, y = c * dx + s * dy, c * dy - s * dx
            if rear_m <= x <= front_m and abs(y) < abs(found[n, 1]):
                found[n, 0], found[n, 1] = x, y
    return found


@kernel
def _from_edges(
    p_map_m: Float64, points_m: Float64, edges_m: Float64, west_m: float, south_m: float, columns: int, rows: int,
    first: Int32, items: Int32,
) -> Float64:  # fmt: skip
    """Vectors to body points (N, K, 2) at N poses from the nearest edge; infinite without one near the pose."""
    found = np.full(points_m.shape, np.inf)
    for n in range(len(p_map_m)):
        i, j = math.floor((p_map_m[n, 0] - west_m) / CELL_M), math.floor((p_map_m[n, 1] - south_m) / CELL_M)
        if i < 0 or j < 0 or i >= columns or j >= rows:
            continue
        cell = j * columns + i
        for k in range(points_m.shape[1]):
            x, y, least = points_m[n, k, 0], points_m[n, k, 1], np.inf
            for m in range(first[cell], first[cell + 1]):
                ax, ay, bx, by = edges_m[items[m]]
                dx, dy = bx - ax, by - ay
                share = ((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-12)
                share = min(max(share, 0.0), 1.0)
                ex, ey = x - ax - share * dx, y - ay - share * dy
                if ex * ex + ey * ey < least:
                    least = ex * ex + ey * ey
                    found[n, k, 0], found[n, k, 1] = ex, ey
    return found


def _windows(is_outside: Bool, margin: int, is_closed: bool) -> list[Int64]:
    """Runs of knots of a pass with `margin` knots before and after each place outside; those at open ends stay."""
    n = len(is_outside)
    at = (np.flatnonzero(is_outside)[:, None] + np.arange(-margin, margin + 1)).ravel()
    wanted = np.zeros(n, np.bool_)
    wanted[at % n if is_closed else at[(at > 0) & (at < n - 1)]] = True
    if wanted.all():
        return [np.arange(n)]
    first = int(np.argmin(wanted))
    return [(first + np.arange(a, b + 1)) % n for a, b in runs_of(np.roll(wanted, -first))]


def _increments(
    window: Int64,
    d: Float64,
    contacts: _Contacts,
    bend_radpm: Float64,
    step_m: Float64,
    slack_m: Float64,
    limit_radpm: Float64,
) -> Float64:
    """Changes (W,) of the coefficients of a window of knots, 0 before and after it: a linear program.

    Unknowns are, for each knot, the change, what stays missing of clearance and curvature, and the step of curvature.
    """
    n, at = len(window), np.full(len(d), -1)
    at[window] = np.arange(n)
    used = at[contacts.knot] >= 0
    knot, shift = contacts.knot[used], contacts.by_shift[used]
    k, slope, row = at[knot], contacts.by_slope[used] / (2.0 * step_m[knot]), np.arange(len(knot))
    every = np.arange(n)
    before, after = np.append(-1, every[:-1]), np.append(every[1:], -1)  # -1: a knot outside the window
    if n == len(d):
        before[0], after[-1] = n - 1, 0
    clear = _matrix(
        (row, before[k], shift / 6.0 - slope), (row, k, shift * 4.0 / 6.0),
        (row, after[k], shift / 6.0 + slope), (row, n + k, 1.0), size=n,
    )  # fmt: skip
    weight, bend = 1.0 / step_m[window] ** 2, bend_radpm[window]
    second = _matrix((every, before, weight), (every, every, -2.0 * weight), (every, after, weight), size=n)
    step = second[1:] - second[:-1]
    tighter = _matrix((every, every, bend**2), size=n)  # an arc moved inwards
    missing = _matrix((every, n + every, MISSING_RADPM2), size=n)
    steps = _matrix((every[:-1], 2 * n + every[:-1], 1.0), (every[:-1], n + every[:-1], MISSING_RADPM2), size=n)
    jump, limit = np.diff(bend), limit_radpm[window]
    found = linprog(  # type: ignore[call-overload]  # the stubs know dense matrices alone
        np.repeat([1.0, VIOLATION_COST, STEP_COST], n),
        A_ub=vstack([-clear, second + tighter - missing, -second - tighter - missing, step - steps, -step - steps]),
        b_ub=np.concatenate([contacts.clearance_m[used] - slack_m[knot], limit - bend, limit + bend, -jump, jump]),
        bounds=np.column_stack(
            [
                np.concatenate([-d[window], np.zeros(2 * n)]),
                np.concatenate([np.full(n, MOST_M), np.full(n, np.inf), RATE_RADPM2 * step_m[window]]),
            ]
        ),
        method="highs-ds",
    )
    return np.asarray(found.x[:n], np.float64) if found.x is not None else np.zeros(n)


def _matrix(*entries: tuple[Int64, Int64, Float64 | float], size: int) -> csr_array:
    """Sparse matrix of rows, columns and values; those with column -1, of a knot outside the window, are left out."""
    row, column = (np.concatenate([e[k] for e in entries]) for k in (0, 1))
    value = np.concatenate([np.broadcast_to(e[2], len(e[0])) for e in entries])
    kept, count = column >= 0, int(row.max(initial=-1)) + 1
    row, column, value = row[kept], column[kept], value[kept]
    return csr_array(coo_array((value, (row, column)), shape=(count, 3 * size)))
