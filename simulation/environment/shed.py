"""The shed as solids on the level floor at height 0: walls, posts, masts of outside anchors, and stored goods.

Bays stay free; the remaining floor holds pallets, crates and shelves, drawn from the seed.
"""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import LineString, Point, Polygon
from shapely.affinity import rotate, translate
from shapely.geometry.base import BaseGeometry

from configs.site import Bay, Shed
from geometry.arrays import Float64
from geometry.polygon import parts
from simulation.environment.meshes import Mesh, join
from simulation.randomness import generator

MAST_M = 0.06
BESIDE_BAY_M = 0.3  # clearance beside a bay
MIN_STORAGE_HALF_WIDTH_M = 0.6  # smallest half width of a storage floor
GOODS_M = ((1.2, 0.8, 0.2, 1.6), (0.8, 0.6, 0.5, 1.1), (2.4, 0.5, 1.8, 2.2))  # length, width, lowest and highest top
FLOOR_PER_PIECE_M2 = 3.0
TRIES = 20
ROOF_M = 0.1


@dataclass(frozen=True)
class Solid:
    """An upright prism: outline in `map` and height of its top; `kind` is wall, post, mast or store."""

    kind: str
    ground: Polygon
    top_m: float

    @property
    def mesh(self) -> Mesh:
        """Its surface."""
        return prism(self.ground, 0.0, self.top_m)


def shed_solids(shed: Shed, seed: int) -> list[Solid]:
    """All solids in and around the shed."""
    walls = [w for line in shed.walls_m for w in parts(_wall(shed, line))]
    posts = [Point(p.at_m).buffer(p.radius_m, quad_segs=3) for p in shed.posts]
    outside = [a for a in shed.anchors.values() if not Polygon(shed.outline_m).covers(Point(a[:2]))]
    return [
        *(Solid("wall", w, shed.height_m) for w in walls),
        *(Solid("post", p, shed.height_m) for p in posts),
        *(Solid("mast", Point(a[:2]).buffer(MAST_M, quad_segs=2), a[2] - 0.05) for a in outside),
        *(Solid("store", ground, top) for ground, top in place_stored_goods(shed, seed)),
    ]


def _wall(shed: Shed, line: tuple[tuple[float, float], ...]) -> BaseGeometry:
    return LineString(line).buffer(0.5 * shed.wall_thickness_m, cap_style="square", join_style="mitre")


def storage_floor(shed: Shed) -> list[Polygon]:
    """Parts of the floor outside every bay, wide enough for storage."""
    walls = [_wall(shed, line).buffer(0.05) for line in shed.walls_m]
    bays = [bay_ground(shed, bay).buffer(BESIDE_BAY_M) for bay in shed.bays]
    free = Polygon(shed.outline_m).difference(shapely.union_all([*walls, *bays]))
    return [p for p in parts(free) if not p.buffer(-MIN_STORAGE_HALF_WIDTH_M).is_empty]


def bay_ground(shed: Shed, bay: Bay) -> Polygon:
    """The bay's width along its heading, through the entire shed."""
    reach = Polygon(shed.outline_m).length
    angle, x, y = math.radians(bay.dock.heading_deg), bay.dock.x_m, bay.dock.y_m
    ahead = (reach * math.cos(angle), reach * math.sin(angle))
    line = LineString([(x - ahead[0], y - ahead[1]), (x + ahead[0], y + ahead[1])])
    return line.buffer(0.5 * bay.width_m, cap_style="flat")


def place_stored_goods(shed: Shed, seed: int) -> list[tuple[Polygon, float]]:
    """Outline and top of each stored item: parallel to the shed, without overlap."""
    random = generator(seed, "store")
    heading_deg = shed.bays[0].dock.heading_deg if shed.bays else 0.0
    placed: list[tuple[Polygon, float]] = []
    for floor in storage_floor(shed):
        for _ in range(round(floor.area / FLOOR_PER_PIECE_M2)):
            length, width, low, high = GOODS_M[int(random.integers(len(GOODS_M)))]
            top = float(random.uniform(low, high))
            taken = shapely.union_all([g for g, _ in placed])
            found = _place_one(floor.difference(taken.buffer(0.1)), floor.bounds, (length, width), heading_deg, random)
            placed += [(found, top)] if found is not None else []
    return placed


def _place_one(
    free: BaseGeometry, bounds: tuple[float, ...], size_m: tuple[float, float], heading_deg: float,
    random: np.random.Generator,
) -> Polygon | None:  # fmt: skip
    shape = shapely.box(-0.5 * size_m[0], -0.5 * size_m[1], 0.5 * size_m[0], 0.5 * size_m[1])
    for _ in range(TRIES):
        x, y = random.uniform(bounds[:2], bounds[2:])
        transformed = translate(rotate(shape, heading_deg + random.uniform(-5.0, 5.0)), x, y)
        if free.covers(transformed):
            return Polygon(transformed.exterior)
    return None


def solids_mesh(solids: list[Solid], kind: str) -> Mesh | None:
    """All solids of one kind as one mesh."""
    meshes = [s.mesh for s in solids if s.kind == kind]
    return join(meshes) if meshes else None


def roof_mesh(shed: Shed) -> Mesh:
    """A flat roof over the outline."""
    return prism(Polygon(shed.outline_m), shed.height_m, shed.height_m + ROOF_M)


def prism(ground: Polygon, low_m: float, high_m: float) -> Mesh:
    """An upright prism over an outline without holes, with floor and top."""
    ring = np.asarray(shapely.geometry.polygon.orient(ground).exterior.coords)[:-1, :2]
    n, k = len(ring), np.arange(len(ring))
    corners = np.concatenate([np.column_stack([ring, np.full(n, z)]) for z in (low_m, high_m)])
    after = (k + 1) % n
    sides = np.concatenate([np.stack([k, after, after + n], axis=1), np.stack([k, after + n, k + n], axis=1)])
    lid = _lid(ground, ring)
    return Mesh(corners.astype(np.float32), np.concatenate([sides, lid[:, ::-1], lid + n]).astype(np.int32))


def _lid(ground: Polygon, ring: Float64) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Triangles (M, 3) of a ring's interior, counter-clockwise."""
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(ground))
    points = np.array([np.asarray(shapely.geometry.polygon.orient(t).exterior.coords)[:3, :2] for t in triangles])
    distance = np.abs(points[:, :, None, :] - ring[None, None]).sum(axis=-1)
    return np.asarray(distance.argmin(axis=-1))
