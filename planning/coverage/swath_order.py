"""Order of swaths that the mission sets: the first one next to a point, and a number left out between two.

A block is divided into cells, in which each row has one swath that lies beside those of the rows next to it.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence

from shapely.geometry import LineString, Point

from configs.mission import Work
from geometry.arrays import Float64
from planning.coverage.headland import HeadlandPass
from planning.coverage.interior import AnySwath
from planning.coverage.order import Visit
from planning.coverage.work_line import WorkLine
from planning.turns.search import Leg

NEAR_WIDTHS = 1.1  # distance of swaths in neighbouring rows, in working widths
BESIDE = 0.5  # of the shorter one lies beside the other
LEAST_ROWS = 3  # of a block with the first swath: fewer lie in gaps between headland passes


def is_ordered(work: Work) -> bool:
    """Whether the mission sets the first swath or the order of all."""
    return work.swath_skip is not None or work.swaths_from_m is not None


def first_line(lines: Sequence[WorkLine], point_m: tuple[float, float]) -> int | None:
    """Index of the outermost swath of a block next to a point; None without swaths."""
    blocks = _blocks(lines)
    large = [rows for rows in blocks if len(rows) >= LEAST_ROWS] or blocks
    outermost = sorted({k for rows in large for row in (rows[0], rows[-1]) for k in row})
    point = Point(point_m)
    return min(outermost, key=lambda k: round(_line(lines[k]).distance(point), 3), default=None)


def skip_order(lines: Sequence[WorkLine], cost: Float64, work: Work, width_m: float) -> list[Visit]:
    """Swaths cell by cell, the nearest next, in each those left out on the way back, and then the other lines.

    `cost` as for `order`. A cell with less than twice as many swaths as one step skips fewer.
    """
    step = 1 if work.swath_skip is None else work.swath_skip + 1
    first = None if work.swaths_from_m is None else first_line(lines, work.swaths_from_m)
    left = [way for cell in _cells(lines, width_m) for way in (cell, cell[::-1])]
    left += [[k] for k, line in enumerate(lines) if isinstance(line.source, HeadlandPass)]
    visits, at = list[Visit](), len(cost) - 1
    while left:
        starts = [way for way in left if way[0] == first] if not visits and first is not None else left
        _, _, way = min((_nearest(cost, at, way[0])[0], k, way) for k, way in enumerate(starts))
        for line in skipping(way, step):
            _, at = _nearest(cost, at, line)
            visits.append((line, bool(at % 2)))
        left = [other for other in left if other[0] not in way]
    return visits


def skipping(rows: Sequence[int], step: int) -> list[int]:
    """Every `step`-th of some rows, then those left out, there and back; smaller steps over few rows."""
    step = max(1, min(step, len(rows) // 2))
    ways = [rows[first::step] for first in range(step)]
    return [row for k, way in enumerate(ways) for row in (way[::-1] if k % 2 else way)]


def moved(planned: Sequence[Visit], driven: Sequence[int], work: Work) -> int:
    """Number of the driven lines that do not follow the one of the planned order; without `swath_skip` of the first."""
    expected = [line for line, _ in planned if line in driven]
    count = 1 if work.swath_skip is None else len(driven)
    last = dict(zip(expected, [-1, *expected], strict=False))
    return sum(last[line] != before for before, line in zip([-1, *driven], driven[:count], strict=False))


def _nearest(cost: Float64, at: int, line: int) -> tuple[float, int]:
    """Least cost from a visit to a line in either direction, and the visit of it."""
    return min((round(float(cost[at, v]), 6), v) for v in (2 * line, 2 * line + 1))


def _blocks(lines: Sequence[WorkLine]) -> list[list[list[int]]]:
    """Indices of the swaths by block and row."""
    found: dict[int, dict[float, list[int]]] = defaultdict(lambda: defaultdict(list))
    for k, line in enumerate(lines):
        if isinstance(line.source, AnySwath):
            found[line.source.block][line.source.row].append(k)
    return [[rows[row] for row in sorted(rows)] for _, rows in sorted(found.items())]


def _cells(lines: Sequence[WorkLine], width_m: float) -> Iterator[list[int]]:
    """Indices of the swaths of each cell, across it."""
    for rows in _blocks(lines):
        open_cells = [[k] for k in rows[0]]
        for row in rows[1:]:
            beside = {k: [c for c in open_cells if _is_beside(lines[c[-1]], lines[k], width_m)] for k in row}
            following = [k for k in row if len(beside[k]) == 1 and sum(beside[k][0] in b for b in beside.values()) == 1]
            ended = [c for c in open_cells if all(beside[k][0] is not c for k in following)]
            yield from ended
            for k in following:
                beside[k][0].append(k)
            open_cells = [c for c in open_cells if all(c is not e for e in ended)]
            open_cells += [[k] for k in row if k not in following]
        yield from open_cells


def _is_beside(line: WorkLine, other: WorkLine, width_m: float) -> bool:
    """Whether a swath lies beside one in the next row over half of the shorter one."""
    a, b = _line(line), _line(other)
    shared = a.buffer(NEAR_WIDTHS * width_m, cap_style="flat").intersection(b)
    return bool(shared.length > BESIDE * min(a.length, b.length))


def _line(line: WorkLine) -> LineString:
    leg = max((leg for leg in line.legs if leg is not None), key=_length)
    return LineString(leg.p_map_m)


def _length(leg: Leg) -> int:
    return len(leg.p_map_m)
