"""A way by sampling with OMPL, in a worker process of its own so that its seed holds.

OMPL's seed works once a process and its planners ask a callback written here, so each way gets a fresh process; it ends
after a number of iterations, never after a time, and so gives the same way again.
"""

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from geometry.arrays import Float64
from geometry.footprint import Rectangle, is_inside
from geometry.polyline import without_repeats
from geometry.pose2 import Pose2
from planning.turns.dubins import dubins, points_of
from planning.turns.turn import STEP_M, Space, Wanted, is_free

ROOT = Path(__file__).resolve().parents[1]
WAIT_S = 120.0  # only against a worker that hangs: iterations end the search
VALID_EVERY_M = 0.3


def sampled(wanted: Wanted, space: Space, seed: int, iterations: int) -> Float64 | None:
    """A free way, shortened, or None; the same for the same arguments."""
    start, goal = wanted.start.ahead(wanted.run_out_m), wanted.goal.ahead(-wanted.line_up_m)
    task = {
        "allowed": shapely.to_wkb(space.allowed, hex=True),
        "bodies": [[b.rear_m, b.front_m, b.width_m] for b in space.bodies],
        "radius_m": space.radius_m,
        "poses": [[p.x_m, p.y_m, p.yaw_rad] for p in (start, goal)],
        "seed": seed % 2**31 + 1,
        "iterations": iterations,
    }
    poses = [Pose2(*p) for p in _in_worker(task)]
    if not poses:
        return None
    way = _shortened([wanted.start, *poses, wanted.goal], space)
    return way if way is not None and is_free(way, space) else None


def _in_worker(task: dict[str, Any]) -> list[list[float]]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "planning.sampling"], input=json.dumps(task), capture_output=True, text=True,
        cwd=ROOT, env=environment, timeout=WAIT_S, check=False,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("[")]
    found: list[list[float]] = json.loads(lines[-1]) if done.returncode == 0 and lines else []
    return found


def _shortened(poses: list[Pose2], space: Space) -> Float64 | None:
    """Dubins curves from pose to pose, each as far on as is free; the first and the last are straight."""
    out, k, last = [_curve(poses[0], poses[1], space)], 1, len(poses) - 2
    while k < last:
        for j in range(last, k, -1):
            way = _curve(poses[k], poses[j], space)
            if len(way) > 1 and is_free(way, space):
                break
        else:
            return None
        out.append(way)
        k = j
    return without_repeats(np.vstack([*out, _curve(poses[last], poses[-1], space)]))


def _curve(a: Pose2, b: Pose2, space: Space) -> Float64:
    return points_of(dubins(a, b, space.radius_m)[0], STEP_M)


def search(task: dict[str, Any]) -> list[list[float]]:
    """Poses from start to goal by RRT-Connect on Dubins curves, about 2 m apart; empty when none was found."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(int(task["seed"]))
    allowed = shapely.from_wkb(task["allowed"])
    shapely.prepare(allowed)
    bodies = tuple(Rectangle(*b) for b in task["bodies"])
    states = base.DubinsStateSpace(float(task["radius_m"]))
    states.setBounds(bounds_in(base, allowed.bounds))
    information = base.SpaceInformation(states)

    def is_valid(state: Any) -> bool:
        p, heading = np.array([[state.getX(), state.getY()]]), np.array([state.getYaw()])
        return bool(is_inside(bodies, p, heading, allowed)[0])

    information.setStateValidityChecker(is_valid)
    information.setStateValidityCheckingResolution(VALID_EVERY_M / states.getMaximumExtent())
    information.setup()
    problem = base.ProblemDefinition(information)
    ends = [state_at(states, pose) for pose in task["poses"]]
    problem.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(counter(int(task["iterations"]))))
    if not problem.hasExactSolution():
        return []
    path = problem.getSolutionPath()
    path.interpolate(max(path.getStateCount(), math.ceil(path.length() / 2.0)))
    found = [path.getState(k) for k in range(path.getStateCount())]
    return [[float(s.getX()), float(s.getY()), float(s.getYaw())] for s in found]


def bounds_in(base: Any, bounds: tuple[float, float, float, float]) -> Any:
    """OMPL's box of (west, south, east, north)."""
    box = base.RealVectorBounds(2)
    for k in range(2):
        box.setLow(k, bounds[k])
        box.setHigh(k, bounds[k + 2])
    return box


def state_at(states: Any, pose: list[float]) -> Any:
    """OMPL's state at (x, y, heading)."""
    state = states.allocState()
    state.setX(pose[0])
    state.setY(pose[1])
    yaw = math.remainder(pose[2], 2.0 * math.pi)
    state.setYaw(yaw if yaw < math.pi else -math.pi)  # OMPL's angles end before π: a start at π would be no start
    return state


def counter(most: int) -> Any:
    """What ends a search after so many questions."""
    asked = 0

    def is_over() -> bool:
        nonlocal asked
        asked += 1
        return asked > most

    return is_over


if __name__ == "__main__":
    sys.stdout.write("\n" + json.dumps(search(json.load(sys.stdin))) + "\n")
    sys.stdout.flush()
    os._exit(0)  # OMPL's bindings tell of leaks at a normal end
