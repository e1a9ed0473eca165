"""Plan of a complete mission, verified by the swept footprint."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from configs.mission import Line, Mission, Work
from configs.site import PoseConfig, Site
from configs.vehicle import Implement, TrailedImplement, Vehicle
from geometry.arrays import Float64, runs_of
from geometry.footprint import corners_of, worked
from geometry.polygon import grow, open_by, parts, place_of, shrink, united
from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.plan import Path
from planning.config import PlannerConfig, PlanningConfig
from planning.coverage.headland import HeadlandPass, headland_passes_of, pass_coverage
from planning.coverage.interior import AnySwath, area_worked, swaths_inside
from planning.coverage.route import Region, Route, route
from planning.docking.dock import Docking, end_of, plan_docking, plan_undocking
from planning.field.drivable_area import DrivableArea, describe, drivable_area_of, regions_of
from planning.guidance.line import curved_line_of
from planning.line import line_paths
from planning.path import paths_of
from planning.rig import Rig, rig_of
from planning.turns.connector import PathConnector
from planning.turns.free_space import FreeSpace

PROOF_SLACK_M = 0.005  # margin added in planning over the one verified
WORK_SLACK_M = 0.05  # by which a working line may reach over the edge of the field less its margin
MIN_UNCOVERED_M2 = 0.25
Report = Callable[[str], object]
EDGE_MARGIN, TIGHT_CORNER = "edge margin", "corner too tight to turn in"  # reasons of uncovered areas
NARROW_PART = "narrower than the rig"
GUIDANCE_BEND = "beside a bend of the guidance line too tight for the rig"
NARROW_PASSAGE = "behind a passage narrower than the rig"
NARROW_SLACK_M = 0.05
NARROW_SQUARES = 0.25  # of the squared width: smaller parts that no disc as wide as the rig reaches are corners


def ignore(stage: str) -> None:
    """Nobody waits for the plan."""


@dataclass(frozen=True)
class Uncovered:
    """Part of the field that is not planned to be worked."""

    reason: str
    area_m2: float
    place_map_m: tuple[float, float]
    outline: BaseGeometry


@dataclass(frozen=True)
class RefillStop:
    """The machine waits at a refill place at the end of path `path_id`.

    Numbered from 1, with what is worked and driven since the last one, or the start.
    """

    number: int
    reason: str
    place: Pose2
    worked_m2: float
    driven_m: float
    path_id: int


@dataclass(frozen=True)
class Plan:
    """All paths of a mission; `planned_area` is the union of the planned strips in the field.

    The last paths, `docking_paths`, lead into the dock from the planned end of work and show that one exists; they are
    replanned by `docking` from the measured pose. `moved_swaths` are not worked in the order that the mission sets: no
    turn leads there.
    """

    paths: tuple[Path, ...]
    planned_area: BaseGeometry
    field_area_m2: float
    planned_share: float
    length_m: float
    uncovered: tuple[Uncovered, ...]
    swaths: tuple[AnySwath, ...]
    headland_passes: tuple[HeadlandPass, ...]
    drivable: DrivableArea
    rig: Rig
    folded_rig: Rig
    docking: Docking | None = None
    docking_paths: tuple[Path, ...] = ()
    refills: tuple[RefillStop, ...] = ()
    moved_swaths: int = 0

    @property
    def uncovered_m2(self) -> dict[str, float]:
        """Uncovered area by reason, m², largest first."""
        areas: dict[str, float] = {}
        for part in self.uncovered:
            areas[part.reason] = areas.get(part.reason, 0.0) + part.area_m2
        return dict(sorted(areas.items(), key=lambda a: -a[1]))

    @property
    def refill_labels(self) -> dict[tuple[float, float], str]:
        """Numbers of the refill stops at each place in `map`."""
        found: dict[tuple[float, float], str] = {}
        for stop in self.refills:
            at = round(stop.place.x_m, 2), round(stop.place.y_m, 2)
            found[at] = f"{found[at]}, {stop.number}" if at in found else f"{stop.number}"
        return found

    @property
    def fixed_paths(self) -> tuple[Path, ...]:
        """Paths driven as planned: all but those into the dock."""
        return self.paths[: len(self.paths) - len(self.docking_paths)]


def plan_mission(
    mission: Mission,
    site: Site,
    vehicle: Vehicle,
    implement: Implement,
    config: PlanningConfig,
    start: PoseConfig,
    seed: int,
    report: Report = ignore,
) -> Plan:
    """Plan of a mission from `start`: the field, and with a bay the paths out of it and back into it.

    `report` is called with the name of each stage of a field.
    Raises FieldError with the position when it cannot be driven.
    """
    if isinstance(implement, TrailedImplement):
        _check_forward(mission, implement)
    folded = rig_of(vehicle, implement.folded, mission.work, config.planner)
    if mission.line is not None:
        plan = plan_line(mission.line, site, rig_of(vehicle, implement, None, config.planner), folded, start)
    elif mission.work is None:
        plan = _nothing_planned(site, folded)
    else:
        plan = plan_field(site, vehicle, implement, mission.work, config.planner, seed, report)
    if mission.bay is None:
        return plan
    docking = Docking(site, folded, site.bay(mission.bay), config.docking, seed)
    undocking = plan_undocking(docking, 1) if mission.start is None else ()
    fixed_paths = [
        *undocking,
        *(replace(p, path_id=len(undocking) + 1 + k, is_last=False) for k, p in enumerate(plan.paths)),
    ]
    start_pose = end_of(fixed_paths[-1]) if fixed_paths else start.pose
    docking_paths = plan_docking(start_pose, docking, len(fixed_paths) + 1)
    paths = (*fixed_paths, *docking_paths)
    refills = tuple(_shifted(stop, undocking) for stop in plan.refills)
    return replace(
        plan, paths=paths, length_m=_length_m(paths), docking=docking, docking_paths=docking_paths, refills=refills
    )


def _shifted(stop: RefillStop, before: Sequence[Path]) -> RefillStop:
    """A refill stop after further paths before the plan of the field."""
    more_m = _length_m(before) if stop.number == 1 else 0.0
    return replace(stop, path_id=stop.path_id + len(before), driven_m=stop.driven_m + more_m)


def _check_forward(mission: Mission, implement: TrailedImplement) -> None:
    """Raises FieldError for a mission that reverses with a trailed implement."""
    name = f"implement {implement.name!r} is trailed and does not reverse"
    if mission.bay is not None:
        raise FieldError(f"{name}: into bay {mission.bay!r} the machine would; take a mission without bay")
    if mission.line is not None and any(leg.is_reverse for leg in mission.line.legs):
        raise FieldError(f"{name}: leave out the reverse legs of the line")


def plan_field(
    site: Site,
    vehicle: Vehicle,
    implement: Implement,
    work: Work,
    config: PlannerConfig,
    seed: int,
    report: Report = ignore,
) -> Plan:
    """Plan of a field with lane and yard; raises FieldError where the rig would leave them."""
    report("headland")
    rig, folded = (rig_of(vehicle, i, work, config) for i in (implement, implement.folded))
    drivable = drivable_area_of(site, work.boundary_margin_m, work.margins, PROOF_SLACK_M)
    areas = regions_of(drivable, rig.width_m, folded.width_m)
    if rig.trailer is not None:
        if curved_line_of(work) is not None or work.headland == "none":
            raise FieldError(f"implement {implement.name!r} is trailed: straight swaths with headland passes only")
        areas = areas[:1]  # it does not fold, and is in line only after a long straight
    count = 0 if work.headland == "none" and rig.has_reverse else rig.headland_passes(work)
    passes = [headland_passes_of(area, rig, count, work.overlap_m) for area in areas]
    report("swaths")
    space, transport = (r.space(drivable.allowed) for r in (rig, folded))
    on_lines = rig.space(drivable.inner, rig.askew_m)
    regions = list[Region]()
    for region, around in zip(areas, passes, strict=True):
        first = sum(len(r.swaths) for r in regions)
        swaths = [replace(s, number=first + s.number) for s in swaths_inside(region, rig, around, work, on_lines)]
        regions.append(Region(PathConnector(region, rig, around, seed, space), swaths))
    if not any(passes) and not any(r.swaths for r in regions):
        x, y = drivable.field.centroid.coords[0]
        raise FieldError(
            f"field of {drivable.field.area:.0f} m² around {describe(drivable.site, x, y)} is too small for this "
            f"machine with an implement of {rig.working_width_m:g} m: use a narrower implement"
        )
    report("route")
    found = route(regions, transport, work)
    if not found.pieces:
        name, (x, y) = (
            ("end of the lane", site.lanes[-1].center_m[-1]) if site.lanes else ("start", site.start.pose[:2])
        )
        more = "" if rig.has_reverse or rig.trailer is not None else ", or set turns: reverse"
        raise FieldError(f"no line of the field is reached from the {name} at {describe(site, x, y)}: move it{more}")
    report("check")
    surveyed = drivable_area_of(site, work.boundary_margin_m, work.margins)
    spaces = [r.space(surveyed.allowed) for r in (rig, folded)]
    paths, refills = _paths(found, rig, spaces, "" if work.refill is None else work.refill.reason)
    _check_inside(paths, rig, spaces, surveyed)
    paths = working_inside(paths, rig, surveyed.inner)
    area = worked_area(paths, rig).intersection(drivable.whole)
    bends = _beside_bends(regions, passes, rig) if curved_line_of(work) is not None else Polygon()
    uncovered = _uncovered(drivable, areas, area, rig, bends)
    size_m2 = drivable.whole.area
    return Plan(
        paths, area, size_m2, area.area / size_m2, _length_m(paths), uncovered, tuple(found.swaths),
        tuple(found.headland_passes), drivable, rig, folded, refills=refills, moved_swaths=found.moved,
    )  # fmt: skip


def _paths(
    found: Route, rig: Rig, spaces: Sequence[FreeSpace], reason: str
) -> tuple[tuple[Path, ...], tuple[RefillStop, ...]]:
    """Paths of a route in the free spaces of the rig and of the folded one, of which one ends at each refill place."""

    def is_free(points_m: Float64, heading_rad: Float64, is_transport: bool) -> bool:
        return rig.trailer is not None or not spaces[is_transport].touching(points_m, heading_rad).any()

    paths, stops = list[Path](), list[RefillStop]()
    ends = [*(cut.pieces for cut in found.refills), len(found.pieces)]
    for first, end in pairwise([0, *ends]):
        before = len(paths)
        paths += [replace(p, is_last=False) for p in paths_of(found.pieces[first:end], rig, before + 1, is_free)]
        if len(stops) < len(found.refills):
            cut = found.refills[len(stops)]
            driven_m = _length_m(paths[before:])
            stops.append(RefillStop(len(stops) + 1, reason, cut.place, cut.worked_m2, driven_m, len(paths)))
    return (*paths[:-1], replace(paths[-1], is_last=True)), tuple(stops)


def working_inside(paths: Sequence[Path], rig: Rig, inner: BaseGeometry) -> tuple[Path, ...]:
    """The paths without work where the working line reaches out of the field, as on the lane in its gate."""
    field = grow(inner, WORK_SLACK_M)
    shapely.prepare(field)
    found = list[Path]()
    for path, _, edges in _working_lines(paths, rig):
        left, right = (shapely.contains_xy(field, *edge.T) for edge in edges)
        found.append(replace(path, is_working=path.is_working * (left & right)))
    return tuple(found)


def _working_lines(paths: Sequence[Path], rig: Rig) -> Iterator[tuple[Path, Float64, tuple[Float64, Float64]]]:
    """Each path with the headings (N,) of the working line and its left and right ends (N, 2)."""
    hitch_rad = 0.0
    for path in paths:
        p, heading = rig.carriers(path.p_map_m, path.heading_rad, hitch_rad)
        hitch_rad = float(rig.hitch_angles(path.p_map_m, path.heading_rad, hitch_rad)[-1])
        yield path, heading, rig.working_edges(p, heading)


def check_within(plan: Plan, site: Site, work: Work) -> None:
    """Raises FieldError where the rig of a plan would leave field, lane or yard of another site."""
    drivable = drivable_area_of(site, work.boundary_margin_m, work.margins)
    check_inside(plan.paths, plan.rig, plan.folded_rig, drivable)


def plan_line(line: Line, site: Site, rig: Rig, folded: Rig, start: PoseConfig) -> Plan:
    """Plan of a line; raises FieldError where the rig would leave field, lane or yard."""
    drivable = drivable_area_of(site, PROOF_SLACK_M)
    paths = line_paths(line, rig, start.pose)
    paths = (*paths[:-1], replace(paths[-1], is_last=True))
    check_inside(paths, rig, folded, drivable)
    area = worked_area(paths, rig).intersection(drivable.free)
    size_m2 = drivable.free.area
    return Plan(paths, area, size_m2, area.area / size_m2, _length_m(paths), (), (), (), drivable, rig, folded)


def _nothing_planned(site: Site, folded: Rig) -> Plan:
    drivable = drivable_area_of(site, PROOF_SLACK_M)
    return Plan((), Polygon(), drivable.free.area, 0.0, 0.0, (), (), (), drivable, folded, folded)


def _length_m(paths: Sequence[Path]) -> float:
    return sum(float(p.s_m[-1]) for p in paths)


def check_inside(paths: Sequence[Path], rig: Rig, folded: Rig, drivable: DrivableArea) -> None:
    """Raises FieldError with the position where a body leaves the drivable area, or a trailed one turns too far.

    A trailed implement is in line at first.
    """
    _check_inside(paths, rig, [r.space(drivable.allowed) for r in (rig, folded)], drivable)


def _check_inside(paths: Sequence[Path], rig: Rig, spaces: Sequence[FreeSpace], drivable: DrivableArea) -> None:
    hitch_rad = 0.0
    for path in paths:
        outside = spaces[path.is_transport].touching(path.p_map_m, path.heading_rad, hitch_rad)
        angles = rig.hitch_angles(path.p_map_m, path.heading_rad, hitch_rad)
        hitch_rad, k = float(angles[-1]), int(np.argmax(np.abs(angles)))
        if abs(angles[k]) > rig.max_hitch_rad:
            where = describe(drivable.site, *map(float, path.p_map_m[k]))
            raise FieldError(
                f"the implement would turn by {np.degrees(abs(angles[k])):.0f}° against the machine at {where}, "
                f"max_hitch_deg is {np.degrees(rig.max_hitch_rad):.0f}: drive wider bends"
            )
        if outside.any():
            k = int(np.argmax(outside))
            x, y = path.p_map_m[k]
            section_type = path.sections[path.section_index[k]].section_type
            raise FieldError(
                f"the {section_type} path at {describe(drivable.site, x, y)} leaves the field, lane or yard "
                "by the rig's sweep"
            )


def worked_area(paths: Sequence[Path], rig: Rig) -> BaseGeometry:
    """Area swept by the working line where `is_working` is set."""
    shapes = []
    for path, heading, (left, right) in _working_lines(paths, rig):
        for a, b in runs_of(path.is_working > 0):
            keep = corners_of(np.unwrap(heading[a : b + 1])) + a
            shapes.append(worked(left[keep], right[keep]))
    return united(shapes).buffer(0.005, join_style="mitre").buffer(-0.005, join_style="mitre")


def _uncovered(
    complete: DrivableArea, regions: Sequence[DrivableArea], area: BaseGeometry, rig: Rig, bends: BaseGeometry
) -> tuple[Uncovered, ...]:
    """What of the complete area is not worked; of regions without work all counts as behind a narrow passage.

    `bends` is what no drivable line beside a curved guidance line works.
    """
    free = united([r.free for r in regions if r is regions[0] or r.free.intersects(area)])
    rim = free.difference(shrink(free, complete.margin_m + rig.width_m - rig.working_width_m + 0.1))
    missed = free.difference(area)
    narrow = narrow_parts(free, complete.margin_m, rig.width_m)
    elsewhere = missed.difference(narrow)
    inner = MultiPolygon(parts(elsewhere.difference(rim), 0.0))  # GEOS fails where lines and points remain
    shapes = {
        EDGE_MARGIN: elsewhere.intersection(rim),
        GUIDANCE_BEND: inner.intersection(bends),
        TIGHT_CORNER: inner.difference(bends),
        NARROW_PART: missed.intersection(narrow),
        NARROW_PASSAGE: complete.free.difference(free).difference(area),
    }
    if complete.free is not complete.whole:  # with larger margins along parts of the outline
        shapes[EDGE_MARGIN] = shapes[EDGE_MARGIN].union(complete.whole.difference(complete.free).difference(area))
    found = [(reason, p) for reason, shape in shapes.items() for p in parts(shape, MIN_UNCOVERED_M2)]
    return tuple(Uncovered(reason, p.area, place_of(p), p) for reason, p in found)


def _beside_bends(regions: Sequence[Region], passes: Sequence[Sequence[HeadlandPass]], rig: Rig) -> BaseGeometry:
    """What swaths along a curve leave bare between them, also those that are not reached; not at their ends."""
    found = []
    for region, around in zip(regions, passes, strict=True):
        worked_by_passes = united([pass_coverage(p, rig) for p in around])
        inside = shrink(region.connector.drivable.free.difference(worked_by_passes), 0.5 * rig.working_width_m)
        found.append(inside.difference(united([area_worked(s, rig) for s in region.swaths])))
    return united(found)


def narrow_parts(free: BaseGeometry, margin_m: float, width_m: float) -> BaseGeometry:
    """Parts of an area, less its margin, that are narrower than `width_m`; corners are none."""
    beyond = free.difference(grow(open_by(shrink(free, margin_m), width_m / 2.0), margin_m + NARROW_SLACK_M))
    return MultiPolygon(parts(beyond, NARROW_SQUARES * width_m**2))
