"""Duration of the first docking plan per bay, from seeded starts around the end of the lane.

    ./headland benchmark docking [--seeds 40]

Starts are drawn as for `./headland run --mission dock --seed N`. Limit: first plan within 0.5 s.
"""

import argparse
import statistics
import sys
import time
from dataclasses import dataclass

from configs.mission import Mission
from configs.site import Site
from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import ImplementFile, Vehicle
from messages.errors import FieldError
from messages.plan import Path
from planning.config import PlanningConfig
from planning.docking.dock import Docking, plan_docking
from planning.rig import rig_of
from runtime.setup import start_pose

LIMIT_S = 0.5


@dataclass(frozen=True)
class Trial:
    """One plan: wall and processor time, paths, or the reason of refusal."""

    wall_s: float
    busy_s: float
    paths: tuple[Path, ...]
    refusal: str


def dockings() -> tuple[Mission, list[Docking]]:
    """Docking mission, and the docking of each bay of its site."""
    mission = load(Mission, find("missions", "dock"))
    site, vehicle = load(Site, find("sites", mission.site)), load(Vehicle, find("machines", mission.machine))
    planning = parse(PlanningConfig, read_yaml(CONFIGS / "stack/planning.yaml"), "stack/planning.yaml")
    implement = load(ImplementFile, find("implements", mission.implement)).implement
    rig = rig_of(vehicle, implement.folded, None, planning.planner)
    bays = () if site.shed is None else site.shed.bays
    return mission, [Docking(site, rig, bay, planning.docking, 0) for bay in bays]


def trial(docking: Docking, mission: Mission, seed: int) -> Trial:
    """Plans from the start drawn by a seed."""
    start, _ = start_pose(mission, docking.site, seed)
    began_s, busy_s = time.perf_counter(), time.process_time()
    try:
        paths, refusal = plan_docking(start.pose, docking, 1), ""
    except FieldError as error:
        paths, refusal = (), str(error)
    return Trial(time.perf_counter() - began_s, time.process_time() - busy_s, paths, refusal)


def line(docking: Docking, trials: list[Trial]) -> str:
    """One bay in words."""
    wall, busy = [1e3 * t.wall_s for t in trials], [1e3 * t.busy_s for t in trials]
    planned = [t.paths for t in trials if t.paths]
    cusps = [len(paths) - 1 for paths in planned]
    lengths = [sum(float(p.s_m[-1]) for p in paths) for paths in planned]
    return (
        f"{docking.bay.name:8} {len(planned)} of {len(trials)} planned, median {statistics.median(wall):.0f} ms, "
        f"max {max(wall):.0f} ms (processor {statistics.median(busy):.0f} and {max(busy):.0f} ms); "
        f"cusps {min(cusps)} to {max(cusps)}, length {min(lengths):.0f} to {max(lengths):.0f} m"
    )


def main() -> int:
    """Prints a line per bay and the refusals; returns 1 when a plan exceeded the limit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    count = parser.parse_args().seeds
    mission, found = dockings()
    slowest_s = 0.0
    for docking in found:
        trials = [trial(docking, mission, seed) for seed in range(1, count + 1)]
        slowest_s = max(slowest_s, *(t.wall_s for t in trials))
        sys.stdout.write(line(docking, trials) + "\n")
        for refusal in sorted({t.refusal for t in trials} - {""}):
            sys.stdout.write(f"         refused: {refusal}\n")
    return int(slowest_s > LIMIT_S)


if __name__ == "__main__":
    sys.exit(main())
