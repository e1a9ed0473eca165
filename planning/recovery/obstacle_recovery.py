"""Recovery from a persistent obstacle stop: paths around the obstacle, or past the section left out."""

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
from planning.path import RawPiece, path_of, rest_of, spliced, started_at
from planning.plan import Plan
from planning.recovery.detour import (
    STRAIGHT_M,
    Detour,
    area_without_obstacles,
    extent_m,
    part_of,
    plan_detour,
    pose_at,
    resume_s_m,
    uncovered_areas,
)
from planning.recovery.static_obstacles import StaticObstacle, extended_depth
from planning.rig import Rig
from planning.turns.headland_transit import along_headland
from planning.turns.sampling import sampled_connection
from planning.turns.search import ConnectionRequest
from planning.turns.turn import dubins_connection

BYPASS_REVERSE_M = (0.0, 4.0, 8.0, 12.0)
BYPASS_SECTIONS = 3


@dataclass(frozen=True)
class ActivePath:
    """Path being driven: from `line_start_m` on it is the line again, whose arc length there is `line_s_m`.

    Without a detour it is the line itself; on a detour it is line, detour, line.
    """

    path: Path
    line_start_m: float
    line_s_m: float

    def line_s_at(self, s_m: float) -> float:
        """Arc length on the line of an arc length after `line_start_m`."""
        return s_m - self.line_start_m + self.line_s_m


@dataclass(frozen=True)
class Blockage:
    """The machine stopped at `p_map_m`, arc length `s_m` of the active path, by `cause`; `others` are elsewhere.

    `line` is the path being worked, `stopped_m` the arc length where work on it ended.
    """

    line: Path
    stopped_m: float
    active: ActivePath
    s_m: float
    p_map_m: Float64
    cause: StaticObstacle
    others: tuple[StaticObstacle, ...]


@dataclass(frozen=True)
class ResumeStep:
    """Step planned when the machine is back on its line: where behind the obstacle work resumes.

    The detour of `blockage` leaves the active path at `leave_m` and meets the line at `rejoin_m`.
    """

    blockage: Blockage
    leave_m: float
    rejoin_m: float


Step = Path | ResumeStep
NewId = Callable[[], int]


def plan_recovery(blockage: Blockage, plan: Plan, config: MissionConfig, seed: int, new_id: NewId) -> list[Step]:
    """Paths around the obstacle and the resume step, in order; empty without a solution."""
    rig, active = plan.rig, blockage.active
    cause = extended_depth(blockage.cause.outline, blockage.p_map_m, config.min_obstacle_depth_m)
    outlines = [cause, *(o.outline for o in blockage.others)]
    allowed = area_without_obstacles(plan.drivable.allowed, outlines, config.clearance_m)
    detour = plan_detour(active.path, blockage.s_m, cause, allowed, rig, config, active.line_start_m)
    if detour is None:
        detour = _bypass(blockage, allowed, plan, config, seed)
    if detour is None:
        return []
    steps: list[Step] = []
    start = blockage.p_map_m
    if len(detour.reverse_m) > 1:
        steps.append(_reverse_path(started_at(detour.reverse_m, start), rig, config, new_id()))
        start = detour.reverse_m[-1]
    around = RawPiece(PathSectionType.DETOUR, -1, started_at(detour.around_m, start), False)
    steps.append(path_of([around], rig, new_id(), False))
    return [*steps, ResumeStep(blockage, detour.leave_s_m, active.line_s_at(detour.rejoin_s_m))]


def blockage_on_detour(
    resume: ResumeStep,
    path: Path,
    s_m: float,
    p_map_m: Float64,
    cause: StaticObstacle,
    others: tuple[StaticObstacle, ...],
) -> Blockage:
    """Blockage at `s_m` of the reverse or forward `path` of a detour."""
    old = resume.blockage
    if path.direction < 0:
        return Blockage(old.line, old.stopped_m, old.active, old.s_m - s_m, p_map_m, cause, others)
    active = _with_detour(resume, path)
    return Blockage(old.line, old.stopped_m, active, resume.leave_m + s_m, p_map_m, cause, others)


def _with_detour(resume: ResumeStep, path: Path) -> ActivePath:
    before, line = resume.blockage.active.path, resume.blockage.line
    left = int(np.searchsorted(before.s_m, resume.leave_m - 0.05))
    rejoin = int(np.searchsorted(line.s_m, resume.rejoin_m + 0.05))
    combined = spliced([(before, 0, left), (path, 0, len(path.s_m)), (line, rejoin, len(line.s_m))], path.path_id)
    line_start = left + len(path.s_m)
    return ActivePath(
        combined,
        float(combined.s_m[min(line_start, len(combined.s_m) - 1)]),
        float(line.s_m[min(rejoin, len(line.s_m) - 1)]),
    )


def plan_resume(
    resume: ResumeStep,
    obstacle: StaticObstacle,
    p_map_m: Float64,
    drivable: BaseGeometry,
    rig: Rig,
    config: MissionConfig,
    new_id: NewId,
) -> tuple[list[Path], tuple[UncoveredArea, ...]]:
    """Path in reverse to just behind the obstacle, if worthwhile, then the rest of the line; uncovered areas."""
    line, stopped_m = resume.blockage.line, resume.blockage.stopped_m
    s_m = resume_s_m(line, resume.rejoin_m, obstacle.outline, stopped_m, rig, config)
    reverse = part_of(line, resume.rejoin_m, s_m)
    paths: list[Path] = []
    if _is_worthwhile(line, s_m, resume.rejoin_m, config) and _is_clear(line, s_m, resume.rejoin_m, drivable, rig):
        paths.append(_reverse_path(started_at(reverse, p_map_m), rig, config, new_id()))
        p_map_m = reverse[-1]
    else:
        s_m = resume.rejoin_m
    paths.append(rest_of(line, s_m, p_map_m, new_id(), rig))
    reason = f"{obstacle.label} on the line"
    outlines = uncovered_areas(line, stopped_m, s_m, rig)
    return paths, tuple(UncoveredArea(reason, float(Polygon(o).buffer(0.0).area), o) for o in outlines)


def _is_worthwhile(path: Path, s_m: float, rejoin_s_m: float, config: MissionConfig) -> bool:
    """True if the implement works between the two and for `min_remaining_m` on."""
    here = (path.s_m >= s_m) & (path.s_m <= rejoin_s_m)
    rest = (path.s_m >= s_m) & (path.s_m <= s_m + config.min_remaining_m)
    return (
        rejoin_s_m - s_m > 1.0 and bool(np.all(path.is_working[here] > 0)) and bool(np.all(path.is_working[rest] > 0))
    )


def _is_clear(line: Path, first_m: float, last_m: float, drivable: BaseGeometry, rig: Rig) -> bool:
    here = (line.s_m >= first_m) & (line.s_m <= last_m)
    return bool(is_inside(rig.bodies, line.p_map_m[here], line.heading_rad[here], drivable).all())


def _reverse_path(points: Float64, rig: Rig, config: MissionConfig, path_id: int) -> Path:
    piece = RawPiece(PathSectionType.DETOUR, -1, points, False)
    return path_of([piece], rig, path_id, False, direction=-1, top_mps=kmh(config.reverse_kmh))


def _bypass(blockage: Blockage, allowed: BaseGeometry, plan: Plan, config: MissionConfig, seed: int) -> Detour | None:
    """Leaves the rest of the line out: reverse, and any connection to the start of one of the next sections."""
    path, line_start_m, rig = blockage.active.path, blockage.active.line_start_m, plan.rig
    space = rig.space(allowed)
    here = int(path.section_index[path.index_at(blockage.s_m)])
    _, past, _, _ = extent_m(path, blockage.s_m, blockage.cause.outline, rig.width_m)
    ahead = [
        t
        for t in path.sections[here + 1 :]
        if t.section_type in (PathSectionType.SWATH, PathSectionType.HEADLAND, PathSectionType.LANE)
    ]
    goals = [float(path.s_m[t.first]) for t in ahead if path.s_m[t.first] > max(past, line_start_m)][:BYPASS_SECTIONS]
    reverses = [b for b in BYPASS_REVERSE_M if b <= min(config.max_reverse_m, blockage.s_m)]
    line_up = rig.config.line_up_m
    options = [
        (s, b, ConnectionRequest(pose_at(path, blockage.s_m - b), pose_at(path, s), STRAIGHT_M, line_up))
        for s in goals
        for b in reverses
    ]
    rings = [r.points_m for r in plan.headland_passes if r.is_closed]
    searches: tuple[Callable[[ConnectionRequest], Float64 | None], ...] = (
        lambda w: dubins_connection(w, space, 20), lambda w: along_headland(w, space, rings)
    )  # fmt: skip
    for search in searches:
        for s, reverse_m, request in options:
            connection = search(request)
            if connection is not None:
                return _bypass_by(path, blockage.s_m, reverse_m, connection, s)
    for s, reverse_m, request in options[-1:]:
        connection = sampled_connection(request, space, seed, rig.config.sampling_iterations)
        if connection is not None:
            return _bypass_by(path, blockage.s_m, reverse_m, connection, s)
    return None


def _bypass_by(path: Path, s_m: float, reverse_m: float, connection: Float64, rejoin_m: float) -> Detour:
    points = part_of(path, s_m, s_m - reverse_m) if reverse_m > 0.0 else np.empty((0, 2))
    return Detour(points, connection, s_m - reverse_m, rejoin_m)
