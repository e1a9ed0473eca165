"""Scenery that a scenario adds: clods, hedge and trees along the boundary, and plants as cameras see them."""

import math

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from configs.site import Site
from geometry.arrays import Float64
from simulation.environment.meshes import Mesh, join
from simulation.environment.scenery import Piece, SceneryConfig, build_scenery, fence_line, surveyed_area, tree
from simulation.environment.terrain import Terrain
from simulation.randomness import generator
from simulation.scenario_environment import AreaName, Boundary, Environment
from simulation.scenario_values import draw

HEDGE_STEP_M = 1.0
STRIP_M, ROW_M = 0.5, 0.4  # length and distance of strips of plants in camera images


def scenery_of(
    site: Site, terrain: Terrain, config: SceneryConfig, environment: Environment | None, seed: int
) -> list[Piece]:
    """All static pieces of a run; stands of plants replace the crop rows of the configuration."""
    if environment is None:
        return build_scenery(site, terrain, config, seed)
    if environment.vegetation:
        config = config.model_copy(update={"crop_height_m": 0.0})
    return build_scenery(site, terrain, config, seed) + scenario_pieces(site, terrain, environment, seed)


def scenario_pieces(site: Site, terrain: Terrain, environment: Environment, seed: int) -> list[Piece]:
    """Pieces besides those of `build_scenery`."""
    pieces = []
    if terrain.features.clod is not None and 0.0 not in terrain.features.clod:
        pieces.append(Piece("ground", clod_mesh(site, terrain, *terrain.features.clod, seed), 0.25))
    if environment.boundary is not None:
        pieces += boundary_pieces(site, terrain, environment.boundary, seed)
    for stand in environment.vegetation:
        height_m = draw(stand, generator(seed, f"environment/vegetation/{stand.area}"))["height_m"]
        if height_m > 0.0:
            mesh = plant_mesh(area_of(site, stand.area), terrain, height_m, seed)
            pieces.append(Piece(stand.kind, mesh, 0.3, is_solid=False))
    return pieces


def area_of(site: Site, name: AreaName) -> BaseGeometry:
    """Where plants of an area grow: never in the shed, in the yard and on lanes outside of the field."""
    field = Polygon(site.boundary_m).buffer(-0.5)
    bare = surveyed_area(site).difference(Polygon(site.boundary_m))
    bare = bare if site.shed is None else bare.union(Polygon(site.shed.outline_m))
    around = surveyed_area(site).buffer(30.0).difference(surveyed_area(site)).difference(bare)
    return {"field": field, "outside": around, "everywhere": field.union(around)}[name]


def clod_mesh(site: Site, terrain: Terrain, height_m: float, per_m2: float, seed: int) -> Mesh:
    """Half ellipsoids (octahedra) on the field: heights uniform up to the largest, radius equal to the height."""
    random = generator(seed, "environment/clods")
    field = Polygon(site.boundary_m)
    west, south, east, north = field.bounds
    n = round(per_m2 * (east - west) * (north - south))
    xy = np.column_stack([random.uniform(west, east, n), random.uniform(south, north, n)])
    height = height_m * random.uniform(0.3, 1.0, n)
    turn = random.uniform(0.0, 2.0 * math.pi, n)[:, None] + 0.5 * math.pi * np.arange(4)
    inside = shapely.contains_xy(field, xy)
    xy, height, turn = xy[inside], height[inside], turn[inside]
    z = terrain.heights_m(xy) + terrain.furrows_m(xy)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1) * height[:, None, None]
    foot = np.column_stack([xy, z])
    tip = foot + np.outer(height, [0.0, 0.0, 1.0])
    vertices = np.concatenate([foot[:, None] + ring, tip[:, None]], axis=1).reshape(-1, 3)
    one = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    triangles = (one[None] + 5 * np.arange(len(xy))[:, None, None]).reshape(-1, 3)
    return Mesh(vertices.astype(np.float32), triangles.astype(np.int32))


def boundary_pieces(site: Site, terrain: Terrain, boundary: Boundary, seed: int) -> list[Piece]:
    """Hedge and trees outside the boundary."""
    random = generator(seed, "environment/boundary")
    values = draw(boundary, random) if boundary.hedge_height_m else draw(boundary, random) | {"hedge_height_m": 0.0}
    lines = fence_line(site, max(values["distance_m"], 1.2))
    meshes: list[Mesh] = []
    if values["hedge_height_m"] > 0.0:
        meshes += [_hedge(np.array(line.segmentize(HEDGE_STEP_M).coords), terrain, values["hedge_height_m"], random)
                   for line in lines]  # fmt: skip
    for _ in range(boundary.trees):
        line = lines[int(random.integers(len(lines)))]
        place = line.interpolate(random.uniform(0.0, line.length))
        meshes += tree(terrain, place.x, place.y, random.uniform(3.0, 5.0))
    return [Piece("trees", join(meshes), 0.3)]


def _hedge(line: Float64, terrain: Terrain, height_m: float, random: np.random.Generator) -> Mesh:
    """Closed blocks along a line (N, 2), about 1 m wide, with uneven sides and top; neighbours share no vertex."""
    n = len(line)
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    section = np.array([[-0.5, -0.2], [-0.55, 0.6], [-0.2, 1.0], [0.2, 1.0], [0.55, 0.6], [0.5, -0.2]])
    k = len(section)
    aside = section[:, 0] * random.uniform(0.7, 1.3, (n, k))
    up = section[:, 1] * random.uniform(0.85, 1.0, (n, k)) * height_m
    xy = line[:, None] + aside[..., None] * normal[:, None]
    rings = np.concatenate([xy, (terrain.heights_m(line)[:, None] + up)[..., None]], axis=-1)
    blocks = np.concatenate([rings[:-1], rings[1:]], axis=1)  # (n - 1, 2 k, 3)
    side = [f for j in range(k) for f in ((j, (j + 1) % k, j + k), ((j + 1) % k, (j + 1) % k + k, j + k))]
    ends = [(base, base + j, base + j + 1) for base in (0, k) for j in range(1, k - 1)]
    triangles = np.array(side + ends)[None] + 2 * k * np.arange(n - 1)[:, None, None]
    return Mesh(blocks.reshape(-1, 3).astype(np.float32), triangles.reshape(-1, 3).astype(np.int32))


def plant_mesh(area: BaseGeometry, terrain: Terrain, height_m: float, seed: int) -> Mesh:
    """Upright strips of plants over an area, crosswise; cut out in images, and passed by other sensors."""
    random = generator(seed, "environment/plants")
    west, south, east, north = area.bounds
    parts = []
    for turned in (False, True):
        (u0, u1), (v0, v1) = ((south, north), (west, east)) if turned else ((west, east), (south, north))
        u, v = np.arange(u0, u1, STRIP_M), np.arange(v0, v1, 2.0 * ROW_M if turned else ROW_M)
        a, b = (x.ravel() for x in np.meshgrid(v, u, indexing="ij"))
        a = a + random.uniform(-0.15, 0.15, len(a))
        start = np.column_stack([a, b] if turned else [b, a])
        end = start + ([0.0, STRIP_M] if turned else [STRIP_M, 0.0])
        inside = shapely.contains_xy(area, start)
        start, end = start[inside], end[inside]
        low = [np.column_stack([p, terrain.heights_m(p)]) for p in (start, end)]
        top = height_m * random.uniform(0.85, 1.05, len(start))[:, None] * np.array([0.0, 0.0, 1.0])
        vertices = np.stack([low[0], low[1], low[0] + top, low[1] + top], axis=1).reshape(-1, 3)
        one = np.array([[0, 1, 2], [1, 3, 2]])
        triangles = (one[None] + 4 * np.arange(len(start))[:, None, None]).reshape(-1, 3)
        parts.append(Mesh(vertices.astype(np.float32), triangles.astype(np.int32)))
    return join(parts)
