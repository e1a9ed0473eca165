"""Columns of class scores and class evidence, in the order of `ObstacleClass`."""

from messages.perception import ObstacleClass

CLASSES = tuple(ObstacleClass)
UNKNOWN, PERSON, ANIMAL, VEHICLE, POLE, AIRBORNE = (
    CLASSES.index(label)
    for label in (
        ObstacleClass.UNKNOWN, ObstacleClass.PERSON, ObstacleClass.ANIMAL, ObstacleClass.VEHICLE, ObstacleClass.POLE,
        ObstacleClass.AIRBORNE,
    )
)  # fmt: skip
