"""People, animals and vehicles as meshes about their own origin: on the ground, facing x; limbs move with the gait."""

import math
from functools import cache

from messages.perception import ObstacleClass
from simulation.meshes import Mesh, box, ellipsoid, join, limb

STRIDE_M = {ObstacleClass.PERSON: 1.3, ObstacleClass.ANIMAL: 1.6}  # way of one whole gait cycle
GAIT_STEPS = 16
REFLECTIVITY = {ObstacleClass.PERSON: 0.35, ObstacleClass.ANIMAL: 0.30, ObstacleClass.VEHICLE: 0.5}


def figure_mesh(label: ObstacleClass, gait: float) -> Mesh:
    """The mesh at a place in the gait cycle (0 to 1), in `GAIT_STEPS` steps; a negative gait means standing."""
    step = -1 if gait < 0.0 else int(gait % 1.0 * GAIT_STEPS)
    return _MAKERS[label](step)


@cache
def _person(step: int) -> Mesh:
    """An adult of 1.75 m."""
    swing = 0.36 * math.sin(2.0 * math.pi * step / GAIT_STEPS) if step >= 0 else 0.0
    parts = [ellipsoid((0.0, 0.0, 1.62), (0.19, 0.16, 0.25)), limb((0.0, 0.0, 1.52), (0.0, 0.0, 1.42), 0.06)]
    parts += [ellipsoid((0.0, 0.0, 1.17), (0.27, 0.42, 0.62)), box((-0.12, -0.16, 0.82), (0.12, 0.16, 1.0))]
    for side in (1.0, -1.0):
        parts += _leg(0.1 * side, side * swing) + _arm(0.24 * side, -side * swing)
    return join(parts)


def _leg(y: float, swing_rad: float) -> list[Mesh]:
    knee = (0.44 * math.sin(swing_rad), y, 0.88 - 0.44 * math.cos(swing_rad))
    shank = swing_rad - max(0.0, -swing_rad) * 0.8  # the knee bends behind only
    foot = (knee[0] + 0.4 * math.sin(shank), y, max(knee[2] - 0.4 * math.cos(shank), 0.04))
    sole = box((foot[0] - 0.07, y - 0.05, foot[2] - 0.04), (foot[0] + 0.19, y + 0.05, foot[2] + 0.05))
    return [limb((0.0, y, 0.88), knee, 0.085), limb(knee, foot, 0.06), sole]


def _arm(y: float, swing_rad: float) -> list[Mesh]:
    elbow = (0.3 * math.sin(swing_rad), y, 1.4 - 0.3 * math.cos(swing_rad))
    fore = swing_rad + 0.3
    hand = (elbow[0] + 0.32 * math.sin(fore), y, elbow[2] - 0.32 * math.cos(fore))
    return [limb((0.0, y, 1.4), elbow, 0.05), limb(elbow, hand, 0.04)]


@cache
def _animal(step: int) -> Mesh:
    """A roe deer, 0.75 m at the shoulder."""
    swing = 0.5 * math.sin(2.0 * math.pi * step / GAIT_STEPS) if step >= 0 else 0.0
    parts = [ellipsoid((0.0, 0.0, 0.66), (1.05, 0.3, 0.38)), limb((0.4, 0.0, 0.75), (0.62, 0.0, 1.08), 0.07)]
    parts += [ellipsoid((0.72, 0.0, 1.12), (0.3, 0.13, 0.15))]
    parts += [limb((0.62, 0.05 * s, 1.16), (0.56, 0.11 * s, 1.32), 0.025) for s in (1.0, -1.0)]
    for x, phase in ((0.38, 1.0), (-0.38, -1.0)):
        parts += [_hoof(x, 0.1 * s, phase * s * swing) for s in (1.0, -1.0)]
    return join(parts)


def _hoof(x: float, y: float, swing_rad: float) -> Mesh:
    return limb((x, y, 0.6), (x + 0.6 * math.sin(swing_rad), y, 0.6 - 0.6 * math.cos(swing_rad)), 0.035)


@cache
def _vehicle(step: int) -> Mesh:
    """A small pick-up of 3.8 by 1.66 m, about its middle."""
    del step
    parts = [box((-1.9, -0.81, 0.4), (1.9, 0.81, 0.95)), box((-0.5, -0.74, 0.95), (1.0, 0.74, 1.65))]
    parts += [box((1.0, -0.78, 0.95), (1.75, 0.78, 1.08))]
    for x in (1.2, -1.2):
        parts += [limb((x, s * 0.83, 0.34), (x, s * 0.62, 0.34), 0.34, 12) for s in (1.0, -1.0)]
    return join(parts)


_MAKERS = {ObstacleClass.PERSON: _person, ObstacleClass.ANIMAL: _animal, ObstacleClass.VEHICLE: _vehicle}
