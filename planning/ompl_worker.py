"""Path search with OMPL (RRT-Connect) in a worker process: `search_poses` here, `python -m planning.ompl_worker` there.

OMPL's seed holds once per process and its planners call back into Python, so each query gets a fresh process. It ends
after a number of iterations, never after a time, and so repeats its result.
"""

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from geometry.footprint import Bodies, is_inside
from geometry.pose2 import Pose2
from geometry.rectangle import Rectangle
from planning.docking.clearance import Bounds, clearance_m

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT_S = 120.0  # only for a worker that hangs: iterations end the search
Task = dict[str, Any]
IsFree = Callable[[Pose2], bool]


def search_task(
    curves: Literal["dubins", "reeds_shepp"],
    poses: Sequence[Pose2],
    bodies: Bodies,
    radius_m: float,
    seed: int,
    iterations: int,
    valid_every_m: float,
) -> Task:
    """Query from the first to the second pose, still without its free space (`within_area` or `clear_of`)."""
    return {
        "curves": curves,
        "poses": [list(p) for p in poses],
        "bodies": [[b.rear_m, b.front_m, b.width_m] for b in bodies],
        "radius_m": radius_m,
        "seed": seed % 2**31 + 1,
        "iterations": iterations,
        "valid_every_m": valid_every_m,
    }


def within_area(allowed: BaseGeometry) -> Task:
    """Free space: all bodies inside an area."""
    return {"allowed": shapely.to_wkb(allowed, hex=True), "box": list(allowed.bounds)}


def clear_of(bounds: Bounds, distance_m: float) -> Task:
    """Free space: all bodies at least `distance_m` from the bounds."""
    ends = np.vstack([bounds.first_m, bounds.last_m])
    edges = [bounds.first_m.tolist(), bounds.last_m.tolist(), bounds.thickness_m.tolist()]
    box = [*ends.min(axis=0).tolist(), *ends.max(axis=0).tolist()]
    return {"edges": edges, "distance_m": distance_m, "box": box}


def search_poses(task: Task) -> list[Pose2]:
    """Poses from start to goal; empty when none were found. The same for the same task."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "planning.ompl_worker"], input=json.dumps(task), capture_output=True, text=True,
        cwd=ROOT, env=environment, timeout=TIMEOUT_S, check=False,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("[")]
    return [Pose2(*p) for p in json.loads(lines[-1])] if done.returncode == 0 and lines else []


def _search(task: Task) -> list[list[float]]:
    """In the worker: RRT-Connect; with `spacing_m` the poses are interpolated to that distance."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(int(task["seed"]))
    is_free = _area_check(task) if "allowed" in task else _clearance_check(task)
    curves = base.DubinsStateSpace if task["curves"] == "dubins" else base.ReedsSheppStateSpace
    states = curves(float(task["radius_m"]))
    states.setBounds(_box(base, task["box"]))
    information = base.SpaceInformation(states)
    information.setStateValidityChecker(lambda state: is_free(_pose_of(state)))
    information.setStateValidityCheckingResolution(task["valid_every_m"] / states.getMaximumExtent())
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.setStartAndGoalStates(*(_state_at(states, Pose2(*pose)) for pose in task["poses"]))
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(_counter(int(task["iterations"]))))
    if not problem.hasExactSolution():
        return []
    path = problem.getSolutionPath()
    if "spacing_m" in task:
        path.interpolate(max(path.getStateCount(), math.ceil(path.length() / task["spacing_m"])))
    return [list(_pose_of(path.getState(k))) for k in range(path.getStateCount())]


def _area_check(task: Task) -> IsFree:
    allowed: Any = shapely.from_wkb(task["allowed"])
    bodies = _bodies(task)
    shapely.prepare(allowed)
    return lambda pose: bool(is_inside(bodies, *_arrays(pose), allowed)[0])


def _clearance_check(task: Task) -> IsFree:
    bounds, bodies = Bounds(*(np.array(column, np.float64) for column in task["edges"])), _bodies(task)
    return lambda pose: bool(clearance_m(bounds, bodies, *_arrays(pose))[0] >= task["distance_m"])


def _bodies(task: Task) -> Bodies:
    return tuple(Rectangle(*b) for b in task["bodies"])


def _arrays(pose: Pose2) -> tuple[Any, Any]:
    return np.array([[pose.x_m, pose.y_m]]), np.array([pose.yaw_rad])


def _box(base: Any, bounds: Sequence[float]) -> Any:
    """OMPL's bounds of (west, south, east, north)."""
    box = base.RealVectorBounds(2)
    for k in range(2):
        box.setLow(k, bounds[k])
        box.setHigh(k, bounds[k + 2])
    return box


def _pose_of(state: Any) -> Pose2:
    return Pose2(float(state.getX()), float(state.getY()), float(state.getYaw()))


def _state_at(states: Any, pose: Pose2) -> Any:
    state = states.allocState()
    state.setX(pose.x_m)
    state.setY(pose.y_m)
    yaw = math.remainder(pose.yaw_rad, 2.0 * math.pi)
    state.setYaw(yaw if yaw < math.pi else -math.pi)  # OMPL's angles end before π: a start at π would be invalid
    return state


def _counter(limit: int) -> Callable[[], bool]:
    """Termination condition after `limit` calls."""
    calls = 0

    def is_over() -> bool:
        nonlocal calls
        calls += 1
        return calls > limit

    return is_over


if __name__ == "__main__":
    sys.stdout.write("\n" + json.dumps(_search(json.load(sys.stdin))) + "\n")
    sys.stdout.flush()
    os._exit(0)  # OMPL's bindings report leaks at a normal exit
