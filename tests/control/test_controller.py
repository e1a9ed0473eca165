"""Controller node: commands with missing inputs, consecutive paths, determinism."""

import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from configs.strict import parse
from control.controller import NO_PATH, ControlConfig, Controller
from messages.command import ControlCommand
from messages.errors import ConfigError
from messages.plan import MissionState, MissionStatus, PathSectionType
from messages.topics import spec_of
from tests.control.plant import CONFIG, IMPLEMENT, VEHICLE, Inbox, Plant, SensorNoise, path_along


def test_topics_in_topic_table():
    controller = Controller(VEHICLE, IMPLEMENT, CONFIG)
    assert [spec_of(t).type for t in controller.writes] == [ControlCommand]
    for topic in controller.reads:
        spec_of(topic)


def test_standstill_command_without_input():
    (topic, control_command), = Controller(VEHICLE, IMPLEMENT, CONFIG).step(1, Inbox())  # fmt: skip
    assert topic == "control_command"
    assert (control_command.speed_mps, control_command.path_id, control_command.is_finished) == (0.0, NO_PATH, False)
    assert control_command.acceleration_mps2 < 0.0


@pytest.mark.parametrize("missing", ["odom", "map_pose"])
def test_standstill_command_without_pose_then_resume(missing):
    plant = Plant()
    path = path_along(np.zeros(300), 2.0)
    plant.run(path, stop=lambda p, _: p.x > 10.0)
    del plant.inbox.messages[missing]
    (_, control_command), = plant.controller.step(plant.now_ns, plant.inbox)  # fmt: skip
    assert (control_command.speed_mps, control_command.is_finished) == (0.0, False)
    track = plant.run(path)
    assert track.commands[-1].is_finished


def test_standstill_command_with_uninitialized_pose():
    plant = Plant()
    plant.inbox.messages["path"] = path_along(np.zeros(100))
    plant.measure()
    pose = plant.inbox.messages["map_pose"]
    plant.inbox.messages["map_pose"] = replace(pose, is_initialized=False)
    (_, control_command), = plant.controller.step(plant.now_ns, plant.inbox)  # fmt: skip
    assert control_command.speed_mps == 0.0


def test_consecutive_paths():
    plant = Plant()
    plant.run(path_along(np.zeros(120), 2.0, path_id=1))
    assert plant.control_command.is_finished
    back = path_along(np.zeros(100), 1.0, start=(12.0, 0.0, 0.0), direction=-1, path_id=2)
    track = plant.run(back)
    assert track.commands[-1].path_id == 2
    assert track.commands[-1].is_finished
    assert min(w.speed_mps for w in track.commands) == pytest.approx(-1.0, abs=0.15)
    assert plant.x == pytest.approx(2.0, abs=0.06)


def test_error_signs_forward_and_reverse():
    for direction, start in ((1, (0.0, 0.0, 0.0)), (-1, (30.0, 0.0, 0.0))):
        path = path_along(np.zeros(300), 1.0, start=start, direction=direction)
        plant = Plant(x=start[0], y=0.2, yaw=math.radians(3.0))
        plant.inbox.messages["path"] = path
        control_command = plant.control()
        assert control_command.xte_m == pytest.approx(0.2, abs=0.03)
        assert control_command.heading_error_rad == pytest.approx(math.radians(3.0), abs=0.005)


def shifted(y_m, now_ns=0):
    return MissionStatus(
        now_ns, MissionState.DRIVING, PathSectionType.SWATH, 0, 1, 0.0, 0.0, 1.0, "", (), 0.0, y_m, y_m
    )


@pytest.mark.parametrize("left_m", [0.05, -0.05])
def test_a_shift_of_the_line_is_driven_at_a_bounded_rate(left_m):
    path = path_along(np.zeros(1200), 2.0)
    plant = Plant(noise=SensorNoise(map_m=0.0), seed=2)
    plant.run(path, until_s=20.0)
    began = len(plant.track.y_m)
    plant.inbox.messages["mission"] = shifted(left_m)
    plant.run(path, until_s=15.0)
    y = np.array(plant.track.y_m[began:]) - plant.track.y_m[began - 1]
    commands = np.array([w.xte_m for w in plant.track.commands[began:]])
    assert y[-1] == pytest.approx(left_m, abs=0.01)
    assert np.abs(y[: round(1.0 / 0.02)]).max() < 0.06  # 0.05 m/s
    assert np.abs(commands).max() < 0.06  # the error is that against the driven line
    assert (y * np.sign(left_m)).max() < 0.07  # overshoot
    plant.inbox.messages.pop("mission")
    plant.run(path, until_s=15.0)
    assert plant.track.y_m[-1] - plant.track.y_m[began - 1] == pytest.approx(0.0, abs=0.01)


def test_determinism():
    path = path_along(0.1 * np.sin(np.arange(150) * 0.05), 2.0)
    first, second = (Plant(seed=3).run(path).commands for _ in range(2))
    assert [astuple(w) for w in first] == [astuple(w) for w in second]


@pytest.mark.parametrize("value", [math.nan, -1.0, 0.0, 1e9])
def test_invalid_config_value_named_in_error(value):
    values = CONFIG.model_dump()
    values["tracking"]["offset_decay_m"] = value
    with pytest.raises(ConfigError, match="offset_decay_m"):
        parse(ControlConfig, values, "here")


@pytest.mark.parametrize("points", [1, 2, 4])
def test_minimal_path_length(points):
    complete = path_along(np.zeros(20), 1.0)
    short = {
        k: getattr(complete, k)[:points] for k in ("p_map_m", "heading_rad", "curvature_radpm", "s_m", "is_working")
    }
    path = replace(complete, **short, speed_mps=np.append(np.full(points - 1, 0.3), 0.0))
    track = Plant().run(path, until_s=30.0)
    assert track.commands[-1].is_finished
    assert abs(track.x_m[-1] - path.s_m[-1]) < 0.05
