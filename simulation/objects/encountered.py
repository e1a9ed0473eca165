"""The person, animal and vehicle of encounters."""

from messages.perception import ObstacleClass
from simulation.environment.lofting import Part
from simulation.objects.car import car
from simulation.objects.deer import deer
from simulation.objects.person import person
from simulation.objects.solid import Scatterer, Solid


def _car_parts(step: int, is_fine: bool) -> tuple[Part, ...]:
    return car(is_fine)


# a person has -8 to 0 dBsm at 77 GHz (Yamada 2005), a small car 0 to 20 by aspect
PERSON_SCATTERERS = (
    Scatterer((0.0, 0.0, 1.15), rcs_dbsm=-5.0),
    Scatterer((0.0, 0.1, 0.5), rcs_dbsm=-10.0, swing=0.8),
    Scatterer((0.0, -0.1, 0.5), rcs_dbsm=-10.0, swing=0.8, phase=0.5),
)
ANIMAL_SCATTERERS = (
    Scatterer((0.3, 0.0, 0.65), rcs_dbsm=-8.0),
    Scatterer((-0.3, 0.0, 0.65), rcs_dbsm=-8.0),
    Scatterer((0.38, 0.0, 0.3), rcs_dbsm=-14.0, swing=0.8),
    Scatterer((-0.38, 0.0, 0.3), rcs_dbsm=-14.0, swing=0.8, phase=0.5),
)
CAR_SCATTERERS = (
    *(Scatterer((1.75 * x, 0.75 * y, 0.6), (0.7 * x, 0.7 * y), 0.0) for x in (1, -1) for y in (1, -1)),
    *(Scatterer((1.2 * x, 0.8 * y, 0.35), (0.0, 1.0 * y), 2.0) for x in (1, -1) for y in (1, -1)),
    *(Scatterer((0.0, 0.81 * y, 0.7), (0.0, 1.0 * y), -2.0, 18.0) for y in (1, -1)),
    *(Scatterer((1.9 * x, 0.0, 0.7), (1.0 * x, 0.0), 0.0, 15.0) for x in (1, -1)),
)
# the stride is the length of one gait cycle
PERSON = Solid("person", ObstacleClass.PERSON, person, 0.35, PERSON_SCATTERERS, 0.5, stride_m=1.3)
ANIMAL = Solid("animal", ObstacleClass.ANIMAL, deer, 0.30, ANIMAL_SCATTERERS, 0.3, stride_m=1.6)
VEHICLE = Solid("car", ObstacleClass.VEHICLE, _car_parts, 0.5, CAR_SCATTERERS, 1.2)
ENCOUNTERED = {solid.label: solid for solid in (PERSON, ANIMAL, VEHICLE)}
