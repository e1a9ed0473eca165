"""The plan of a whole mission, proven inside by the swept footprint."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from configs.mission import Mission, Work
from configs.site import PoseConfig, Site
from configs.vehicle import Implement, Vehicle
from geometry.footprint import is_inside, worked
from geometry.polygon import parts, place_of, shrink
from messages.errors import FieldError
from messages.plan import Path
from planning.config import PlannerConfig, PlanningConfig
from planning.coverage.headland import Round, depth_m, ring_worked, rounds_of
from planning.coverage.route import route
from planning.coverage.swath import Swath, remains, swaths_of, trimmed
from planning.docking.dock import Docking, end_of, plan_docking, plan_undocking
from planning.field.drivable_area import Ground, describe, ground_of
from planning.path import path_of
from planning.rig import Rig, rig_of
from planning.turns.connector import Ways
from planning.turns.turn import Space

PROOF_SLACK_M = 0.02  # planned with so much more margin than is then proven
LEAST_UNCOVERED_M2 = 0.25


@dataclass(frozen=True)
class Uncovered:
    """A part of the field that is not planned to be worked."""

    reason: str
    area_m2: float
    place_map_m: tuple[float, float]
    outline: BaseGeometry


@dataclass(frozen=True)
class Plan:
    """All paths of a mission and what they work; `planned_area` is the union of the planned strips in the field.

    The last of the paths, `homing`, lead into the dock from where the machine should stand by then: a proof that there
    is a way. It is planned anew, by `docking`, from where the machine does stand.
    """

    paths: tuple[Path, ...]
    planned_area: BaseGeometry
    field_area_m2: float
    planned_share: float
    length_m: float
    uncovered: tuple[Uncovered, ...]
    swaths: tuple[Swath, ...]
    rounds: tuple[Round, ...]
    ground: Ground
    rig: Rig
    docking: Docking | None = None
    homing: tuple[Path, ...] = ()

    @property
    def given(self) -> tuple[Path, ...]:
        """The paths that are driven as planned: all but those into the dock."""
        return self.paths[: len(self.paths) - len(self.homing)]


def plan_mission(
    mission: Mission,
    site: Site,
    vehicle: Vehicle,
    implement: Implement,
    config: PlanningConfig,
    start: PoseConfig,
    seed: int,
) -> Plan:
    """The plan of a mission that begins at `start`: the field, and with a bay the ways out of it and back into it.

    Raises FieldError with the place when it cannot be driven.
    """
    if mission.work is None:
        plan = _nothing_planned(site, rig_of(vehicle, implement.folded, None, config.planner))
    else:
        plan = plan_field(site, vehicle, implement, mission.work, config.planner, seed)
    if mission.bay is None:
        return plan
    rig = rig_of(vehicle, implement.folded, mission.work, config.planner)
    docking = Docking(site, rig, site.bay(mission.bay), config.docking, seed)
    out = plan_undocking(docking, 1) if mission.start is None else ()
    given = [*out, *(replace(p, path_id=len(out) + 1 + k, is_last=False) for k, p in enumerate(plan.paths))]
    stands = end_of(given[-1]) if given else start.pose
    homing = plan_docking(stands, docking, len(given) + 1)
    paths = (*given, *homing)
    return replace(plan, paths=paths, length_m=_length_m(paths), docking=docking, homing=homing)


def plan_field(
    site: Site, vehicle: Vehicle, implement: Implement, work: Work, config: PlannerConfig, seed: int
) -> Plan:
    """The plan of a field and the way there and back; raises FieldError where it cannot be driven wholly inside."""
    rig = rig_of(vehicle, implement, work, config)
    ground = ground_of(site, work.boundary_margin_m + PROOF_SLACK_M)
    rounds = rounds_of(ground, rig, work.headland_rounds, work.overlap_m)
    swaths = _swaths(ground, rig, rounds, work)
    pieces = route(Ways(ground, rig, rounds, seed), swaths)
    paths = (path_of(pieces, rig, 1, True),)
    proven = ground_of(site, work.boundary_margin_m)
    prove_inside(paths, rig, proven)
    area = worked_area(paths, rig).intersection(ground.free)
    left = _uncovered(ground, area, rig)
    share = area.area / ground.free.area
    return Plan(paths, area, ground.free.area, share, _length_m(paths), left, tuple(swaths), tuple(rounds), ground, rig)


def _nothing_planned(site: Site, rig: Rig) -> Plan:
    ground = ground_of(site, PROOF_SLACK_M)
    return Plan((), Polygon(), ground.free.area, 0.0, 0.0, (), (), (), ground, rig)


def _length_m(paths: Sequence[Path]) -> float:
    return sum(float(p.s_m[-1]) for p in paths)


def _swaths(ground: Ground, rig: Rig, rounds: list[Round], work: Work) -> list[Swath]:
    depth = depth_m(ground, rig, work.overlap_m, work.headland_rounds - 1) + rig.working_width_m / 2.0 - work.overlap_m
    inner = shrink(ground.free, depth)
    worked_by_rounds = shapely.union_all([ring_worked(r, rig) for r in rounds])
    area = shapely.union_all([inner, remains(ground.free, worked_by_rounds, inner, rig.working_width_m)])
    direction = None if work.swath_direction_deg is None else float(np.radians(work.swath_direction_deg))
    least = rig.config.least_swath_m
    swaths = swaths_of(area, rig.working_width_m, work.overlap_m, least, direction)
    space = Space(ground.allowed, rig.bodies, rig.radius_m, rig.config.smoothing_m)
    kept = (trimmed(s, -rig.working_x_m, space, least) for s in swaths)
    return [replace(s, number=k) for k, s in enumerate(s for s in kept if s is not None)]


def prove_inside(paths: Sequence[Path], rig: Rig, ground: Ground) -> None:
    """Raise FieldError with the place where a body leaves the allowed area at any point of the paths."""
    for path in paths:
        inside = is_inside(rig.bodies, path.p_map_m, path.heading_rad, ground.allowed)
        if not inside.all():
            k = int(np.argmin(inside))
            x, y = path.p_map_m[k]
            section_type = path.sections[path.section_index[k]].section_type
            raise FieldError(
                f"the {section_type} way at {describe(ground.site, x, y)} leaves the field, lane or yard "
                "by the rig's sweep"
            )


def worked_area(paths: Sequence[Path], rig: Rig) -> BaseGeometry:
    """What the working line passes over where the paths say that the implement works."""
    shapes = []
    for path in paths:
        left, right = rig.working_edges(path.p_map_m, path.heading_rad)
        is_working = path.is_working.astype(bool)
        starts = np.flatnonzero(np.diff(np.concatenate([[0], is_working.astype(int)])) == 1)
        ends = np.flatnonzero(np.diff(np.concatenate([is_working.astype(int), [0]])) == -1)
        for a, b in zip(starts, ends, strict=True):
            keep = np.unique(np.append(np.arange(a, b + 1, 2), b))
            shapes.append(worked(left[keep], right[keep]))
    return shapely.union_all(shapes).buffer(0.005, join_style="mitre").buffer(-0.005, join_style="mitre")


def _uncovered(ground: Ground, area: BaseGeometry, rig: Rig) -> tuple[Uncovered, ...]:
    rim = ground.free.difference(shrink(ground.free, ground.margin_m + rig.width_m - rig.working_width_m + 0.1))
    missed = ground.free.difference(area)
    found = [("edge margin", p) for p in parts(missed.intersection(rim), LEAST_UNCOVERED_M2)]
    found += [("corner too tight to turn in", p) for p in parts(missed.difference(rim), LEAST_UNCOVERED_M2)]
    return tuple(Uncovered(reason, p.area, place_of(p), p) for reason, p in found)
