"""Values that no sensor should send: each number of each shown message as NaN and infinite."""

import json
import math
from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pytest

from hmi.shown import shown_of
from hmi.texts import texts_of
from messages.command import ControlCommand, Mode
from messages.message import Message
from messages.perception import HealthState, ObstacleClass, SensorHealth, Track, Tracks
from messages.plan import MissionState, Path, PathSection, PathSectionType
from messages.sensors import GnssFix, GnssSolution
from tests.hmi.drive_messages import NOW_NS, machine, map_pose, mission, odometry, state_of, status, supervisor


def usual() -> dict[str, Message]:
    """One message of each shown topic."""
    two, four = np.zeros(2), np.eye(4)
    track = Track(1, ObstacleClass.PERSON, 0.9, two, two, four, np.ones(3), 0.0, NOW_NS, NOW_NS, True, ("lidar",))
    section = PathSection(PathSectionType.SWATH, 0, 0, 9)
    line, zeros = np.column_stack([np.arange(10.0), np.zeros(10)]), np.zeros(10)
    return {
        "supervisor": supervisor(
            Mode.AUTOMATIC, clearance_m=3.0, triggering_points_base_m=np.zeros((3, 3), np.float32),
            protective_field_base_m=np.zeros((4, 2)), obstacle_class=ObstacleClass.PERSON,
        ),
        "map_pose": map_pose(), "machine": machine(is_hitch_in_work=True), "odom": odometry(1.0, 2.0),
        "order_status": status(),
        "mission": mission(MissionState.DRIVING, 30.0),
        "control_command": ControlCommand(NOW_NS, 1.0, 0.0, 0.0, True, True, 1, 3.0, 0.01, 0.01, False),
        "tracks": Tracks(NOW_NS, (track,)),
        "health/lidar_front": SensorHealth(NOW_NS, "lidar_front", HealthState.GOOD, "", np.zeros(3), np.ones(2), 0),
        "gnss/main": GnssFix(NOW_NS, 0.9, 0.1, 20.0, np.ones(3), np.ones(3), 0.1, 0.0, 0.1, GnssSolution.RTK_FIXED,
                             None, 1.0, 1.0, ""),
        "path": Path(NOW_NS, 1, 1, line, zeros, zeros, zeros, zeros, np.ones(10, np.uint8), (section,),
                     np.zeros(10, np.int32), True),
    }  # fmt: skip


def odd(message: Message, value: float) -> Iterator[tuple[str, Message]]:
    """The message with each of its numbers and arrays of numbers as this value."""
    for field in fields(message):
        present = getattr(message, field.name)
        if isinstance(present, np.ndarray) and present.dtype.kind == "f":
            yield (
                field.name,
                replace(message, **{field.name: np.full_like(present, value)}),
            )
        elif type(present) is float:
            yield field.name, replace(message, **{field.name: value})


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
@pytest.mark.parametrize("topic", sorted(usual()))
def test_odd_numbers_are_shown_somehow(topic: str, value: float) -> None:
    for name, message in odd(usual()[topic], value):
        state = state_of(*(usual() | {topic: message}).items())
        state.engaged_s = 100.0
        for language in ("en", "zh"):
            shown = shown_of(state, texts_of(language), str, None)
            text = json.dumps(shown)
            assert " nan" not in text.replace("NaN", ""), name
            assert shown["state"][0]


def test_usual_values_are_shown() -> None:
    shown = shown_of(state_of(*usual().items()), texts_of("en"), str, None)
    assert shown["bar"] == 1.0
    assert shown["obstacles"][0][1] == "Person"
    assert shown["map"]["pose"] == [1.0, 2.0, 0.0]
    assert [row[2] for row in shown["position"] if row[0] == "satellites"] == ["–"]
