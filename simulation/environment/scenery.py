"""Static scenery: ground, crop rows, fence with its gate, shed and trees, as meshes with their reflectivity."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from pydantic import Field
from shapely import LineString, Point, Polygon
from shapely.geometry.base import BaseGeometry

from configs.site import Shed, Site
from configs.strict import Config
from geometry.arrays import Float64
from simulation.environment.meshes import Mesh, ellipsoid, grid, join, limb
from simulation.environment.shed import roof_mesh, shed_solids, solids_mesh
from simulation.environment.terrain import Terrain
from simulation.randomness import generator

SURFACE_KINDS = ("ground", "crop", "fence", "gate", "roof", "wall", "post", "mast", "store", "trees")
SHED_REFLECTIVITY = {"wall": 0.5, "post": 0.4, "mast": 0.4, "store": 0.35}


class SceneryConfig(Config):
    """Dimensions of the scenery."""

    margin_m: float = Field(ge=5.0, le=200.0, description="ground beyond the surveyed area")
    grid_m: tuple[float, float] = Field(description="ground mesh along and across the furrows")
    crop_height_m: float = Field(ge=0.0, le=1.0, description="tallest plant")
    crop_row_spacing_m: float = Field(gt=0.1, le=20.0)
    fence_offset_m: float = Field(ge=0.0, le=10.0, description="outside the boundary")
    fence_height_m: float = Field(gt=0.2, le=3.0)
    fence_post_spacing_m: float = Field(gt=0.5, le=20.0, description="from post to post")
    trees: int = Field(ge=0, le=100)


@dataclass(frozen=True)
class Piece:
    """A mesh in `map` of one material; `name` is one of SURFACE_KINDS.

    Plants of an environment are not solid: only images show their mesh, whose `name` is the kind of stand.
    """

    name: str
    mesh: Mesh
    reflectivity: float
    is_solid: bool = True


def by_kind(values: Mapping[str, float], otherwise: float = 0.0) -> Float64:
    """A value for each of SURFACE_KINDS and, last, for no surface."""
    return np.array([*(values.get(kind, otherwise) for kind in SURFACE_KINDS), otherwise])


def build_scenery(site: Site, terrain: Terrain, config: SceneryConfig, seed: int) -> list[Piece]:
    """All static pieces of a site."""
    pieces = [Piece("ground", ground_mesh(site, terrain, config), 0.25)]
    if config.crop_height_m > 0.0:
        pieces.append(Piece("crop", crop_mesh(site, terrain, config, seed), 0.3))
    if site.is_fenced:
        pieces.append(Piece("fence", fence_mesh(site, terrain, config), 0.4))
    if site.gates:
        posts = [_post(terrain, p, 0.12, config.fence_height_m + 0.3) for g in site.gates for p in g.posts_m]
        pieces.append(Piece("gate", join(posts), 0.4))
    if site.shed is not None:
        pieces += shed_pieces(site.shed, seed)
    trees = tree_meshes(site, terrain, config, seed)
    return pieces + ([Piece("trees", join(trees), 0.3)] if trees else [])


def surveyed_area(site: Site) -> BaseGeometry:
    """Union of field, lanes and yard."""
    lanes = [LineString(lane.center_m).buffer(0.5 * lane.width_m) for lane in site.lanes]
    return shapely.union_all([Polygon(site.boundary_m), Polygon(site.yard.outline_m), *lanes])


def _turn(xy_m: Float64, angle_rad: float) -> Float64:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(xy_m @ np.array([[c, s], [-s, c]]))


def ground_mesh(site: Site, terrain: Terrain, config: SceneryConfig) -> Mesh:
    """The ground with furrows; the grid is parallel to them, and fine across them in the field alone."""
    corners = _turn(shapely.get_coordinates(surveyed_area(site)), -terrain.axis_rad)
    low, high = corners.min(axis=0) - config.margin_m, corners.max(axis=0) + config.margin_m
    across = _turn(np.array(site.boundary_m), -terrain.axis_rad)[:, 1]
    along_m, across_m = (min(pair) for pair in zip(config.grid_m, terrain.features.cells_m, strict=True))
    u = np.arange(low[0], high[0] + along_m, along_m)
    fine = np.arange(across.min(), across.max() + across_m, across_m)
    v = np.concatenate(
        [np.arange(low[1], fine[0], along_m), fine, np.arange(fine[-1] + along_m, high[1] + along_m, along_m)]
    )
    xy = _turn(np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2), terrain.axis_rad)
    z = terrain.heights_m(xy)
    is_field = shapely.contains_xy(Polygon(site.boundary_m), xy)
    z[is_field] += terrain.furrows_m(xy[is_field])
    return grid(np.column_stack([xy, z]).reshape(len(u), len(v), 3))


def crop_mesh(site: Site, terrain: Terrain, config: SceneryConfig, seed: int) -> Mesh:
    """Crop rows along the furrows: thin upright strips of random height."""
    random = generator(seed, "crop")
    corners = _turn(np.array(site.boundary_m), -terrain.axis_rad)
    low, high = corners.min(axis=0), corners.max(axis=0)
    u, v = np.arange(low[0], high[0], 0.5), np.arange(low[1] + 0.5, high[1], config.crop_row_spacing_m)
    xy = _turn(np.stack(np.meshgrid(v, u, indexing="ij")[::-1], axis=-1).reshape(-1, 2), terrain.axis_rad)
    foot = terrain.heights_m(xy)
    height = config.crop_height_m * random.uniform(0.3, 1.0, len(xy))
    inside = shapely.contains_xy(Polygon(site.boundary_m).buffer(-0.5), xy).reshape(len(v), len(u))
    vertices = np.concatenate([np.column_stack([xy, foot]), np.column_stack([xy, foot + height])])
    row, column = np.nonzero(inside[:, :-1] & inside[:, 1:] & (random.random((len(v), len(u) - 1)) < 0.7))
    a = row * len(u) + column
    n = len(xy)
    triangles = np.concatenate([np.stack([a, a + 1, a + n], axis=1), np.stack([a + 1, a + 1 + n, a + n], axis=1)])
    return Mesh(vertices.astype(np.float32), triangles.astype(np.int32))


def _post(terrain: Terrain, xy: tuple[float, float], radius_m: float, height_m: float) -> Mesh:
    z = terrain.height_m(*xy)
    return limb((xy[0], xy[1], z + height_m), (xy[0], xy[1], z - 0.2), radius_m)


def fence_line(site: Site, offset_m: float) -> list[LineString]:
    """The fence line outside the boundary, open at lanes and between gate posts."""
    line: BaseGeometry = Polygon(site.boundary_m).buffer(offset_m, join_style="mitre").exterior
    openings = [LineString(lane.center_m).buffer(0.5 * lane.width_m + 0.3) for lane in site.lanes]
    openings += [LineString(gate.posts_m).buffer(offset_m + 0.5, cap_style="flat") for gate in site.gates]
    line = shapely.line_merge(line.difference(shapely.union_all(openings)))
    return [part for part in shapely.get_parts(line) if part.length > 0.5]


def fence_mesh(site: Site, terrain: Terrain, config: SceneryConfig) -> Mesh:
    """Posts with two boards between neighbours."""
    parts = []
    for line in fence_line(site, config.fence_offset_m):
        bays = max(1, round(line.length / config.fence_post_spacing_m))
        places = np.unique(np.concatenate([np.linspace(0.0, line.length, bays + 1), _corners_along(line)]))
        points = [(p.x, p.y) for p in (line.interpolate(float(s)) for s in places)]
        parts += [_post(terrain, p, 0.06, config.fence_height_m) for p in points]
        parts += [_board(terrain, a, b, h * config.fence_height_m)
                  for a, b in pairwise(points) for h in (0.45, 0.9)]  # fmt: skip
    return join(parts)


def _corners_along(line: LineString) -> Float64:
    return np.array([line.project(Point(c)) for c in line.coords])


def _board(terrain: Terrain, a: tuple[float, float], b: tuple[float, float], height_m: float) -> Mesh:
    """An upright strip, visible from both sides."""
    ends = [(x, y, terrain.height_m(x, y) + height_m) for x, y in (a, b)]
    low = np.array([[x, y, z - 0.07] for x, y, z in ends])
    high = np.array([[x, y, z + 0.07] for x, y, z in ends])
    return Mesh(np.concatenate([low, high]).astype(np.float32), np.array([[0, 1, 2], [1, 3, 2]], np.int32))


def shed_pieces(shed: Shed, seed: int) -> list[Piece]:
    """The shed, one piece of each kind."""
    solids = shed_solids(shed, seed)
    found = [(kind, solids_mesh(solids, kind), shine) for kind, shine in SHED_REFLECTIVITY.items()]
    return [Piece("roof", roof_mesh(shed), 0.5), *(Piece(kind, mesh, r) for kind, mesh, r in found if mesh is not None)]


def tree_meshes(site: Site, terrain: Terrain, config: SceneryConfig, seed: int) -> list[Mesh]:
    """Trees 5 to 15 m outside the drivable area."""
    random = generator(seed, "trees")
    near, far = surveyed_area(site).buffer(5.0), surveyed_area(site).buffer(15.0)
    ring = far.exterior if isinstance(far, Polygon) else far.convex_hull.exterior
    meshes: list[Mesh] = []
    for _ in range(config.trees):
        place = ring.interpolate(random.uniform(0.0, ring.length))
        size = random.uniform(3.0, 5.0)
        if not near.contains(place):
            meshes += tree(terrain, place.x, place.y, size)
    return meshes


def tree(terrain: Terrain, x: float, y: float, size_m: float) -> list[Mesh]:
    """Trunk and crown of this diameter."""
    z = terrain.height_m(x, y)
    crown = ellipsoid((x, y, z + 2.0 + 0.5 * size_m), (size_m, size_m, size_m))
    return [limb((x, y, z + 2.5), (x, y, z - 0.2), 0.2), crown]
