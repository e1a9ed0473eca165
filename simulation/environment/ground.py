"""Features of the ground that a scenario adds, drawn from the seed.

Tyres stand on the mean over their contact patch: a wave of the ground of number k is reduced by 2 J1(k r) / (k r)
under a round patch of radius r (mean over a disc; Captain et al. 1979, "Analytical tire models for dynamic vehicle
simulation", compare point contact and patch). Sensors see the ground itself.
"""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.special import j1
from shapely import Polygon
from shapely.affinity import affine_transform

from configs.strict import Config
from geometry.arrays import Float64
from simulation.environment.ground_kernels import BANK, COLUMNS, CREST, FURROWS, RUTS, SLOPE, WAVES
from simulation.randomness import generator
from simulation.scenario_environment import Ground
from simulation.scenario_values import draw

FAR_M = 200.0  # to which an edge reaches
EDGE_DEPTH_M = 0.1  # from which on the ground is that of a ditch or below a bank
PATCH_RADIUS_M = 0.25  # a tractor's rear tyre on soil: 0.5 m long and wide (assumed)


@dataclass(frozen=True)
class Features:
    """`rows` (N, COLUMNS) under the tyres; `furrow_m`: depth and spacing, and their share that tyres bridge.

    `clod`: largest height and number per m². `cells_m`: mesh cells along and across the longest edge that resolve it.
    `negative`: kind and area of what a machine must not drive into.
    """

    rows: Float64
    furrow_m: tuple[float, float, float] | None
    clod: tuple[float, float] | None
    cells_m: tuple[float, float]
    negative: tuple[tuple[str, Polygon], ...] = ()


NO_FEATURES = Features(np.zeros((0, COLUMNS)), None, None, (math.inf, math.inf))


def patch_share(length_m: float) -> float:
    """Share of the height of waves of this length that a tyre follows."""
    k = 2.0 * math.pi / length_m * PATCH_RADIUS_M
    return float(2.0 * j1(k) / k)


def draw_features(ground: Ground, field: Float64, axis_rad: float, start: tuple[float, float], seed: int) -> Features:
    """Features of one run; `field` (K, 2): its corners, `axis_rad`: direction of its longest edge."""
    drawn = _Drawn(field, axis_rad, start, seed)
    if ground.waves is not None:
        for k in range(ground.waves.count):
            drawn.wave(k, drawn.values(f"wave/{k}", ground.waves))
    for name in ("crest", "ditch", "bank", "furrows", "ruts", "clods"):
        section = getattr(ground, name)
        if section is not None:
            getattr(drawn, name)(drawn.values(name, section))
    drawn.side_slope(drawn.values("slope", ground))
    rows = np.array(drawn.rows).reshape(-1, COLUMNS)
    return Features(rows, drawn.furrow_m, drawn.clod, (drawn.along_m, min(drawn.along_m, drawn.across_m)),
                    tuple(drawn.negative))  # fmt: skip


class _Drawn:
    """Rows of the features, one method per key of `ground`, and the mesh cells that resolve them."""

    def __init__(self, field: Float64, axis_rad: float, start: tuple[float, float], seed: int) -> None:
        self._field, self._axis_rad, self._start, self._seed = field, axis_rad, start, seed
        self.rows: list[list[float]] = []
        self.furrow_m: tuple[float, float, float] | None = None
        self.clod: tuple[float, float] | None = None
        self.along_m = self.across_m = math.inf
        self.negative: list[tuple[str, Polygon]] = []

    def values(self, name: str, section: Config) -> dict[str, float]:
        """Values of a section, by a generator of its own."""
        return draw(section, generator(self._seed, f"environment/ground/{name}"))

    def wave(self, number: int, v: dict[str, float]) -> None:
        """Waves of one length, through the origin of `map`, with a drawn phase."""
        phase = float(generator(self._seed, f"environment/wave phase/{number}").uniform(0.0, 2.0 * math.pi))
        across = self._axis_rad + math.radians(v["heading_deg"])
        self._add(WAVES, (0.0, 0.0), across, 0.5 * v["height_m"], v["length_m"], phase)
        self.along_m = min(self.along_m, _cell(v["length_m"]))

    def crest(self, v: dict[str, float]) -> None:
        """Crest or hollow."""
        across = math.radians(v["heading_deg"]) + 0.5 * math.pi
        self._add(CREST, (v["x_m"], v["y_m"]), across, v["height_m"], v["length_m"])
        self.along_m = min(self.along_m, _cell(v["length_m"]))

    def ditch(self, v: dict[str, float]) -> None:
        """A narrow hollow."""
        self.crest(v | {"height_m": -v["depth_m"], "length_m": v["width_m"]})
        self._resolve(v["width_m"])
        across_rad = math.radians(v["heading_deg"]) + 0.5 * math.pi
        depth_share = min(EDGE_DEPTH_M / v["depth_m"], 1.0)
        half_m = v["width_m"] / (2.0 * math.pi) * math.acos(2.0 * depth_share - 1.0)
        self._add_negative("ditch", v, across_rad, -half_m, half_m)

    def bank(self, v: dict[str, float]) -> None:
        """The ground from the edge on."""
        right = math.radians(v["heading_deg"]) - 0.5 * math.pi
        self._add(BANK, (v["x_m"], v["y_m"]), right, v["height_m"], v["width_m"])
        self._resolve(2.0 * v["width_m"])
        depth_share = min(EDGE_DEPTH_M / v["height_m"], 1.0)
        self._add_negative("bank", v, right, v["width_m"] / math.pi * math.acos(1.0 - 2.0 * depth_share), FAR_M)

    def furrows(self, v: dict[str, float]) -> None:
        """What tyres follow; the rest is added to the mesh."""
        share = patch_share(v["spacing_m"])
        self._add(FURROWS, (0.0, 0.0), self._left_rad, 0.5 * v["depth_m"] * share, v["spacing_m"])
        self.furrow_m = (v["depth_m"], v["spacing_m"], 1.0 - share)
        self.across_m = min(self.across_m, _cell(v["spacing_m"]))

    def ruts(self, v: dict[str, float]) -> None:
        """Pairs about the middle of the field."""
        x, y = (float(c) for c in self._field.mean(axis=0))
        self._add(RUTS, (x, y), self._left_rad, v["depth_m"], v["width_m"], v["track_m"], v["spacing_m"])
        self.across_m = min(self.across_m, _cell(v["width_m"]))

    def clods(self, v: dict[str, float]) -> None:
        """Not under the tyres."""
        self.clod = (v["height_m"], v["per_m2"])

    def side_slope(self, v: dict[str, float]) -> None:
        """Rises from the corner next to the start, across the longest edge."""
        if v["side_slope_deg"] == 0.0:
            return
        left = np.array([math.cos(self._left_rad), math.sin(self._left_rad)])
        off = self._field @ left
        is_left = float(np.dot(self._start, left)) > 0.5 * (off.min() + off.max())
        x, y = (float(c) for c in self._field[np.argmax(off) if is_left else np.argmin(off)])
        self._add(SLOPE, (x, y), self._left_rad + math.pi * is_left, math.tan(math.radians(v["side_slope_deg"])))

    @property
    def _left_rad(self) -> float:
        """Direction across the longest edge."""
        return self._axis_rad + 0.5 * math.pi

    def _add_negative(self, kind: str, v: dict[str, float], across_rad: float, low_m: float, high_m: float) -> None:
        """Area between two distances across a line through a point."""
        c, s = math.cos(across_rad), math.sin(across_rad)
        area = shapely.box(low_m, -FAR_M, high_m, FAR_M)
        self.negative.append((kind, affine_transform(area, (c, -s, s, c, v["x_m"], v["y_m"]))))

    def _resolve(self, length_m: float) -> None:
        """Cells in both directions that resolve a length."""
        self.along_m, self.across_m = (min(m, _cell(length_m)) for m in (self.along_m, self.across_m))

    def _add(self, kind: float, at: tuple[float, float], across_rad: float, height_m: float, *numbers: float) -> None:
        row = [kind, *at, math.cos(across_rad), math.sin(across_rad), height_m, *numbers]
        self.rows.append(row + [0.0] * (COLUMNS - len(row)))


def _cell(length_m: float) -> float:
    """A sixth of the length, at least 0.1 m."""
    return max(length_m / 6.0, 0.1)
