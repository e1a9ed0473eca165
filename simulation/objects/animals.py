"""Dog, calf, sheep, roe deer, fawn, and a gull in flight.

Dimensions: breed standards (dog, 0.60 m at the withers; sheep 0.75 m; calf of four weeks 0.80 m). No source is known
for their radar cross-section at 77 GHz: assumed to shrink with the square of the height from −8 dBsm of a deer; a lying
fawn −20 dBsm, a gull −25 dBsm. Echo of fur for ultrasonic sensors: assumed, as for clothes.
"""

import math
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from messages.perception import ObstacleClass
from simulation.environment.lofting import Keys, Part, loft
from simulation.environment.meshes import Mesh
from simulation.objects.deer import deer
from simulation.objects.encountered import ANIMAL, ANIMAL_SCATTERERS
from simulation.objects.solid import GAIT_STEPS, Scatterer, Solid

DEER_M = 1.28  # height of the encountered deer, ears included
REFERENCE_M = 1.3  # height of −8 dBsm


@dataclass(frozen=True)
class Build:
    """Proportions of a standing quadruped: back, length of the trunk, its half width, legs, and head above the back."""

    back_m: float
    length_m: float
    half_width_m: float
    leg_m: float
    head_m: float
    reach_m: float


# all for the height of the first number of `BUILDS`, ears included
BUILDS: dict[str, tuple[float, Build]] = {
    "dog": (0.80, Build(0.60, 0.65, 0.11, 0.34, 0.20, 0.28)),
    "calf": (1.00, Build(0.82, 0.85, 0.17, 0.46, 0.18, 0.42)),
    "sheep": (0.90, Build(0.76, 0.90, 0.24, 0.34, 0.14, 0.30)),
}


def quadruped(kind: str, posture: str, height_m: float) -> Solid:
    """A standing or walking dog, calf or sheep."""
    usual_m, build = BUILDS[kind]
    scale = height_m / usual_m
    rcs = -8.0 + 20.0 * math.log10(height_m / REFERENCE_M)
    x, z = 0.3 * build.length_m * scale, 0.5 * (build.back_m + build.leg_m) * scale
    scatterers = tuple(Scatterer((s * x, 0.0, z), rcs_dbsm=rcs) for s in (1.0, -1.0))
    parts = partial(_quadruped_parts, build, scale)
    return Solid(
        kind, ObstacleClass.ANIMAL, parts, 0.3, scatterers, 0.3 * min(1.0, height_m), 1.2 * build.length_m * scale
    )


def roe_deer(kind: str, posture: str, height_m: float) -> Solid:
    """The deer of encounters, scaled."""
    scale = height_m / DEER_M
    size_db = 20.0 * math.log10(scale)
    scatterers = tuple(replace(s, at_m=(scale * s.at_m[0], 0.0, scale * s.at_m[2]), rcs_dbsm=s.rcs_dbsm + size_db)
                       for s in ANIMAL_SCATTERERS)  # fmt: skip
    return Solid(kind, ObstacleClass.ANIMAL, partial(_deer_parts, scale), ANIMAL.reflectivity, scatterers,
                 ANIMAL.ultrasonic_strength, 1.6 * scale)  # fmt: skip


def fawn(kind: str, posture: str, height_m: float) -> Solid:
    """A fawn that lies with its legs below it and its head raised; it stays when something approaches."""
    parts = partial(_fawn_parts, height_m / 0.30)
    scatterers = (Scatterer((0.0, 0.0, 0.4 * height_m), rcs_dbsm=-20.0),)
    return Solid(kind, ObstacleClass.ANIMAL, parts, 0.3, scatterers, 0.15)


def gull(kind: str, posture: str, height_m: float) -> Solid:
    """A gull with spread wings, `height_m` above the ground; wing span 1.3 m (Larus argentatus)."""
    scatterers = (Scatterer((0.0, 0.0, height_m), rcs_dbsm=-25.0),)
    return Solid(kind, ObstacleClass.ANIMAL, partial(_gull_parts, height_m), 0.5, scatterers, 0.1, 1.0, False, False)


@cache
def _quadruped_parts(b: Build, scale: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    """Trunk, neck, head and four legs, diagonal legs together."""
    half, deep = 0.5 * b.length_m, 0.5 * (b.back_m - 0.8 * b.leg_m)
    z = b.back_m - deep
    trunk: Keys = ((-half, 0.0, z, 0.02, 0.02), (-0.9 * half, 0.0, z, 0.8 * deep, 0.8 * b.half_width_m),
                   (0.0, 0.0, z, deep, b.half_width_m), (0.85 * half, 0.0, z, 0.85 * deep, 0.8 * b.half_width_m),
                   (half, 0.0, z, 0.02, 0.02))  # fmt: skip
    top, thick = b.back_m + b.head_m, 0.45 * deep
    neck: Keys = ((0.6 * half, 0.0, z + 0.3 * deep, 1.4 * thick, 0.6 * b.half_width_m),
                  (half + 0.4 * b.reach_m, 0.0, top - thick, thick, 0.4 * b.half_width_m))  # fmt: skip
    nose = half + 0.4 * b.reach_m
    head: Keys = ((nose - thick, 0.0, top - thick, 0.3 * thick, 0.3 * thick), (nose, 0.0, top - thick, thick, thick),
                  (nose + 0.6 * b.reach_m, 0.0, top - 1.6 * thick, 0.5 * thick, 0.5 * thick))  # fmt: skip
    parts = [Part(loft(trunk, 8, 5, axis=(1.0, 0.0, 0.0)), "coat"), Part(loft(neck, 6, 2), "coat"),
             Part(loft(head, 6, 3, axis=(1.0, 0.0, 0.0)), "coat")]  # fmt: skip
    for x in (0.7 * half, -0.75 * half):
        for side in (1.0, -1.0):
            phase = side if x > 0.0 else -side
            swing = 0.4 * phase * math.sin(2.0 * math.pi * step / GAIT_STEPS) if step >= 0 else 0.0
            parts.append(Part(_leg(b, x, 0.6 * side * b.half_width_m, z, swing), "coat"))
    return _on_ground(parts, scale)


def _leg(b: Build, x: float, y: float, top: float, swing: float) -> Mesh:
    radius = 0.03 + 0.1 * b.half_width_m
    foot = (x + top * math.sin(swing), y, top - top * math.cos(swing))
    middle = (0.5 * (x + foot[0]), y, 0.5 * (top + foot[2]))
    return loft(((x, y, top, 1.8 * radius, 1.4 * radius), (*middle, radius, radius), (*foot, radius, radius)), 6, 3)


@cache
def _deer_parts(scale: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    return _on_ground(list(deer(step, is_fine)), scale)


@cache
def _fawn_parts(scale: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    """Trunk of 0.5 m on the ground, neck and head."""
    trunk: Keys = ((-0.25, 0.0, 0.08, 0.02, 0.02), (-0.20, 0.0, 0.08, 0.075, 0.09), (0.0, 0.0, 0.09, 0.085, 0.105),
                   (0.18, 0.0, 0.085, 0.075, 0.085), (0.25, 0.0, 0.08, 0.02, 0.02))  # fmt: skip
    neck: Keys = ((0.16, 0.0, 0.10, 0.05, 0.045), (0.22, 0.0, 0.17, 0.035, 0.03), (0.25, 0.0, 0.23, 0.03, 0.03))
    head: Keys = ((0.21, 0.0, 0.24, 0.01, 0.01), (0.25, 0.0, 0.245, 0.045, 0.035), (0.36, 0.0, 0.21, 0.015, 0.015))
    ears: Keys = ((0.24, 0.0, 0.26, 0.01, 0.04), (0.22, 0.0, 0.30, 0.005, 0.05))
    parts = [Part(loft(trunk, 8, 7, axis=(1.0, 0.0, 0.0)), "coat"), Part(loft(neck, 6, 3), "coat"),
             Part(loft(head, 6, 4, axis=(1.0, 0.0, 0.0)), "coat"), Part(loft(ears, 6, 2), "coat")]  # fmt: skip
    return _on_ground(parts, scale)


@cache
def _gull_parts(height_m: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    """Body and wings that beat with the gait."""
    lift = 0.2 * math.sin(2.0 * math.pi * max(step, 0) / GAIT_STEPS)
    body: Keys = ((-0.28, 0.0, height_m, 0.01, 0.03), (-0.10, 0.0, height_m, 0.06, 0.06),
                  (0.12, 0.0, height_m, 0.06, 0.06), (0.28, 0.0, height_m, 0.01, 0.01))  # fmt: skip
    parts = [Part(loft(body, 8, 6, axis=(1.0, 0.0, 0.0)), "white")]
    for side in (1.0, -1.0):
        wing: Keys = ((0.02, 0.03 * side, height_m, 0.10, 0.02),
                      (0.04, 0.32 * side, height_m + 0.5 * lift, 0.09, 0.015),
                      (-0.05, 0.65 * side, height_m + lift, 0.02, 0.01))  # fmt: skip
        parts.append(Part(loft(wing, 6, 5, aside=(0.0, 0.0, 1.0)), "white"))
    return tuple(parts)


def _on_ground(parts: list[Part], scale: float) -> tuple[Part, ...]:
    """Scaled parts, the lowest point at height 0."""
    low = min(float(part.mesh.vertices_m[:, 2].min()) for part in parts)
    T = np.diag([scale, scale, scale, 1.0])
    T[2, 3] = -scale * low
    return tuple(Part(part.mesh.transformed(T), part.region) for part in parts)
