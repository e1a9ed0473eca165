"""Meshes of people, animals and vehicles about their own origin: on the ground, facing x, limbs by gait phase.

Lidar, radar and ultrasonic sensors use the same body as cameras, with fewer triangles.
"""

from functools import cache

from messages.perception import ObstacleClass
from simulation.actors.car import car
from simulation.actors.deer import deer
from simulation.actors.person import STEPS, person
from simulation.environment.lofting import Part
from simulation.environment.meshes import Mesh, join

STRIDE_M = {ObstacleClass.PERSON: 1.3, ObstacleClass.ANIMAL: 1.6}  # length of one gait cycle
GAIT_STEPS = STEPS
REFLECTIVITY = {ObstacleClass.PERSON: 0.35, ObstacleClass.ANIMAL: 0.30, ObstacleClass.VEHICLE: 0.5}


def actor_mesh(label: ObstacleClass, gait: float) -> Mesh:
    """Mesh at a gait phase (0 to 1, quantised to `GAIT_STEPS`); a negative phase means standing."""
    return _joined(label, gait_step(gait))


def gait_step(gait: float) -> int:
    """Gait step of a gait phase; -1 for standing."""
    return -1 if gait < 0.0 else int(gait % 1.0 * GAIT_STEPS)


def actor_parts(label: ObstacleClass, step: int, is_fine: bool) -> tuple[Part, ...]:
    """Parts at a gait step, each with its region."""
    if label is ObstacleClass.PERSON:
        return person(step, is_fine)
    return deer(step, is_fine) if label is ObstacleClass.ANIMAL else car(is_fine)


@cache
def _joined(label: ObstacleClass, step: int) -> Mesh:
    return join([part.mesh for part in actor_parts(label, step, False)])
