"""Connections by sampling with OMPL over Dubins paths, shortened."""

import numpy as np

from geometry.arrays import Float64
from geometry.polyline import without_repeats
from geometry.pose2 import Pose2
from planning.ompl_worker import search_poses, search_task, within_area
from planning.turns.dubins import dubins_paths, points_of
from planning.turns.free_space import FreeSpace
from planning.turns.search import ConnectionRequest
from planning.turns.turn import STEP_M, is_free

VALID_EVERY_M = 0.3
SPACING_M = 2.0


def sampled_connection(request: ConnectionRequest, space: FreeSpace, seed: int, iterations: int) -> Float64 | None:
    """Free connection (N, 2), shortened, or None; the same for the same arguments."""
    ends = request.start.ahead(request.run_out_m), request.goal.ahead(-request.line_up_m)
    task = search_task("dubins", ends, space.bodies, space.radius_m, seed, iterations, VALID_EVERY_M)
    poses = search_poses({**task, **within_area(space.allowed), "spacing_m": SPACING_M})
    if not poses:
        return None
    connection = _shortened([request.start, *poses, request.goal], space)
    return connection if connection is not None and is_free(connection, space) else None


def _shortened(poses: list[Pose2], space: FreeSpace) -> Float64 | None:
    """Dubins paths from pose to pose, each to the farthest one that is free; the first and the last are straight."""
    out, k, last = [_points(poses[0], poses[1], space)], 1, len(poses) - 2
    while k < last:
        for j in range(last, k, -1):
            points = _points(poses[k], poses[j], space)
            if len(points) > 1 and is_free(points, space):
                break
        else:
            return None
        out.append(points)
        k = j
    return without_repeats(np.vstack([*out, _points(poses[last], poses[-1], space)]))


def _points(a: Pose2, b: Pose2, space: FreeSpace) -> Float64:
    return points_of(dubins_paths(a, b, space.radius_m)[0], STEP_M)
