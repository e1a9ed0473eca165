"""A way between two poses that keeps clear: Reeds-Shepp words first, then by sampling."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from geometry.arrays import Float64
from geometry.footprint import Bodies
from geometry.pose2 import Pose2
from planning.config import DockingConfig
from planning.docking.clearance import Bounds, clearance_m
from planning.docking.curvature_ramps import Run, led_to, runs_of
from planning.docking.reeds_shepp import Segment, Way, cusps, length_m, words

RADII = (1.0, 1.2, 1.5, 2.0)
MORE_STRAIGHT_M = (0.0, 1.5, 3.0, 5.0, 8.0, 12.0)
MOST_CHECKED = 120
COARSE = 6  # points between two poses looked at first


@dataclass(frozen=True)
class Space:
    """What the bodies keep clear of, and by how much before the bay (`apart_m`) and in it (`config`)."""

    bounds: Bounds
    bodies: Bodies
    radius_m: float
    apart_m: float
    config: DockingConfig


@dataclass(frozen=True)
class Wanted:
    """A way from `start` to `dock`, the last `run_in_m` of it straight in reverse and in the bay."""

    start: Pose2
    dock: Pose2
    run_in_m: float


def free_word(wanted: Wanted, space: Space) -> list[Run] | None:
    """The first free one of the cheapest ways by a word and the straight run-in."""
    ways = sorted(_candidates(wanted, space), key=lambda f: (round(f[0], 6), f[1]))[:MOST_CHECKED]
    return next((runs for _, _, way in ways if (runs := free_runs(way, wanted, space)) is not None), None)


def free_runs(way: Way, wanted: Wanted, space: Space) -> list[Run] | None:
    """The way as it can be steered, or None when it cannot or does not keep clear."""
    config = space.config
    if not _is_free(runs_of(way, wanted.start, config.ramp_m), wanted, space, config.ramp_slack_m, COARSE):
        return None
    led = led_to(way, wanted.start, wanted.dock, config.ramp_m)
    runs = [] if led is None else runs_of(led, wanted.start, config.ramp_m)
    return runs if runs and _is_free(runs, wanted, space, 0.0, 1) else None


def least_clearance_m(runs: Iterable[Run], space: Space) -> tuple[float, Float64]:
    """The smallest clearance along a way and the place of `base` there."""
    found = []
    for run in runs:
        apart = clearance_m(space.bounds, space.bodies, run.p_map_m, run.heading_rad)
        k = int(np.argmin(apart))
        found.append((float(apart[k]), run.p_map_m[k]))
    return min(found, key=lambda f: f[0])


def _candidates(wanted: Wanted, space: Space) -> Iterator[tuple[float, int, Way]]:
    """Ways with their cost and a number that decides between equals."""
    config, number = space.config, 0
    for more_m, factor in product(MORE_STRAIGHT_M, RADII):
        last_m = wanted.run_in_m + more_m
        for word in words(wanted.start, wanted.dock.ahead(last_m), space.radius_m * factor):
            way = joined((*word, Segment(-last_m, 0.0)))
            if _shortest_run_m(way) >= config.least_run_m:
                yield length_m(way) + config.cusp_cost_m * cusps(way), number, way
                number += 1


def joined(way: Way) -> Way:
    """Neighbours of the same curvature and direction as one."""
    out: list[Segment] = []
    for t in way:
        if out and out[-1].curvature_radpm == t.curvature_radpm and (out[-1].length_m > 0.0) == (t.length_m > 0.0):
            out[-1] = Segment(out[-1].length_m + t.length_m, t.curvature_radpm)
        else:
            out.append(t)
    return tuple(out)


def _shortest_run_m(way: Way) -> float:
    least, run = np.inf, 0.0
    for a, b in zip(way, (*way[1:], Segment(0.0, 0.0)), strict=True):
        run += abs(a.length_m)
        if a.length_m * b.length_m <= 0.0:
            least, run = min(least, run), 0.0
    return float(least)


def _is_free(runs: list[Run], wanted: Wanted, space: Space, slack_m: float, every: int) -> bool:
    for run in runs:
        keep = np.unique(np.append(np.arange(0, len(run.s_m), every), len(run.s_m) - 1))
        is_in_bay = (run is runs[-1]) & (run.s_m[keep] > run.s_m[-1] - wanted.run_in_m)
        needed = np.where(is_in_bay, space.config.bay_clearance_m, space.apart_m) - slack_m
        apart = clearance_m(space.bounds, space.bodies, run.p_map_m[keep], run.heading_rad[keep])
        if np.any(apart < needed):
            return False
    return True
