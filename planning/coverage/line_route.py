"""Driving swaths and open headland passes in an order of short turns."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from configs.mission import Work
from geometry.arrays import Float64
from geometry.pose2 import Pose2
from planning.coverage.insertion import Stop, Tour, inserted
from planning.coverage.order import Visit, order
from planning.coverage.swath_order import first_line, is_ordered, moved, skip_order
from planning.coverage.work_line import WorkLine
from planning.turns.connector import PathConnector
from planning.turns.search import STEP_M, Connection, bounds_s

REORDERINGS = 6
MAX_TURNS, TRIED = 40, 5  # lines to which a turn is searched, and a connection thoroughly
MAX_FAILURES = 4
MAX_STEPS_BACK = 12
NO_TURN_S = 400.0
NOT_DRIVABLE_S = 1e6


def drive_lines(
    connector: PathConnector, start: Pose2, home: Pose2 | None, lines: Sequence[WorkLine], work: Work
) -> Tour:
    """The lines in order from `start`, so that `home` is reached from the last.

    A line that is not reached is left out, and so is one that cannot be left. With reversing, where lines lie in dead
    ends, the others are then ordered again. Lines that were left out are then put in where a turn leads to them.
    """
    tour = _drive(connector, start, home, lines, work)
    if connector.rig.has_reverse and len(tour.stops) < len(lines):
        again = _drive(connector, start, home, [line for line in lines if tour.has(line)], work)
        if len(again.stops) == len(tour.stops) and again.turns_s < tour.turns_s:
            tour = again
    tour = inserted(connector, tour, home, [line for line in lines if not tour.has(line)])
    if not is_ordered(work):
        return tour
    planned, driven = _ordered(connector, start, home, lines, work), [s.line for s in tour.stops]
    numbers = [k for line in driven for k, one in enumerate(lines) if one is line]
    return replace(tour, moved=moved(planned, numbers, work))


def _drive(connector: PathConnector, start: Pose2, home: Pose2 | None, lines: Sequence[WorkLine], work: Work) -> Tour:
    """The lines in order; where none is reached from the last one, that is put aside until another has been driven.

    It is left out the second time. Of the tours up to such dead ends the one that works most is taken.
    """
    left, aside = _ordered(connector, start, home, lines, work), list[Visit]()
    driven, best = list[tuple[Visit, Connection]](), list[tuple[Visit, Connection]]()
    failures, times_aside, steps_back = [0] * len(lines), [0] * len(lines), 0
    while True:
        pose, behind_m = _place(lines, driven, start)
        found = _next(connector, pose, behind_m, lines, left, failures)
        if found is not None:
            driven.append((left.pop(found[0]), found[1]))
            left, aside = [*left, *aside], []
            continue
        is_end = _is_end(connector, pose, behind_m, home)
        if is_end and _worked_m(lines, driven) > _worked_m(lines, best):
            best = driven.copy()
        if not driven or (best and not left) or steps_back == MAX_STEPS_BACK:
            break
        visit, _ = driven.pop()
        times_aside[visit[0]] += 1
        if times_aside[visit[0]] == 1:
            aside.append(visit)
        steps_back += is_end
    return Tour(start, [Stop(lines[number], is_reversed, way) for (number, is_reversed), way in best])


def _next(
    connector: PathConnector, pose: Pose2, behind_m: float, lines: Sequence[WorkLine], left: Sequence[Visit],
    failures: list[int],
) -> tuple[int, Connection] | None:  # fmt: skip
    """Index of the first visit that is reached by a turn, else thoroughly, and the connection.

    `failures` counts poses from which a thorough search to a line found nothing, up to `MAX_FAILURES`.
    """
    starts = {k: ends[0] for k, (n, is_reversed) in enumerate(left) if (ends := lines[n].ends(is_reversed)) is not None}

    def tried(numbers: Iterable[int], is_thorough: bool) -> tuple[int, Connection] | None:
        for k in numbers:
            if is_thorough and failures[left[k][0]] >= MAX_FAILURES:
                continue
            request = connector.request(pose, starts[k], behind_m, _straight_m(lines, left[k]))
            connection = connector.find(request) if is_thorough else connector.turn(request)
            if connection is not None:
                return k, connection
            failures[left[k][0]] += is_thorough
        return None

    numbers = list(starts)
    return (
        tried(numbers[:1], False)
        or tried(numbers[:1], True)
        or tried(sorted(_nearest(connector, pose, starts)), False)
        or tried(numbers[1:TRIED], True)
    )


def _nearest(connector: PathConnector, pose: Pose2, starts: dict[int, Pose2]) -> list[int]:
    """Those of the starts that are reached soonest without obstacles."""
    rig, config = connector.rig, connector.rig.config
    bound = bounds_s([pose], list(starts.values()), config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)
    return [list(starts)[k] for k in np.argsort(bound[0], kind="stable")[:MAX_TURNS]]


def _is_end(connector: PathConnector, pose: Pose2, behind_m: float, home: Pose2 | None) -> bool:
    """Whether a tour can end here: `home` is reached, where there is one."""
    return home is None or connector.find(connector.home_request(pose, home, behind_m)) is not None


def _place(lines: Sequence[WorkLine], driven: Sequence[tuple[Visit, Connection]], start: Pose2) -> tuple[Pose2, float]:
    """Pose at the end of what was driven, and the straight length behind it."""
    return (_end(lines, driven[-1][0]), _straight_m(lines, driven[-1][0])) if driven else (start, 0.0)


def _worked_m(lines: Sequence[WorkLine], driven: Sequence[tuple[Visit, Connection]]) -> float:
    legs = [lines[number].legs[is_reversed] for (number, is_reversed), _ in driven]
    return sum(float(len(leg.p_map_m)) * STEP_M for leg in legs if leg is not None)


def _straight_m(lines: Sequence[WorkLine], visit: Visit) -> float:
    return lines[visit[0]].straight_m(visit[1])


def _end(lines: Sequence[WorkLine], visit: Visit) -> Pose2:
    leg = lines[visit[0]].legs[visit[1]]
    assert leg is not None
    return leg.pose(-1)


def _ordered(
    connector: PathConnector, start: Pose2, home: Pose2 | None, lines: Sequence[WorkLine], work: Work
) -> list[Visit]:
    """Order by time: bounds of turns that turn out too short are replaced by real times, and the order is repeated.

    A mission may set the first swath, or with `swath_skip` the complete order.
    """
    if not lines:
        return []
    visits = [line.ends(r) for line in lines for r in (False, True)]
    cost = _bounds(connector, start, home, visits)
    if work.swath_skip is not None:
        return skip_order(lines, cost, work, connector.rig.working_width_m)
    first = None if work.swaths_from_m is None else first_line(lines, work.swaths_from_m)
    if first is not None:
        cost[-1, [k for k in range(len(visits)) if k // 2 != first]] += NOT_DRIVABLE_S
    starts = [None if v is None else v[0] for v in visits] + [home]
    ends = [None if v is None else v[1] for v in visits] + [start]
    best: tuple[float, list[Visit]] = (np.inf, [])
    for _ in range(REORDERINGS):
        tour = order(cost)
        stops = [len(visits), *(2 * k + r for k, r in tour), len(visits)]
        total, expected = 0.0, 0.0
        for i, j in pairwise(stops):
            a, b = ends[i], starts[j]
            expected += cost[i, j]
            if a is None or b is None:
                total += cost[i, j]
                continue
            behind_m = _straight_m(lines, (i // 2, bool(i % 2))) if i < len(visits) else 0.0
            if j == len(visits):
                turn = connector.turn(connector.home_request(a, b, behind_m))
            else:
                turn = connector.turn(connector.request(a, b, behind_m, _straight_m(lines, (j // 2, bool(j % 2)))))
            time = NO_TURN_S if turn is None else turn.time_s
            total += time
            cost[i, j] = max(time, cost[i, j])
            if i < len(visits) and j < len(visits):
                cost[j ^ 1, i ^ 1] = max(cost[j ^ 1, i ^ 1], cost[i, j])
        best = min(best, (total, tour), key=lambda b: b[0])
        if total < expected + 0.5:
            break
    return best[1]


def _bounds(
    connector: PathConnector, start: Pose2, home: Pose2 | None, visits: Sequence[tuple[Pose2, Pose2] | None]
) -> Float64:
    config, rig = connector.rig.config, connector.rig
    known = [k for k, v in enumerate(visits) if v is not None]
    pairs = [v for v in visits if v is not None]
    ends, starts = [*(b for _, b in pairs), start], [a for a, _ in pairs] + ([home] if home is not None else [])
    bound = bounds_s(ends, starts, config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)
    n = len(visits)
    cost = np.full((n + 1, n + 1), NOT_DRIVABLE_S)
    cost[np.ix_([*known, n], known)] = bound[:, : len(known)]
    cost[known, n] = bound[:-1, -1] if home is not None else 0.0
    cost[n, n] = 0.0
    return cost
