"""Paths into a bay in reverse, and out of it, from any pose in the yard."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import Polygon

from configs.site import Bay, Site
from configs.vehicle import kmh
from geometry.arrays import Float64
from geometry.footprint import footprints
from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.plan import Path, PathSection, PathSectionType
from planning.config import DockingConfig
from planning.docking.clearance import bounds_of, clearance_m, nearest_place, yard_of
from planning.docking.curvature_ramps import Run, runs_of
from planning.docking.reeds_shepp import Segment
from planning.docking.sampling import sampled_runs
from planning.docking.search import DockingRequest, DockingSpace, min_clearance_m, shortest_free_runs
from planning.field.drivable_area import describe
from planning.profile import speed_profile
from planning.rig import Rig


@dataclass(frozen=True)
class Docking:
    """Docking task with the folded `rig`, plannable from any start pose."""

    site: Site
    rig: Rig
    bay: Bay
    config: DockingConfig
    seed: int


def end_of(path: Path) -> Pose2:
    """Pose at the end of a path."""
    return Pose2(float(path.p_map_m[-1, 0]), float(path.p_map_m[-1, 1]), float(path.heading_rad[-1]))


def plan_docking(start: Pose2, docking: Docking, first_id: int, outlines: Sequence[Polygon] = ()) -> tuple[Path, ...]:
    """Paths from standstill at `start` to standstill in the dock, the last in reverse and the end of the mission.

    They keep clear of walls, posts, the edge of the yard and `outlines`; raises FieldError with reason and position.
    """
    runs = _runs(start, docking, outlines)
    return tuple(_path(run, docking, first_id + k, run is runs[-1]) for k, run in enumerate(runs))


def plan_undocking(docking: Docking, first_id: int) -> tuple[Path, ...]:
    """Paths out of the dock to the start of the site: the docking paths from there, reversed."""
    runs = [_reversed(run) for run in reversed(_runs(docking.site.start.pose, docking, ()))]
    return tuple(_path(run, docking, first_id + k, False) for k, run in enumerate(runs))


def _runs(start: Pose2, docking: Docking, outlines: Sequence[Polygon]) -> list[Run]:
    request, space = _request(start, docking), _space(start, docking, outlines)
    _check_run_in(request, space, docking)
    runs = shortest_free_runs(request, space) or sampled_runs(request, space, docking.seed)
    if runs is None:
        x, y = start.x_m, start.y_m
        raise FieldError(
            f"no path into bay {docking.bay.name!r} from {describe(docking.site, x, y)} that keeps "
            f"{space.clearance_m:.2f} m from shed, yard edge and obstacles: make room in the yard or start elsewhere"
        )
    return runs


def _request(start: Pose2, docking: Docking) -> DockingRequest:
    """The run-in extends from the dock to where the rear end is outside the roof, plus `run_in_m`."""
    shed, dock = docking.site.shed, docking.bay.dock.pose
    assert shed is not None
    roof = np.array(shed.outline_m) - [dock.x_m, dock.y_m]
    depth_m = float((roof @ [math.cos(dock.yaw_rad), math.sin(dock.yaw_rad)]).max())
    return DockingRequest(start, dock, depth_m - docking.rig.rear_m + docking.config.run_in_m)


def _space(start: Pose2, docking: Docking, outlines: Sequence[Polygon]) -> DockingSpace:
    site, rig, config = docking.site, docking.rig, docking.config
    assert site.shed is not None
    bounds = bounds_of(site, site.shed, outlines, config.obstacle_clearance_m - config.clearance_m)
    p, heading = np.array([[start.x_m, start.y_m]]), np.array([start.yaw_rad])
    start_clearance_m = float(clearance_m(bounds, rig.bodies, p, heading)[0])
    is_inside = bool(shapely.covers(yard_of(site, site.shed), footprints(rig.bodies, p, heading)).all())
    if not is_inside or start_clearance_m < config.bay_clearance_m:
        x, y = nearest_place(bounds, p[0])
        where = f"only {max(start_clearance_m, 0.0):.2f} m from" if is_inside else "not within"
        raise FieldError(f"the machine stands {where} the bounds of yard and shed at {describe(site, x, y)}: move it")
    return DockingSpace(
        bounds, rig.bodies, rig.radius_m, min(config.clearance_m, start_clearance_m - config.start_slack_m), config
    )


def _check_run_in(request: DockingRequest, space: DockingSpace, docking: Docking) -> None:
    """Checks the run-in, which is the same for every path; the error names its position."""
    first = request.dock.ahead(request.run_in_m)
    (run,) = runs_of((Segment(-request.run_in_m, 0.0),), first, space.config.ramp_m)
    smallest_m, p = min_clearance_m([run], space)
    if smallest_m < space.config.bay_clearance_m:
        x, y = nearest_place(space.bounds, p)
        raise FieldError(
            f"bay {docking.bay.name!r} leaves {max(smallest_m, 0.0):.2f} m beside a rig {docking.rig.width_m:g} m wide "
            f"at {describe(docking.site, x, y)}, less than {space.config.bay_clearance_m:g} m: clear it or choose "
            "another bay"
        )


def _reversed(run: Run) -> Run:
    return Run(
        -run.direction, run.p_map_m[::-1], run.heading_rad[::-1], run.curvature_radpm[::-1], run.s_m[-1] - run.s_m[::-1]
    )


def _path(run: Run, docking: Docking, path_id: int, is_last: bool) -> Path:
    count = len(run.s_m)
    speed = speed_profile(run.s_m, run.curvature_radpm, _limit_mps(run, docking), docking.rig)
    heading: Float64 = np.asarray(np.pi - (np.pi - run.heading_rad) % (2.0 * np.pi), np.float64)
    return Path(
        0, path_id, run.direction, run.p_map_m, heading, run.curvature_radpm, run.s_m, speed,
        np.zeros(count, np.uint8), (PathSection(PathSectionType.DOCK, -1, 0, count - 1),), np.zeros(count, np.int32),
        is_last, True,
    )  # fmt: skip


def _limit_mps(run: Run, docking: Docking) -> Float64:
    """Docking speed near the shed, yard speed beyond, (N,), m/s."""
    config, shed = docking.config, docking.site.shed
    assert shed is not None
    fast = config.yard_kmh if run.direction > 0 else config.yard_reverse_kmh
    distance_m = shapely.distance(Polygon(shed.outline_m), shapely.points(run.p_map_m))
    return np.where(distance_m > config.yard_speed_from_m, kmh(fast), kmh(config.speed_kmh))
