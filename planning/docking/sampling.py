"""Docking paths by sampling with OMPL over Reeds-Shepp paths, shortened."""

from geometry.pose2 import Pose2
from planning.docking.clearance import clearance_m
from planning.docking.curvature_ramps import Run, runs_of
from planning.docking.reeds_shepp import ReedsSheppPath, Segment, reeds_shepp_paths
from planning.docking.search import DockingRequest, DockingSpace, free_runs, merged_segments
from planning.ompl_worker import clear_of, search_poses, search_task

VALID_EVERY_M = 0.4
PATHS_TRIED = 8


def sampled_runs(request: DockingRequest, space: DockingSpace, seed: int) -> list[Run] | None:
    """Runs that keep the clearance, shortened, or None; the same for the same arguments."""
    ends = request.start, request.dock.ahead(request.run_in_m)
    iterations = space.config.sampling_iterations
    task = search_task("reeds_shepp", ends, space.bodies, space.radius_m, seed, iterations, VALID_EVERY_M)
    segments = _shortened(search_poses({**task, **clear_of(space.bounds, space.clearance_m)}), space)
    if not segments:
        return None
    return free_runs(merged_segments((*segments, Segment(-request.run_in_m, 0.0))), request, space)


def _shortened(poses: list[Pose2], space: DockingSpace) -> ReedsSheppPath:
    """Reeds-Shepp paths from pose to pose, each to the farthest one that is free; empty where none is."""
    out: ReedsSheppPath = ()
    k = 0
    while k < len(poses) - 1:
        for j in range(len(poses) - 1, k, -1):
            path = _free_path(poses[k], poses[j], space)
            if path is not None:
                break
        else:
            return ()
        out, k = (*out, *path), j
    return out


def _free_path(a: Pose2, b: Pose2, space: DockingSpace) -> ReedsSheppPath | None:
    for path in reeds_shepp_paths(a, b, space.radius_m)[:PATHS_TRIED]:
        runs = runs_of(path, a, space.config.ramp_m)
        found = (clearance_m(space.bounds, space.bodies, r.p_map_m, r.heading_rad).min() for r in runs)
        if min(found, default=0.0) >= space.clearance_m:
            return path
    return None
