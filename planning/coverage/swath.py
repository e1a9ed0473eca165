"""Swaths: parallel strips over the area inside the headland passes, cut where the rig cannot drive."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from shapely.affinity import rotate
from shapely.geometry import Polygon, box
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Bool, Float64, runs_of
from geometry.polygon import edge_angles, parts
from geometry.pose2 import Pose2
from planning.rig import Rig
from planning.turns.free_space import FreeSpace
from planning.turns.search import Leg, straight

MIN_STRIP_M2 = 0.5
STEP_M = 0.1
TURN_COST_M = 20.0  # cost of one more swath in turns, as distance
SAME_RAD = math.radians(1.0)
MAX_DIRECTIONS = 8
MOST_SHORTER_M, ROOM_STEP_M = 20.0, 0.5  # of a line, for a turn forwards at its end
QUARTER_RAD = np.radians((15.0, 30.0, 45.0, 60.0, 75.0, 90.0))


@dataclass(frozen=True)
class Swath:
    """A straight line of the implement's working line, worked from one end to the other in either direction.

    Near an edge the two directions reach different ends: the front of the rig is far ahead of the working line.
    `onwards_m` and `back_m` are start and end of work (2, 2) from a to b and from b to a; None where not drivable.
    `block` numbers the area that is worked in one direction, `row` rises across the swaths of one.
    """

    number: int
    onwards_m: Float64 | None
    back_m: Float64 | None
    block: int = 0
    row: float = 0.0

    @property
    def length_m(self) -> float:
        """End to end, of the longer direction."""
        return max(float(np.hypot(*(e[1] - e[0]))) for e in (self.onwards_m, self.back_m) if e is not None)

    def poses(self, is_reversed: bool, lead_m: float) -> tuple[Pose2, Pose2] | None:
        """Poses of `base` at start and end of work; `lead_m` is the distance of `base` ahead of the working line."""
        ends = self.back_m if is_reversed else self.onwards_m
        if ends is None:
            return None
        heading = math.atan2(*(ends[1] - ends[0])[::-1])
        first, last = (Pose2(float(p[0]), float(p[1]), heading).ahead(lead_m) for p in ends)
        return first, last

    def legs(self, lead_m: float) -> tuple[Leg | None, Leg | None]:
        """Path of `base` in both directions."""
        ends = [self.poses(is_reversed, lead_m) for is_reversed in (False, True)]
        onwards, back = (None if e is None else straight(*e) for e in ends)
        return onwards, back


def strips_of(
    area: BaseGeometry,
    width_m: float,
    overlap_m: float,
    min_m: float,
    direction_rad: float | None,
    through_m: tuple[float, float] | None = None,
) -> list[Float64]:
    """Ends (2, 2) of strips that cover the area; without a direction each part along its edge of lowest cost.

    `width_m` is the width of one strip; neighbours overlap by at least `overlap_m`. With `through_m` they overlap by
    just that, and the middle of one of them, prolonged, passes through that point.
    """
    found: list[Float64] = []
    for part in parts(area, MIN_STRIP_M2):
        angles = [direction_rad] if direction_rad is not None else directions_of(part)
        tried = [_along(part, width_m, overlap_m, min_m, angle, through_m) for angle in angles]
        found += min(tried, key=cost_m)
    return found


def cost_m(strips: Iterable[Float64]) -> float:
    """Length of strips with their turns."""
    return round(sum(float(np.hypot(*(s[1] - s[0]))) + TURN_COST_M for s in strips), 3)


def directions_of(part: Polygon) -> list[float]:
    """Directions of the longest edges, and of the longer side of the smallest rectangle around the part."""
    outline = part.simplify(0.5)
    hull = outline.minimum_rotated_rectangle
    sums: list[tuple[float, float]] = []
    edges = edge_angles(outline) if isinstance(outline, Polygon) else []
    for angle, length in [*(edge_angles(hull)[:1] if isinstance(hull, Polygon) else []), *edges]:
        for k, (known, total) in enumerate(sums):
            if abs((angle - known + math.pi / 2) % math.pi - math.pi / 2) < SAME_RAD:
                sums[k] = (known, total + length)
                break
        else:
            sums.append((angle, length))
    return [angle for angle, _ in sorted(sums, key=lambda e: -e[1])[:MAX_DIRECTIONS]] or [0.0]


def _along(
    part: Polygon,
    width_m: float,
    overlap_m: float,
    min_m: float,
    angle_rad: float,
    through_m: tuple[float, float] | None,
) -> list[Float64]:
    flat = rotate(part, -angle_rad, origin=(0.0, 0.0), use_radians=True)
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    R = np.array([[c, -s], [s, c]])
    through = None if through_m is None else float((np.array(through_m) @ R)[1])
    middles, pitch = _middles(flat.bounds[1], flat.bounds[3], width_m, overlap_m, through)
    return [np.array([[x0, y], [x1, y]]) @ R.T for x0, x1, y in _strips(flat, middles, pitch, min_m)]


def _middles(
    low: float, high: float, width_m: float, overlap_m: float, through: float | None
) -> tuple[list[float], float]:
    """Heights of the middles of strips over an interval, and their distance, the width for a single one."""
    if through is not None:
        pitch = width_m - overlap_m
        first, last = math.ceil((low - through) / pitch - 0.5), math.floor((high - through) / pitch + 0.5)
        return [through + k * pitch for k in range(first, max(last, first) + 1)], pitch
    height = high - low
    count = max(1, math.ceil((height - overlap_m) / (width_m - overlap_m) - 1e-3))
    if count == 1:
        return [(low + high) / 2.0], width_m
    pitch = (height - width_m) / (count - 1)
    return [low + width_m / 2.0 + k * pitch for k in range(count)], pitch


def _strips(part: Polygon, middles: list[float], pitch: float, min_m: float) -> list[tuple[float, float, float]]:
    """Start, end and height of the strips of a polygon along x, from below."""
    x0, y0, x1, y1 = part.bounds
    found = []
    for k, y in enumerate(middles):
        # neighbours share the overlap: each strip covers up to its middle
        reach = pitch / 2.0 + 1e-6
        low = y0 if k == 0 else y - reach
        high = y1 if k == len(middles) - 1 else y + reach
        for piece in parts(part.intersection(box(x0 - 1.0, low, x1 + 1.0, high)), MIN_STRIP_M2):
            a, _, b, _ = piece.bounds
            found.append((*_min_length(a, b, min_m), y))
    return found


def _min_length(a: float, b: float, min_m: float) -> tuple[float, float]:
    more = max(0.0, min_m - (b - a)) / 2.0
    return a - more, b + more


def swaths_on(strip: Float64, rig: Rig, space: FreeSpace) -> list[Swath]:
    """Parts of a strip that can be driven, each in one direction or both; numbers are left 0."""
    runs = [_free_runs(ends, rig, space) for ends in (strip, strip[::-1])]
    found, backs = [], list(runs[1])
    for onwards in runs[0]:
        partner = next((b for b in backs if _overlap_m(onwards, b) > 0.5 * rig.min_swath_m), None)
        if partner is not None:
            backs = [b for b in backs if b is not partner]
        found.append(Swath(0, onwards, partner))
    return [*found, *(Swath(0, None, b) for b in backs)]


def _overlap_m(onwards: Float64, back: Float64) -> float:
    along = onwards[1] - onwards[0]
    length = float(np.hypot(*along))
    s = np.sort((back - onwards[0]) @ along / length)
    return float(min(s[1], length) - max(s[0], 0.0))


def _free_runs(ends: Float64, rig: Rig, space: FreeSpace) -> list[Float64]:
    """Parts of a line of the implement, (2, 2), on which the rig is free, in driving order.

    With reversing they end `stop_gap_m` before an edge: a turn there begins or ends with a change of direction.
    """
    length = float(np.hypot(*(ends[1] - ends[0])))
    along = (ends[1] - ends[0]) / length
    count = max(1, math.ceil(length / STEP_M))
    gap = math.ceil(rig.config.stop_gap_m * count / length) if rig.has_reverse else 0
    beyond_m = gap * length / count
    s = np.linspace(-beyond_m, length + beyond_m, count + 1 + 2 * gap)
    p = ends[0] + (s[:, None] - rig.working_x_m) * along
    free = ~space.touching(p, np.full(len(s), math.atan2(along[1], along[0])))
    runs = [(s[a] + beyond_m, s[b] - beyond_m) for a, b in runs_of(free)]
    kept = [(a, b) for a, b in runs if b - a >= rig.min_swath_m - 1e-6]
    lines = [np.array([ends[0] + a * along, ends[0] + b * along]) for a, b in kept]
    is_forward = not rig.has_reverse and rig.trailer is None
    return [_with_room_to_turn(line, rig, space) for line in lines] if is_forward else lines


def _with_room_to_turn(ends: Float64, rig: Rig, space: FreeSpace) -> Float64:
    """A line (2, 2) shortened so far that a quarter circle, to either side, leads onto it and another off it.

    It stays as it is where none does within `MOST_SHORTER_M` of an end.
    """
    length_m = float(np.hypot(*(ends[1] - ends[0])))
    along = (ends[1] - ends[0]) / length_m
    on_m, off_m = rig.config.line_up_m + rig.working_x_m, rig.config.run_out_m - rig.working_x_m
    most_m = min(MOST_SHORTER_M, 0.5 * (length_m - rig.min_swath_m))
    shorter_m = np.arange(0.0, max(most_m, ROOM_STEP_M), ROOM_STEP_M)
    found = list[Float64]()
    for end, inwards, straight_m in ((ends[0], along, on_m), (ends[1], -along, off_m)):
        corners = end + (shorter_m[:, None] - straight_m) * inwards
        is_room = _has_quarter_circle(corners, -inwards, along, rig.radius_m, space)
        found.append(end + (shorter_m[int(np.argmax(is_room))] if is_room.any() else 0.0) * inwards)
    return np.array(found)


def _has_quarter_circle(start_m: Float64, outwards: Float64, along: Float64, radius_m: float, space: FreeSpace) -> Bool:
    """Whether a rig that heads `along` is free on a quarter circle to a side from N points, (N, 2), in a direction."""
    sideways = np.array([-outwards[1], outwards[0]])
    turn, heading_rad = QUARTER_RAD, math.atan2(along[1], along[0])
    found = np.zeros(len(start_m), np.bool_)
    for side in (-1.0, 1.0):
        arc = radius_m * (np.sin(turn)[:, None] * outwards + side * (1.0 - np.cos(turn))[:, None] * sideways)
        p = (start_m[:, None] + arc).reshape(-1, 2)
        is_out = space.touching(p, np.tile(heading_rad + side * turn, len(start_m)))
        found |= ~is_out.reshape(len(start_m), -1).any(axis=1)
    return found
