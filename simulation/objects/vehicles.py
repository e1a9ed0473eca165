"""Car, quad, and tractor with trailer.

Radar: a small car has 0 to 20 dBsm by aspect at 77 GHz (Yamada 2005); quad and tractor: assumed, by size.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from messages.perception import ObstacleClass
from simulation.environment.lofting import Part
from simulation.objects.car import car
from simulation.objects.encountered import CAR_SCATTERERS
from simulation.objects.shapes import block, rod
from simulation.objects.solid import Scatterer, Solid

CAR_M, QUAD_M, TRACTOR_M = 1.65, 1.20, 2.80  # heights of the bodies below


def vehicle(kind: str, posture: str, height_m: float) -> Solid:
    """A parked or moving vehicle of this height."""
    parts, usual_m, scatterers = {
        "car": (_car_parts, CAR_M, CAR_SCATTERERS),
        "quad": (_quad_parts, QUAD_M, _box_scatterers(0.95, 0.5, 0.5, -5.0, 8.0)),
        "tractor_with_trailer": (_tractor_parts, TRACTOR_M, _box_scatterers(4.9, 1.2, 1.2, 5.0, 18.0)),
    }[kind]
    scale = height_m / usual_m
    placed = tuple(
        Scatterer((scale * s.at_m[0], scale * s.at_m[1], scale * s.at_m[2]), s.normal, s.rcs_dbsm, s.mirror_db)
        for s in scatterers
    )
    return Solid(kind, ObstacleClass.VEHICLE, partial(_scaled, parts, scale), 0.5, placed, 1.2)


def _box_scatterers(half_x: float, half_y: float, z: float, rcs: float, mirror: float) -> tuple[Scatterer, ...]:
    """Four corners, and the sides at normal incidence."""
    corners = [Scatterer((0.95 * half_x * x, 0.95 * half_y * y, z), (0.7 * x, 0.7 * y), rcs)
               for x in (1, -1) for y in (1, -1)]  # fmt: skip
    ends = [Scatterer((half_x * x, 0.0, z), (1.0 * x, 0.0), rcs, mirror) for x in (1, -1)]
    sides = [Scatterer((share * half_x, half_y * y, z), (0.0, 1.0 * y), rcs, mirror)
             for y in (1, -1) for share in (-0.6, 0.0, 0.6)]  # fmt: skip
    return (*corners, *ends, *sides)


def _scaled(parts: Callable[[bool], tuple[Part, ...]], scale: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    T = np.diag([scale, scale, scale, 1.0])
    return tuple(Part(part.mesh.transformed(T), part.region) for part in parts(is_fine))


def _car_parts(is_fine: bool) -> tuple[Part, ...]:
    return car(is_fine)


def _wheel(x: float, y: float, half_m: float, radius_m: float) -> Part:
    return Part(rod((x, y - half_m, radius_m), (x, y + half_m, radius_m), radius_m, 10, 2), "rubber")


def _quad_parts(is_fine: bool) -> tuple[Part, ...]:
    """A quad of 1.9 by 1.0 m, the handlebar at 1.2 m."""
    wheels = [_wheel(x, y, 0.12, 0.3) for x in (0.65, -0.65) for y in (0.38, -0.38)]
    boxes = [((-0.9, -0.5, 0.55), (-0.3, 0.5, 0.75)), ((0.3, -0.5, 0.55), (0.95, 0.5, 0.78)),
             ((-0.6, -0.18, 0.3), (0.6, 0.18, 0.88)), ((0.3, -0.4, 1.12), (0.36, 0.4, 1.2)),
             ((0.3, -0.04, 0.75), (0.36, 0.04, 1.14))]  # fmt: skip
    return (*wheels, *(Part(block(low, high, 0.5), "paint") for low, high in boxes))


def _tractor_parts(is_fine: bool) -> tuple[Part, ...]:
    """A tractor of 4.3 m and a trailer of 5 m behind it, 9.8 m together, the middle at the origin."""
    wheels = [(2.2, 0.85, 0.22, 0.75), (4.3, 0.8, 0.17, 0.5), (-3.6, 0.9, 0.17, 0.45), (-2.4, 0.9, 0.17, 0.45)]
    parts = [_wheel(x, s * y, half, r) for x, y, half, r in wheels for s in (1.0, -1.0)]
    boxes = [((3.0, -0.4, 0.7), (4.9, 0.4, 1.55)), ((1.6, -0.8, 1.0), (3.0, 0.8, 2.8)),
             ((-4.9, -1.2, 0.9), (0.2, 1.2, 2.3)), ((0.2, -0.08, 0.5), (1.6, 0.08, 0.62))]  # fmt: skip
    return (*parts, *(Part(block(low, high, 1.5), "paint") for low, high in boxes))
