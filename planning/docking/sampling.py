"""A way to the run-in by sampling with OMPL over Reeds-Shepp curves, in a worker process so that its seed holds.

See `planning/sampling.py`: a fresh process for each way, ended by a number of iterations and never by time.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from geometry.footprint import Rectangle
from geometry.pose2 import Pose2
from planning.docking.clearance import Bounds, clearance_m
from planning.docking.curvature_ramps import Run, runs_of
from planning.docking.reeds_shepp import Segment, Way, words
from planning.docking.search import Space, Wanted, free_runs, joined
from planning.sampling import WAIT_S, bounds_in, counter, state_at

ROOT = Path(__file__).resolve().parents[2]
VALID_EVERY_M = 0.4
WORDS_TRIED = 8


def sampled(wanted: Wanted, space: Space, seed: int) -> list[Run] | None:
    """A way that keeps clear, shortened, or None; the same for the same arguments."""
    poses = [Pose2(*p) for p in _in_worker(_task(wanted, space, seed))]
    way = _shortened(poses, space)
    return None if not way else free_runs(joined((*way, Segment(-wanted.run_in_m, 0.0))), wanted, space)


def _task(wanted: Wanted, space: Space, seed: int) -> dict[str, Any]:
    goal, bounds = wanted.dock.ahead(wanted.run_in_m), space.bounds
    ends = np.vstack([bounds.first_m, bounds.last_m])
    return {
        "box": [*ends.min(axis=0).tolist(), *ends.max(axis=0).tolist()],
        "edges": [bounds.first_m.tolist(), bounds.last_m.tolist(), bounds.thickness_m.tolist()],
        "bodies": [[b.rear_m, b.front_m, b.width_m] for b in space.bodies],
        "radius_m": space.radius_m,
        "apart_m": space.apart_m,
        "poses": [[p.x_m, p.y_m, p.yaw_rad] for p in (wanted.start, goal)],
        "seed": seed % 2**31 + 1,
        "iterations": space.config.sampling_iterations,
    }


def _in_worker(task: dict[str, Any]) -> list[list[float]]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "planning.docking.sampling"], input=json.dumps(task), capture_output=True, text=True,
        cwd=ROOT, env=environment, timeout=WAIT_S, check=False,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("[")]
    found: list[list[float]] = json.loads(lines[-1]) if done.returncode == 0 and lines else []
    return found


def _shortened(poses: list[Pose2], space: Space) -> Way:
    """Words from pose to pose, each as far on as keeps clear; empty where one does not."""
    out: Way = ()
    k = 0
    while k < len(poses) - 1:
        for j in range(len(poses) - 1, k, -1):
            word = _free_word(poses[k], poses[j], space)
            if word is not None:
                break
        else:
            return ()
        out, k = (*out, *word), j
    return out


def _free_word(a: Pose2, b: Pose2, space: Space) -> Way | None:
    for word in words(a, b, space.radius_m)[:WORDS_TRIED]:
        runs = runs_of(word, a, space.config.ramp_m)
        apart = (clearance_m(space.bounds, space.bodies, r.p_map_m, r.heading_rad).min() for r in runs)
        if min(apart, default=0.0) >= space.apart_m:
            return word
    return None


def search(task: dict[str, Any]) -> list[list[float]]:
    """Poses from start to goal by RRT-Connect on Reeds-Shepp curves; empty when none was found."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(int(task["seed"]))
    bounds = Bounds(*(np.array(column, np.float64) for column in task["edges"]))
    bodies = tuple(Rectangle(*b) for b in task["bodies"])
    states = base.ReedsSheppStateSpace(float(task["radius_m"]))
    states.setBounds(bounds_in(base, task["box"]))
    information = base.SpaceInformation(states)

    def is_valid(state: Any) -> bool:
        p, heading = np.array([[state.getX(), state.getY()]]), np.array([state.getYaw()])
        return bool(clearance_m(bounds, bodies, p, heading)[0] >= task["apart_m"])

    information.setStateValidityChecker(is_valid)
    information.setStateValidityCheckingResolution(VALID_EVERY_M / states.getMaximumExtent())
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.setStartAndGoalStates(*(state_at(states, pose) for pose in task["poses"]))
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(counter(int(task["iterations"]))))
    if not problem.hasExactSolution():
        return []
    path = problem.getSolutionPath()
    found = [path.getState(k) for k in range(path.getStateCount())]
    return [[float(s.getX()), float(s.getY()), float(s.getYaw())] for s in found]


if __name__ == "__main__":
    sys.stdout.write("\n" + json.dumps(search(json.load(sys.stdin))) + "\n")
    sys.stdout.flush()
    os._exit(0)  # OMPL's bindings tell of leaks at a normal end
