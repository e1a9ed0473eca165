"""Ground height: smooth, seeded, level in the yard, with grade along and side slope across the field, and the features
of the scenario.

z │      ___          u along the longest edge of the field, v across it, from the yard's centre:
  │   __/             level, then a cosine whose steepest part has the configured grade; superimposed waves
  │__/ yard           of 12 m and more (rolling ground); furrows in the mesh alone (tyres bridge them)
  └────────── u      bounding box of shed and yard: level at height 0, blended outside
"""

import math

import numpy as np
from pydantic import Field
from shapely import Polygon

from configs.site import Site
from configs.strict import Config
from geometry.arrays import Float64
from simulation.environment.ground import NO_FEATURES, draw_features
from simulation.kernels import height_at, heights_at, pose_on_ground
from simulation.randomness import generator
from simulation.scenario_environment import Ground


class TerrainConfig(Config):
    """Shape of the ground; lengths are of a full cosine period."""

    grade: float = Field(ge=0.0, le=0.3)
    grade_length_m: float = Field(gt=20.0, le=2000.0)
    side_slope_deg: float = Field(ge=0.0, le=15.0)
    side_length_m: float = Field(gt=20.0, le=2000.0)
    flat_m: float = Field(
        ge=0.0, le=100.0, description="half width of the level part around the yard, along and across"
    )
    blend_m: float = Field(gt=0.0, le=100.0, description="from the level of shed and yard to the ground")
    wave_amplitude_m: float = Field(ge=0.0, le=0.2, description="of each wave")
    wave_length_m: tuple[float, float]
    wave_count: int = Field(ge=0, le=20)
    furrow_depth_m: float = Field(ge=0.0, le=0.2)
    furrow_spacing_m: float = Field(gt=0.2, le=5.0)


class Terrain:
    """Ground height in `map`; 0 at the site's start and around shed and yard."""

    def __init__(self, site: Site, config: TerrainConfig, seed: int, ground: Ground | None = None) -> None:
        self.config = config
        self.axis_rad = longest_edge_rad(site.boundary_m)
        yard = Polygon(site.yard.outline_m).centroid
        tangent = math.tan(math.radians(config.side_slope_deg))
        self._profile = np.array([
            yard.x, yard.y, math.cos(self.axis_rad), math.sin(self.axis_rad), config.flat_m,
            config.grade * config.grade_length_m / math.pi, 2.0 * math.pi / config.grade_length_m,
            tangent * config.side_length_m / math.pi, 2.0 * math.pi / config.side_length_m, 0.0,
            *([0.0] * 5),
        ])  # fmt: skip
        self._waves = draw_waves(config, generator(seed, "terrain"))
        self._field, start = np.array(site.boundary_m), (site.start.x_m, site.start.y_m)
        if ground is None:
            self.features = NO_FEATURES
        else:
            self.features = draw_features(ground, self._field, self.axis_rad, start, seed)
        self._profile[9] = self.height_m(*start)
        if site.shed is not None:
            level = Polygon(site.shed.outline_m).union(Polygon(site.yard.outline_m)).bounds
            self._profile[10:] = [*level, config.blend_m]

    @property
    def _shape(self) -> tuple[Float64, Float64, Float64, Float64]:
        return self._profile, self._waves, self.features.rows, self._field

    def height_m(self, x_m: float, y_m: float) -> float:
        """Height of the smooth ground (tyre contact)."""
        return height_at(x_m, y_m, *self._shape)

    def heights_m(self, xy_m: Float64) -> Float64:
        """Heights of the smooth ground at (N, 2)."""
        return heights_at(np.ascontiguousarray(xy_m, np.float64), *self._shape)

    def pose_on_ground(self, x_m: float, y_m: float, yaw_rad: float, wheelbase_m: float, track_m: float) -> Float64:
        """Pose of base (4, 4), both rear wheels and the centre of the pivoting front axle on the ground."""
        return pose_on_ground(x_m, y_m, yaw_rad, wheelbase_m, track_m, *self._shape)

    def furrows_m(self, xy_m: Float64) -> Float64:
        """Height of the furrows, parallel to the longest edge, at (N, 2), as far as tyres bridge them."""
        depth, spacing, bridged = self.features.furrow_m or (
            self.config.furrow_depth_m,
            self.config.furrow_spacing_m,
            1.0,
        )
        v = xy_m[:, 1] * math.cos(self.axis_rad) - xy_m[:, 0] * math.sin(self.axis_rad)
        return 0.5 * depth * bridged * np.sin(2.0 * math.pi / spacing * v)


def longest_edge_rad(outline_m: tuple[tuple[float, float], ...]) -> float:
    """Direction of the longest edge of a closed outline."""
    points = np.array(outline_m)
    edges = np.roll(points, -1, axis=0) - points
    dx, dy = edges[np.argmax(np.hypot(edges[:, 0], edges[:, 1]))]
    return math.atan2(dy, dx)


def draw_waves(config: TerrainConfig, random: np.random.Generator) -> Float64:
    """Amplitude, wave vector and phase of each wave, (N, 4)."""
    length = random.uniform(*config.wave_length_m, config.wave_count)
    direction, phase = random.uniform(0.0, 2.0 * math.pi, (2, config.wave_count))
    k = 2.0 * math.pi / length
    amplitude = np.full(config.wave_count, config.wave_amplitude_m)
    return np.column_stack([amplitude, k * np.cos(direction), k * np.sin(direction), phase])
