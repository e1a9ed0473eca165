"""Test body, posts, wire, wall, branch, gate, door, drawbar, bale, stone and puddle.

Radar cross-sections are assumed, at the low end of a metal, wooden or mineral body of this size, except for the
specular reflection of flat or straight metal at normal incidence. The test body has the size of ISO 18497:2018; its
reflectivity (a dull dark surface) and cross-section (as a child) are assumed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from messages.perception import ObstacleClass
from simulation.environment.lofting import Part, loft
from simulation.environment.meshes import Mesh, ellipsoid
from simulation.objects.shapes import block, rod
from simulation.objects.solid import Scatterer, Solid

Build = Callable[[float, str], list[Mesh]]  # height, posture -> meshes
TEST_BODY_RADIUS_M = 0.19
POST_DIAMETER_M = {"thin": 0.05, "usual": 0.08, "thick": 0.10}
WIRE_M, WIRE_HALF_M = 0.0025, 2.0  # diameter of high-tensile fence wire; half its length
GATE_M, DOOR_M = 4.0, 2.5


@dataclass(frozen=True)
class Thing:
    """A body that does not move: shape, class, appearance and signatures."""

    build: Build
    region: str
    reflectivity: float
    rcs_dbsm: float
    ultrasonic_strength: float
    label: ObstacleClass = ObstacleClass.UNKNOWN
    mirror_db: float = 0.0  # gain at normal incidence, of both faces across x
    must_avoid: bool = True
    is_radar_opaque: bool = False


def thing(kind: str, posture: str, height_m: float) -> Solid:
    """One of `THINGS` at this height."""
    one = THINGS[kind]
    meshes = one.build(height_m, posture)
    corners = np.concatenate([mesh.vertices_m for mesh in meshes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    scatterers = _scatterers(one, low.astype(float).tolist(), high.astype(float).tolist())
    return Solid(kind, one.label, partial(_parts, tuple(meshes), one.region), one.reflectivity, scatterers,
                 one.ultrasonic_strength, None, one.must_avoid, one.is_radar_opaque)  # fmt: skip


def _parts(meshes: tuple[Mesh, ...], region: str, step: int, is_fine: bool) -> tuple[Part, ...]:
    return tuple(Part(mesh, region) for mesh in meshes)


def _scatterers(one: Thing, low: list[float], high: list[float]) -> tuple[Scatterer, ...]:
    """One per metre of width; with `mirror_db` also the faces across x."""
    x, z, width = 0.5 * (low[0] + high[0]), 0.5 * (low[2] + high[2]), high[1] - low[1]
    count = max(1, round(width))
    share_db = 10.0 * math.log10(count)
    found = []
    for k in range(count):
        y = low[1] + (k + 0.5) * width / count
        found.append(Scatterer((x, y, z), rcs_dbsm=one.rcs_dbsm - share_db))
        if one.mirror_db:
            found += [Scatterer((x, y, z), (s, 0.0), one.rcs_dbsm - share_db, one.mirror_db) for s in (1.0, -1.0)]
    return tuple(found)


def _cylinder(radius_m: float, height_m: float, posture: str) -> list[Mesh]:
    return [rod((0.0, 0.0, 0.0), (0.0, 0.0, height_m), radius_m, 24 if radius_m > 0.1 else 10, 5)]


def _post(height_m: float, posture: str) -> list[Mesh]:
    return _cylinder(0.5 * POST_DIAMETER_M[posture], height_m, posture)


def _wire(height_m: float, posture: str) -> list[Mesh]:
    """Taut between two points 4 m apart along y."""
    return [rod((0.0, -WIRE_HALF_M, height_m), (0.0, WIRE_HALF_M, height_m), 0.5 * WIRE_M, 6, 17)]


def _wall(height_m: float, posture: str) -> list[Mesh]:
    return [block((-0.1, -1.5, 0.0), (0.1, 1.5, height_m))]


def _branch(height_m: float, posture: str) -> list[Mesh]:
    """Along y, 2.4 m long, from 8 to 2 cm; `height_m` is its axis."""
    return [rod((0.0, -1.2, height_m), (0.0, 1.2, height_m), 0.04, 8, 9, end_radius_m=0.01)]


def _gate(height_m: float, posture: str) -> list[Mesh]:
    """Tubes between two uprights, hinged at the right end; half open: turned by 45° to the rear."""
    half = 0.5 * GATE_M
    bars = [rod((0.0, -half, z), (0.0, half, z), 0.02, 6, 9) for z in np.linspace(0.25, height_m - 0.02, 3).tolist()]
    uprights = [rod((0.0, y, 0.1), (0.0, y, height_m), 0.025, 6, 3) for y in (-half, half)]
    if posture == "closed":
        return [*bars, *uprights]
    c = math.sqrt(0.5)
    T = np.array([[c, -c, 0.0, -c * half], [c, c, 0.0, -half + c * half], [0.0, 0.0, 1.0, 0.0], [0, 0, 0, 1.0]])
    return [mesh.transformed(T) for mesh in (*bars, *uprights)]


def _shed_door(height_m: float, posture: str) -> list[Mesh]:
    """A sliding panel along y."""
    return [block((-0.025, -0.5 * DOOR_M, 0.05), (0.025, 0.5 * DOOR_M, height_m), 0.4)]


def _drawbar(height_m: float, posture: str) -> list[Mesh]:
    """A parked implement's drawbar along x, `height_m` high at its eye, on a foot."""
    return [block((-1.0, -0.06, height_m - 0.12), (1.0, 0.06, height_m)),
            rod((0.7, 0.0, 0.0), (0.7, 0.0, height_m - 0.06), 0.03, 6, 3)]  # fmt: skip


def _bale(height_m: float, posture: str) -> list[Mesh]:
    """A cylinder of 1.2 m along y; `height_m` is its diameter."""
    r = 0.5 * height_m
    return [rod((0.0, -0.6, r), (0.0, 0.6, r), r, 24, 5)]


def _stone(height_m: float, posture: str) -> list[Mesh]:
    return [ellipsoid((0.0, 0.0, 0.5 * height_m), (1.3 * height_m, 1.1 * height_m, height_m), 12)]


def _puddle(height_m: float, posture: str) -> list[Mesh]:
    return [loft(((0.0, 0.0, 0.0, 1.0, 0.8), (0.0, 0.0, height_m, 1.0, 0.8)), 24, 2)]


POLE = ObstacleClass.POLE
THINGS = {
    "test_body": Thing(partial(_cylinder, TEST_BODY_RADIUS_M), "dark", 0.1, -12.0, 0.5),
    "post": Thing(_post, "wood", 0.35, -15.0, 0.3, POLE),
    "wire": Thing(_wire, "steel", 0.4, -30.0, 0.02, mirror_db=15.0),
    "low_wall": Thing(_wall, "stone", 0.35, -10.0, 1.0, mirror_db=10.0),
    "branch": Thing(_branch, "wood", 0.3, -20.0, 0.1),
    "gate": Thing(_gate, "steel", 0.4, -5.0, 0.4, mirror_db=10.0),
    "shed_door": Thing(_shed_door, "steel", 0.5, 0.0, 1.5, mirror_db=20.0, is_radar_opaque=True),
    "drawbar": Thing(_drawbar, "steel", 0.4, -10.0, 0.4),
    "round_bale": Thing(_bale, "straw", 0.4, -8.0, 0.4, is_radar_opaque=True),
    "stone": Thing(_stone, "stone", 0.3, -18.0, 0.5),
    "puddle": Thing(_puddle, "water", 0.02, -60.0, 0.0, must_avoid=False),
}
