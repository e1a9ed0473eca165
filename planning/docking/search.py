"""Collision-free docking path: the cheapest Reeds-Shepp path that keeps the clearance."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from geometry.arrays import Float64
from geometry.footprint import Bodies
from geometry.pose2 import Pose2
from planning.config import DockingConfig
from planning.docking.clearance import Bounds, clearance_m
from planning.docking.curvature_ramps import Run, runs_of, solve_endpoint
from planning.docking.reeds_shepp import ReedsSheppPath, Segment, cusps, length_m, reeds_shepp_paths

RADII = (1.0, 1.2, 1.5, 2.0)
MORE_STRAIGHT_M = (0.0, 1.5, 3.0, 5.0, 8.0, 12.0)
MAX_CHECKED = 120
COARSE = 6  # stride of the first check, points


@dataclass(frozen=True)
class DockingSpace:
    """Bounds and the clearance required outside the run-in (`clearance_m`) and on it (`config.bay_clearance_m`)."""

    bounds: Bounds
    bodies: Bodies
    radius_m: float
    clearance_m: float
    config: DockingConfig


@dataclass(frozen=True)
class DockingRequest:
    """Path from `start` to `dock`, its last `run_in_m` straight in reverse."""

    start: Pose2
    dock: Pose2
    run_in_m: float


def shortest_free_runs(request: DockingRequest, space: DockingSpace) -> list[Run] | None:
    """Cheapest free path of a Reeds-Shepp path and the straight run-in, or None."""
    candidates = sorted(_candidates(request, space), key=lambda f: (round(f[0], 6), f[1]))[:MAX_CHECKED]
    return next(
        (runs for _, _, segments in candidates if (runs := free_runs(segments, request, space)) is not None), None
    )


def free_runs(segments: ReedsSheppPath, request: DockingRequest, space: DockingSpace) -> list[Run] | None:
    """The path with ramped curvature, or None without solution or clearance."""
    config = space.config
    if not _is_free(runs_of(segments, request.start, config.ramp_m), request, space, config.ramp_slack_m, COARSE):
        return None
    solved = solve_endpoint(segments, request.start, request.dock, config.ramp_m)
    runs = [] if solved is None else runs_of(solved, request.start, config.ramp_m)
    return runs if runs and _is_free(runs, request, space, 0.0, 1) else None


def min_clearance_m(runs: Iterable[Run], space: DockingSpace) -> tuple[float, Float64]:
    """Smallest clearance along the runs and the position of `base` there."""
    found = []
    for run in runs:
        found_m = clearance_m(space.bounds, space.bodies, run.p_map_m, run.heading_rad)
        k = int(np.argmin(found_m))
        found.append((float(found_m[k]), run.p_map_m[k]))
    return min(found, key=lambda f: f[0])


def _candidates(request: DockingRequest, space: DockingSpace) -> Iterator[tuple[float, int, ReedsSheppPath]]:
    """Paths with their cost and a number that breaks ties."""
    config, number = space.config, 0
    for more_m, factor in product(MORE_STRAIGHT_M, RADII):
        last_m = request.run_in_m + more_m
        for path in reeds_shepp_paths(request.start, request.dock.ahead(last_m), space.radius_m * factor):
            segments = merged_segments((*path, Segment(-last_m, 0.0)))
            if _shortest_run_m(segments) >= config.min_run_m:
                yield length_m(segments) + config.cusp_cost_m * cusps(segments), number, segments
                number += 1


def merged_segments(segments: ReedsSheppPath) -> ReedsSheppPath:
    """Adjacent segments of equal curvature and direction merged."""
    out: list[Segment] = []
    for t in segments:
        if out and out[-1].curvature_radpm == t.curvature_radpm and (out[-1].length_m > 0.0) == (t.length_m > 0.0):
            out[-1] = Segment(out[-1].length_m + t.length_m, t.curvature_radpm)
        else:
            out.append(t)
    return tuple(out)


def _shortest_run_m(segments: ReedsSheppPath) -> float:
    least, run = np.inf, 0.0
    for a, b in zip(segments, (*segments[1:], Segment(0.0, 0.0)), strict=True):
        run += abs(a.length_m)
        if a.length_m * b.length_m <= 0.0:
            least, run = min(least, run), 0.0
    return float(least)


def _is_free(runs: list[Run], request: DockingRequest, space: DockingSpace, slack_m: float, every: int) -> bool:
    for run in runs:
        keep = np.unique(np.append(np.arange(0, len(run.s_m), every), len(run.s_m) - 1))
        is_in_bay = (run is runs[-1]) & (run.s_m[keep] > run.s_m[-1] - request.run_in_m)
        needed = np.where(is_in_bay, space.config.bay_clearance_m, space.clearance_m) - slack_m
        found_m = clearance_m(space.bounds, space.bodies, run.p_map_m[keep], run.heading_rad[keep])
        if np.any(found_m < needed):
            return False
    return True
