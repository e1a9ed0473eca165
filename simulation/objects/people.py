"""Adults, children and cyclists.

Radar cross-section of a standing adult: Yamada (2005), −8 to 0 dBsm at 77 GHz. Of children and of other postures no
source is known: assumed to shrink with the square of the height, by 3 dB when crouching or sitting and by 10 dB when
lying, where grazing incidence and ground reflection leave little. Echo of clothes for ultrasonic sensors: assumed.
"""

import math
from dataclasses import replace
from functools import cache, partial

import numpy as np

from messages.perception import ObstacleClass
from simulation.environment.lofting import Part
from simulation.environment.meshes import limb
from simulation.objects.car import disc
from simulation.objects.encountered import PERSON, PERSON_SCATTERERS
from simulation.objects.person import person
from simulation.objects.postures import (
    HEAD_BASE_M,
    POSTURES,
    STAND_TO_LIE_STEPS,
    Posture,
    blend,
    posed,
    running,
    walking,
)
from simulation.objects.solid import Scatterer, Solid

BODY_M = 1.757  # height of the standing body
HEAD = {"adult": 1.0, "child": 1.25, "cyclist": 1.0}  # head height 0.19 m at 1.1 m: Snyder (1977)
LOW_DB = {"crouching": -3.0, "sitting": -3.0, "lying_along": -10.0, "lying_across": -10.0, "lying_curled": -10.0}
PERSON_POSTURES = ("standing", "walking", "running", *LOW_DB)
STRIDE_M, RUNNING_STRIDE_M = 1.3, 2.4  # of an adult of 1.75 m
PEDALLING = Posture(lean=30.0, hip=(95.0, 50.0), knee=(85.0, 45.0), foot=(20.0, 20.0), swing=(70.0, 70.0),
                    bend=(10.0, 10.0))  # fmt: skip
SADDLE_M, WHEEL_M, WHEELBASE_M = 0.92, 0.34, 1.05


def person_solid(kind: str, posture: str, height_m: float) -> Solid:
    """An adult or child of this standing height."""
    scale, head = _scale(kind, height_m)
    if posture in ("standing", "walking"):
        parts, stride = partial(_walking, scale, head), STRIDE_M * scale
    elif posture == "running":
        parts, stride = partial(_running, scale, head), RUNNING_STRIDE_M * scale
    else:
        parts, stride = partial(_resting, POSTURES[posture], scale, head), None
    low_m = None if posture not in LOW_DB else _height_m(POSTURES[posture], scale, head)
    return Solid(kind, ObstacleClass.PERSON, parts, PERSON.reflectivity, _scatterers(posture, scale, low_m),
                 PERSON.ultrasonic_strength * min(1.0, scale), stride)  # fmt: skip


@cache
def between(kind: str, height_m: float, postures: tuple[str, str], step: int) -> Solid:
    """The person at a step (0 to STAND_TO_LIE_STEPS) of the change from one posture to another."""
    scale, head = _scale(kind, height_m)
    share = step / STAND_TO_LIE_STEPS
    first, last = (POSTURES["standing" if name in ("walking", "running") else name] for name in postures)
    signature = person_solid(kind, postures[share >= 0.5], height_m)
    return replace(
        signature, parts=partial(_resting, blend(first, last, share), scale, head), stride_m=None, _meshes={}
    )


def cyclist(kind: str, posture: str, height_m: float) -> Solid:
    """A person on a bicycle; steel frame and wheels raise the cross-section of the person (assumed)."""
    scale, _ = _scale("adult", height_m)
    extra = (Scatterer((0.0, 0.0, 0.6), (0.0, 1.0), -8.0, 8.0), Scatterer((0.0, 0.0, 0.6), (0.0, -1.0), -8.0, 8.0))
    return Solid(kind, ObstacleClass.PERSON, partial(_riding, scale), PERSON.reflectivity,
                 (Scatterer((0.0, 0.0, 1.2), rcs_dbsm=-5.0), *extra), PERSON.ultrasonic_strength)  # fmt: skip


def _scale(kind: str, height_m: float) -> tuple[float, float]:
    head = HEAD[kind]
    return height_m / (HEAD_BASE_M + head * (BODY_M - HEAD_BASE_M)), head


def _walking(scale: float, head: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    if head == 1.0:
        T = np.diag([scale, scale, scale, 1.0])
        return tuple(Part(part.mesh.transformed(T), part.region) for part in person(step, is_fine))
    return posed(walking(step), scale, head, is_fine)


def _running(scale: float, head: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    return posed(running(step) if step >= 0 else POSTURES["standing"], scale, head, is_fine)


def _resting(posture: Posture, scale: float, head: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    return posed(posture, scale, head, is_fine)


def _height_m(posture: Posture, scale: float, head: float) -> float:
    return max(float(part.mesh.vertices_m[:, 2].max()) for part in posed(posture, scale, head, False))


def _scatterers(posture: str, scale: float, low_m: float | None) -> tuple[Scatterer, ...]:
    """Those of the encountered person, scaled; of a low posture two at half its height."""
    size_db = 20.0 * math.log10(scale)
    if low_m is None:
        return tuple(
            replace(s, at_m=tuple(scale * v for v in s.at_m), rcs_dbsm=s.rcs_dbsm + size_db)  # type: ignore[arg-type]
            for s in PERSON_SCATTERERS
        )
    rcs = -5.0 + LOW_DB[posture] + size_db
    reach = {"lying_along": (0.4, 0.0), "lying_across": (0.0, 0.4), "lying_curled": (0.3, 0.0)}
    x, y = reach.get(posture, (0.0, 0.0))
    places = ((-x, -y, 0.0), (x, y, -5.0))
    return tuple(Scatterer((scale * a, scale * b, 0.5 * low_m), rcs_dbsm=rcs + less) for a, b, less in places)


@cache
def _riding(scale: float, step: int, is_fine: bool) -> tuple[Part, ...]:
    """The hips on the saddle, over wheels, frame and handlebar along x."""
    rider = posed(PEDALLING, scale, 1.0, is_fine)
    T = np.eye(4)
    T[0, 3], T[2, 3] = -0.15, 0.22
    front, rear = 0.5 * WHEELBASE_M, -0.5 * WHEELBASE_M
    crank, saddle, bar = (-0.05, 0.0, 0.28), (-0.15, 0.0, SADDLE_M), (0.38, 0.0, 1.0)
    tubes = [(saddle, crank), (saddle, (rear, 0.0, WHEEL_M)), (crank, (rear, 0.0, WHEEL_M)), (bar, crank),
             (bar, (front, 0.0, WHEEL_M)), ((0.4, 0.28, 1.02), (0.4, -0.28, 1.02))]  # fmt: skip
    wheels = [Part(disc((x, 0.0, WHEEL_M), 0.02, WHEEL_M, 16), "rubber") for x in (front, rear)]
    frame = [Part(limb(a, b, 0.018), "paint") for a, b in tubes]
    return (*(Part(part.mesh.transformed(T), part.region) for part in rider), *wheels, *frame)
