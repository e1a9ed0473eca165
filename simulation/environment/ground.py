"""Features of the ground that a scenario adds, drawn from the seed.

Tyres stand on the mean over their contact patch: a wave of the ground of number k is reduced by 2 J1(k r) / (k r)
under a round patch of radius r (mean over a disc; Captain et al. 1979, "Analytical tire models for dynamic vehicle
simulation", compare point contact and patch). Sensors see the ground itself.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import j1

from configs.strict import Config
from geometry.arrays import Float64
from simulation.environment.ground_kernels import COLUMNS, CREST, FURROWS, RUTS, SLOPE, WAVES
from simulation.randomness import generator
from simulation.scenario_environment import Ground
from simulation.scenario_values import draw

PATCH_RADIUS_M = 0.25  # a tractor's rear tyre on soil: 0.5 m long and wide (assumed)


@dataclass(frozen=True)
class Features:
    """`rows` (N, COLUMNS) under the tyres; `furrow_m`: depth and spacing, and their share that tyres bridge.

    `clods`: largest height and number per m². `cells_m`: mesh cells along and across the longest edge that resolve it.
    """

    rows: Float64
    furrow_m: tuple[float, float, float] | None
    clods: tuple[float, float] | None
    cells_m: tuple[float, float]


NO_FEATURES = Features(np.zeros((0, COLUMNS)), None, None, (math.inf, math.inf))


def patch_share(length_m: float) -> float:
    """Share of the height of waves of this length that a tyre follows."""
    k = 2.0 * math.pi / length_m * PATCH_RADIUS_M
    return float(2.0 * j1(k) / k)


def draw_features(ground: Ground, field: Float64, axis_rad: float, start: tuple[float, float], seed: int) -> Features:
    """Features of one run; `field` (K, 2): its corners, `axis_rad`: direction of its longest edge."""
    found = _Rows(seed)
    middle, across = field.mean(axis=0), axis_rad + 0.5 * math.pi
    furrow, clods = None, None
    if ground.waves is not None:
        v = found.draw("waves", ground.waves)
        phase = float(found.random.uniform(0.0, 2.0 * math.pi))
        found.add(
            WAVES, (0.0, 0.0), axis_rad + math.radians(v["heading_deg"]), 0.5 * v["height_m"], v["length_m"], phase
        )
        found.resolve(v["length_m"])
    if ground.crest is not None:
        v = found.draw("crest", ground.crest)
        found.add(CREST, (v["x_m"], v["y_m"]), _across(v), v["height_m"], v["length_m"])
        found.resolve(v["length_m"])
    if ground.ditch is not None:
        v = found.draw("ditch", ground.ditch)
        found.add(CREST, (v["x_m"], v["y_m"]), _across(v), -v["depth_m"], v["width_m"])
        found.resolve(v["width_m"])
    slope = found.draw("slope", ground)["side_slope_deg"]
    if slope != 0.0:
        edge, uphill = _edge_at(start, field, across)
        found.add(SLOPE, edge, uphill, math.tan(math.radians(slope)))
    across_m = found.cell_m
    if ground.furrows is not None:
        v = found.draw("furrows", ground.furrows)
        share = patch_share(v["spacing_m"])
        found.add(FURROWS, (0.0, 0.0), across, 0.5 * v["depth_m"] * share, v["spacing_m"])
        furrow = (v["depth_m"], v["spacing_m"], 1.0 - share)
        across_m = min(across_m, _cell(v["spacing_m"]))
    if ground.ruts is not None:
        v = found.draw("ruts", ground.ruts)
        place = (float(middle[0]), float(middle[1]))
        found.add(RUTS, place, across, v["depth_m"], v["width_m"], v["track_m"], v["spacing_m"])
        across_m = min(across_m, _cell(v["width_m"]))
    if ground.clods is not None:
        v = found.draw("clods", ground.clods)
        clods = (v["height_m"], v["per_m2"])
    return Features(np.array(found.rows).reshape(-1, COLUMNS), furrow, clods, (found.cell_m, across_m))


class _Rows:
    def __init__(self, seed: int) -> None:
        self.random, self._seed = generator(seed, "environment/waves"), seed
        self.rows: list[list[float]] = []
        self.cell_m = math.inf  # of the mesh, in any direction

    def draw(self, name: str, section: Config) -> dict[str, float]:
        """Values of a section, by a generator of its own."""
        return draw(section, generator(self._seed, f"environment/ground/{name}"))

    def resolve(self, length_m: float) -> None:
        """Makes the cells of the mesh small enough for a feature of this length."""
        self.cell_m = min(self.cell_m, _cell(length_m))

    def add(self, kind: float, at: tuple[float, float], heading_rad: float, height_m: float, *numbers: float) -> None:
        """A row; `heading_rad` across the feature."""
        row = [kind, *at, math.cos(heading_rad), math.sin(heading_rad), height_m, *numbers]
        self.rows.append(row + [0.0] * (COLUMNS - len(row)))


def _cell(length_m: float) -> float:
    """A sixth of the length, at least 0.1 m."""
    return max(length_m / 6.0, 0.1)


def _across(values: dict[str, float]) -> float:
    return math.radians(values["heading_deg"]) + 0.5 * math.pi


def _edge_at(start: tuple[float, float], field: Float64, across_rad: float) -> tuple[tuple[float, float], float]:
    """A corner on the edge of the field on the side of the start, and the direction away from it."""
    n = np.array([math.cos(across_rad), math.sin(across_rad)])
    v = field @ n
    is_left = float(np.dot(start, n)) > 0.5 * (v.min() + v.max())
    corner = field[np.argmax(v) if is_left else np.argmin(v)]
    return (float(corner[0]), float(corner[1])), across_rad + math.pi * is_left
