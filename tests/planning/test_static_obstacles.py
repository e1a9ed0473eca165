"""Static obstacles near each other as one."""

import pytest
from shapely.geometry import box

from messages.perception import ObstacleClass
from planning.recovery.static_obstacles import StaticObstacle, merged

CAR = StaticObstacle(ObstacleClass.VEHICLE, box(0.0, 0.0, 4.3, 1.8))
BESIDE = box(2.0, 2.1, 2.5, 2.5)


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        (ObstacleClass.PERSON, ObstacleClass.UNKNOWN),
        (ObstacleClass.ANIMAL, ObstacleClass.UNKNOWN),
        (ObstacleClass.UNKNOWN, ObstacleClass.UNKNOWN),
        (ObstacleClass.POLE, ObstacleClass.VEHICLE),
        (ObstacleClass.VEHICLE, ObstacleClass.VEHICLE),
    ],
)
def test_who_may_be_a_person_beside_a_vehicle_makes_it_unclassified(label, expected):
    (one,) = merged([CAR, StaticObstacle(label, BESIDE)], 0.8)
    assert one.label is expected
    assert one.outline.covers(BESIDE)


def test_obstacles_apart_keep_their_classes():
    person = StaticObstacle(ObstacleClass.PERSON, box(2.0, 3.0, 2.5, 3.5))
    assert {one.label for one in merged([CAR, person], 0.8)} == {ObstacleClass.VEHICLE, ObstacleClass.PERSON}
