"""Plants as a layer on the ground that beams enter: Beer-Lambert extinction by leaf and stem area.

A beam of direction u passes a path s with the probability exp(-k s) (Monsi and Saeki 1953; Ross 1981, "The radiation
regime and architecture of plant stands"): k = 0.5 × leaf area density for leaves of all directions (spherical
distribution), k = frontal area density × horizontal part of u for upright stems. Plants are evenly spread at random;
rows, clumps and what the machine has rolled or worked down are not modelled.

    lidar ────────.__                       first hit at an optical depth drawn from the exponential distribution
                     ‾‾──.__  top
    ‖ ‖ ‖ ‖ ‖ ‖ ‖ ‖ ‖ ‖ ‖ ‖ ‖x‖ ‖ ‖ ‖ ‖
    ───────────────────────────────── ground
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from configs.site import Site
from geometry.arrays import Float32, Float64, UInt8
from simulation.environment.canopy_kernels import canopy_hits, optical_depths
from simulation.environment.meshes import grid
from simulation.environment.raycast import RaycastScene
from simulation.environment.scenario_scenery import area_of
from simulation.environment.scenery import surveyed_area
from simulation.environment.terrain import Terrain
from simulation.randomness import generator
from simulation.scenario_environment import Vegetation
from simulation.scenario_values import draw

CELL_M = 0.5
MAX_SLOPE = 0.4  # of the ground, for steps towards the canopy: what is steeper is a ditch, below the tops around it
LAMBERT = 2.0 / 3.0  # mean cosine of incidence on hit leaves of all directions


@dataclass(frozen=True)
class Plants:
    """Usual area density (m²/m³), whether it is of upright stems, size of the parts, and reflectivity at 905 nm."""

    density_m2pm3: float
    is_upright: bool
    part_m: float
    reflectivity: float


# Leaf area index 3 at 0.75 m of winter wheat and 2.5 at 0.3 m of grass (within the range of Asner et al. 2003, "Global
# synthesis of leaf area index observations"); 500 stalks of 3 mm per m² of wheat stubble. Green leaves reflect half in
# the near infrared (Jacquemoud and Baret 1990, PROSPECT), straw 0.4.
KINDS = {"crop": Plants(4.0, False, 0.015, 0.5), "stubble": Plants(1.5, True, 0.003, 0.4),
         "grass": Plants(8.0, False, 0.005, 0.5)}  # fmt: skip


class Canopy:
    """All stands of a run."""

    def __init__(self, site: Site, terrain: Terrain, stands: tuple[Vegetation, ...], seed: int) -> None:
        west, south, east, north = surveyed_area(site).buffer(30.0).bounds
        x, y = np.arange(west, east + CELL_M, CELL_M), np.arange(south, north + CELL_M, CELL_M)
        xy = np.stack(np.meshgrid(x, y, indexing="xy"), axis=-1).reshape(-1, 2)
        self._ground = terrain.heights_m(xy).reshape(len(y), len(x)).astype(np.float32)
        down, aside = np.gradient(self._ground, CELL_M)
        self._max_slope = min(1.1 * float(np.hypot(down, aside).max()) + 0.01, MAX_SLOPE)
        self._stand = np.zeros((len(y), len(x)), np.uint8)
        self._grid = np.array([west, south, CELL_M])
        rows = []
        for stand in stands:
            values = draw(stand, generator(seed, f"environment/vegetation/{stand.area}"))
            plants = KINDS[stand.kind]
            density = values.get("density_m2pm3", plants.density_m2pm3)
            k = (0.0, density) if plants.is_upright else (0.5 * density, 0.0)
            rows.append([values["height_m"], *k, plants.part_m, LAMBERT * plants.reflectivity])
            inside = shapely.contains_xy(area_of(site, stand.area), xy).reshape(self._stand.shape)
            self._stand[inside] = len(rows)
        self.stands: Float64 = np.array(rows)

    @cached_property
    def _tops(self) -> RaycastScene:
        """Surface over the plants: rays enter where they meet it."""
        rows, columns = self._ground.shape
        x, y = (self._grid[k] + CELL_M * np.arange(n) for k, n in enumerate((columns, rows)))
        heights = np.concatenate([[0.0], self.stands[:, 0]])[self._stand]
        xyz = np.dstack([*np.meshgrid(x, y, indexing="xy"), self._ground + heights])
        return RaycastScene([grid(xyz)], [0.0])

    def hits(self, rays: Float32, until_m: Float32, depths: Float32, divergence_rad: float) -> tuple[Float32, UInt8]:
        """Range of the first plant in each of S parts of beams (N, 6), infinite where it passes, and its stand, (N, S).

        `until_m` (N, S): range of what is behind; `depths` (N, S): optical depth of the hit, exponentially distributed.
        Parts closer to each other than the plants are thick share a hit.
        """
        return canopy_hits(
            rays,
            self._tops.cast(rays)[0],
            until_m,
            depths,
            divergence_rad,
            self._ground,
            self._stand,
            self._grid,
            self.stands,
            self._max_slope,
        )

    def optical_depth(self, rays: Float32, until_m: Float32) -> Float64:
        """Optical depth of each ray (N, 6) up to a range (N,)."""
        return optical_depths(
            rays, self._tops.cast(rays)[0], until_m, self._ground, self._stand, self._grid, self.stands, self._max_slope
        )

    def first(self, rays: Float32, until_m: Float32, random: np.random.Generator) -> tuple[Float32, UInt8]:
        """Range of what a thin ray hits, (N,), and 1 where that is a plant."""
        depths = random.standard_exponential((len(rays), 1), np.float32)
        found, _ = self.hits(rays, until_m[:, None], depths, 0.0)
        is_plant = np.isfinite(found[:, 0])
        return np.where(is_plant, found[:, 0], until_m), is_plant.astype(np.uint8)
