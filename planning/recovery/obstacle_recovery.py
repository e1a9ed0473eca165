"""From a stop that lasts to the paths round what causes it, or to the stretch that is left out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from configs.vehicle import kmh
from geometry.arrays import Float64
from geometry.footprint import is_inside
from messages.plan import Path, PathSectionType, UncoveredArea
from planning.config import MissionConfig
from planning.path import begun_at, path_of, rest_of, spliced
from planning.plan import Plan
from planning.recovery.detour import (
    STRAIGHT_M,
    Detour,
    extent_m,
    ground_without,
    part_of,
    plan_detour,
    pose_at,
    resume_s_m,
    uncovered_areas,
)
from planning.recovery.static_obstacles import Standing, deepened
from planning.rig import Rig
from planning.sampling import sampled
from planning.turns.connector import Piece
from planning.turns.headland_transit import along_rounds
from planning.turns.turn import Space, Wanted, curve_between

BYPASS_BACK_M = (0.0, 4.0, 8.0, 12.0)
BYPASS_STRETCHES = 3


@dataclass(frozen=True)
class Trunk:
    """The way that the machine is on: from `tail_m` on it is its line again, whose place there is `line_m`.

    Before any detour it is the line itself; on a detour it is line, detour, and line.
    """

    path: Path
    tail_m: float
    line_m: float

    def on_line(self, s_m: float) -> float:
        """The place on the line of a place on the tail."""
        return s_m - self.tail_m + self.line_m


@dataclass(frozen=True)
class Blocked:
    """The machine at `p_map_m`, at `s_m` of its trunk, before `cause`; `others` stand elsewhere.

    `line` is what was being worked, `stopped_m` where on it work ended.
    """

    line: Path
    stopped_m: float
    trunk: Trunk
    s_m: float
    p_map_m: Float64
    cause: Standing
    others: tuple[Standing, ...]


@dataclass(frozen=True)
class Rejoin:
    """What is still to be settled when the machine is back on its line: where behind the obstacle work goes on.

    `blocked` is what it comes from; the way round leaves the trunk at `leave_m` and meets the line at `rejoin_m`.
    """

    blocked: Blocked
    leave_m: float
    rejoin_m: float


Step = Path | Rejoin
NewId = Callable[[], int]


def way_round(blocked: Blocked, plan: Plan, config: MissionConfig, seed: int, new_id: NewId) -> list[Step]:
    """Paths (and the rejoining still to be settled) that lead past, in order; empty when there are none."""
    rig, trunk = plan.rig, blocked.trunk
    cause = deepened(blocked.cause.outline, blocked.p_map_m, config.unseen_depth_m)
    outlines = [cause, *(o.outline for o in blocked.others)]
    allowed = ground_without(plan.ground.allowed, outlines, config.clearance_m)
    detour = plan_detour(trunk.path, blocked.s_m, cause, allowed, rig, config, trunk.tail_m)
    if detour is None:
        detour = _bypass(blocked, allowed, plan, config, seed)
    if detour is None:
        return []
    steps: list[Step] = []
    start = blocked.p_map_m
    if len(detour.back_m) > 1:
        steps.append(_back(begun_at(detour.back_m, start), rig, config, new_id()))
        start = detour.back_m[-1]
    steps.append(
        path_of([Piece(PathSectionType.DETOUR, -1, begun_at(detour.round_m, start), False)], rig, new_id(), False)
    )
    return [*steps, Rejoin(blocked, detour.leave_s_m, trunk.on_line(detour.rejoin_s_m))]


def blocked_again(
    rejoin: Rejoin, path: Path, s_m: float, p_map_m: Float64, cause: Standing, others: tuple[Standing, ...]
) -> Blocked:
    """As `Blocked`, when something stops the machine at `s_m` of the `path` back or round of a detour."""
    old = rejoin.blocked
    if path.direction < 0:
        return Blocked(old.line, old.stopped_m, old.trunk, old.s_m - s_m, p_map_m, cause, others)
    trunk = _with_detour(rejoin, path)
    return Blocked(old.line, old.stopped_m, trunk, rejoin.leave_m + s_m, p_map_m, cause, others)


def _with_detour(rejoin: Rejoin, path: Path) -> Trunk:
    before, line = rejoin.blocked.trunk.path, rejoin.blocked.line
    left = int(np.searchsorted(before.s_m, rejoin.leave_m - 0.05))
    met = int(np.searchsorted(line.s_m, rejoin.rejoin_m + 0.05))
    whole = spliced([(before, 0, left), (path, 0, len(path.s_m)), (line, met, len(line.s_m))], path.path_id)
    tail = left + len(path.s_m)
    return Trunk(whole, float(whole.s_m[min(tail, len(whole.s_m) - 1)]), float(line.s_m[min(met, len(line.s_m) - 1)]))


def settle(
    rejoin: Rejoin,
    seen: Standing,
    p_map_m: Float64,
    ground: BaseGeometry,
    rig: Rig,
    config: MissionConfig,
    new_id: NewId,
) -> tuple[list[Path], tuple[UncoveredArea, ...]]:
    """Back up to just behind the obstacle, as it is now seen, where work is worth it; then on; and what is left out."""
    line, stopped_m = rejoin.blocked.line, rejoin.blocked.stopped_m
    s_m = resume_s_m(line, rejoin.rejoin_m, seen.outline, stopped_m, rig, config)
    back = part_of(line, rejoin.rejoin_m, s_m)
    paths: list[Path] = []
    if _is_worth(line, s_m, rejoin.rejoin_m, config) and _is_clear(line, s_m, rejoin.rejoin_m, ground, rig):
        paths.append(_back(begun_at(back, p_map_m), rig, config, new_id()))
        p_map_m = back[-1]
    else:
        s_m = rejoin.rejoin_m
    paths.append(rest_of(line, s_m, p_map_m, new_id(), rig))
    reason = f"{seen.label} stands on the line"
    outlines = uncovered_areas(line, stopped_m, s_m, rig)
    return paths, tuple(UncoveredArea(reason, float(Polygon(o).buffer(0.0).area), o) for o in outlines)


def _is_worth(path: Path, s_m: float, rejoin_s_m: float, config: MissionConfig) -> bool:
    """Whether work lies between, on a line that goes on for a while."""
    here = (path.s_m >= s_m) & (path.s_m <= rejoin_s_m)
    rest = (path.s_m >= s_m) & (path.s_m <= s_m + config.least_rest_m)
    return (
        rejoin_s_m - s_m > 1.0 and bool(np.all(path.is_working[here] > 0)) and bool(np.all(path.is_working[rest] > 0))
    )


def _is_clear(line: Path, first_m: float, last_m: float, ground: BaseGeometry, rig: Rig) -> bool:
    here = (line.s_m >= first_m) & (line.s_m <= last_m)
    return bool(is_inside(rig.bodies, line.p_map_m[here], line.heading_rad[here], ground).all())


def _back(points: Float64, rig: Rig, config: MissionConfig, path_id: int) -> Path:
    piece = Piece(PathSectionType.DETOUR, -1, points, False)
    return path_of([piece], rig, path_id, False, direction=-1, top_mps=kmh(config.reverse_kmh))


def _bypass(blocked: Blocked, allowed: BaseGeometry, plan: Plan, config: MissionConfig, seed: int) -> Detour | None:
    """Leave the rest of the line out: back off, and by any way to the start of one of the next sections."""
    path, tail_m, rig = blocked.trunk.path, blocked.trunk.tail_m, plan.rig
    space = Space(allowed, rig.bodies, rig.radius_m, rig.config.smoothing_m)
    here = int(path.section_index[min(int(np.searchsorted(path.s_m, blocked.s_m)), len(path.s_m) - 1)])
    _, past, _, _ = extent_m(path, blocked.s_m, blocked.cause.outline, rig.width_m)
    ahead = [
        t
        for t in path.sections[here + 1 :]
        if t.section_type in (PathSectionType.SWATH, PathSectionType.HEADLAND, PathSectionType.LANE)
    ]
    aims = [float(path.s_m[t.first]) for t in ahead if path.s_m[t.first] > max(past, tail_m)][:BYPASS_STRETCHES]
    backs = [b for b in BYPASS_BACK_M if b <= min(config.most_reverse_m, blocked.s_m)]
    line_up = rig.config.line_up_m
    options = [
        (s, b, Wanted(pose_at(path, blocked.s_m - b), pose_at(path, s), STRAIGHT_M, line_up))
        for s in aims
        for b in backs
    ]
    rings = [r.points_m for r in plan.rounds]
    searches: tuple[Callable[[Wanted], Float64 | None], ...] = (
        lambda w: curve_between(w, space, 20), lambda w: along_rounds(w, space, rings)
    )  # fmt: skip
    for search in searches:
        for s, back, wanted in options:
            way = search(wanted)
            if way is not None:
                return _bypass_by(path, blocked.s_m, back, way, s)
    for s, back, wanted in options[-1:]:
        way = sampled(wanted, space, seed, rig.config.sampling_iterations)
        if way is not None:
            return _bypass_by(path, blocked.s_m, back, way, s)
    return None


def _bypass_by(path: Path, s_m: float, back_m: float, way: Float64, rejoin_m: float) -> Detour:
    points = part_of(path, s_m, s_m - back_m) if back_m > 0.0 else np.empty((0, 2))
    return Detour(points, way, s_m - back_m, rejoin_m)
