"""Start conditions: fold position, wheel alignment and timeout at standstill."""

from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import FOLDED
from control.controller import Controller
from control.lateral_controller import VehicleSample
from control.start_conditions import StartConditions
from geometry.pose2 import Pose2
from tests.control.plant import CONFIG, IMPLEMENT, Actuators, Plant, machine_state, path_along

AT_REST = VehicleSample(0, Pose2(0.0, 0.0, 0.0), 0.0, 0.0, 0.0)


def started(fold, is_folded):
    found = StartConditions(IMPLEMENT, CONFIG.start_conditions)
    found.start(is_folded)
    found.observe(None if fold is None else machine_state(1, 1.0, 0.0, fold))
    return found


@pytest.mark.parametrize(("fold", "is_folded", "starts"), [
    (FOLDED, True, True), (FOLDED - 0.001, True, False), (1.0, True, True), (0.0, True, False),
    (0.0, False, True), (1 - FOLDED, False, True), (1.001 - FOLDED, False, False), (1.0, False, False),
    (None, True, False), (None, False, False),
])  # fmt: skip
def test_held_until_fold_position(fold, is_folded, starts):
    assert started(fold, is_folded).is_held(AT_REST, 0.0, True, 0.02) is not starts


@pytest.mark.parametrize(("gap", "starts"), [(0.0199, True), (0.0201, False), (-0.0201, False), (0.2, False)])
def test_held_until_wheels_aligned(gap, starts):
    assert started(0.0, False).is_held(AT_REST, gap, True, 0.02) is not starts


def test_alignment_timeout_counts_only_while_steering():
    for is_steering in (True, False):
        held = [started(0.0, False)]
        times = [held[0].is_held(AT_REST, 0.1, is_steering, 0.02) for _ in range(400)]
        assert sum(times) == (
            pytest.approx(CONFIG.start_conditions.alignment_timeout_s / 0.02, abs=2) if is_steering else 400
        )


def test_not_held_while_moving():
    found = started(0.0, False)
    assert not found.is_held(replace(AT_REST, speed_mps=0.5), 0.2, True, 0.02)
    found.observe(None)
    assert not found.is_held(AT_REST, 0.2, True, 0.02)


def test_not_held_without_fold():
    found = StartConditions(IMPLEMENT.model_copy(update={"fold": None}), CONFIG.start_conditions)
    found.start(True)
    assert not found.is_held(AT_REST, 0.0, True, 0.02)
    assert not found.is_folded


@pytest.mark.parametrize(
    ("fold", "control_command"), [(None, False), (0.0, False), (0.49, False), (0.51, True), (1.0, True)]
)
def test_fold_command_without_path(fold, control_command):
    controller = Controller(None or Plant().controller._vehicle, IMPLEMENT, CONFIG)
    plant = Plant()
    plant.controller = controller
    if fold is not None:
        plant.inbox.messages["machine"] = machine_state(plant.now_ns, 1.0, 0.0, fold)
    (_, found), = controller.step(plant.now_ns, plant.inbox)  # fmt: skip
    assert (found.is_implement_folded, found.speed_mps) == (control_command, 0.0)


def test_fold_drive_unfold():
    plant = Plant()
    for number, is_folded in ((1, True), (2, False)):
        path = replace(path_along(np.zeros(50), 0.5, start=(plant.x, 0.0, 0.0), path_id=number), is_transport=is_folded)
        before = len(plant.track.t_s)
        track = plant.run(path)
        assert track.commands[-1].is_finished
        commands, speeds = track.commands[before:], np.array(track.speed_mps[before:])
        assert {w.is_implement_folded for w in commands} == {is_folded}
        moving = int(np.argmax(speeds > 0.03))
        assert moving * 0.02 == pytest.approx(IMPLEMENT.fold.duration_s, abs=1.2)
        assert plant.fold == float(is_folded)


def test_wheel_alignment_before_curve():
    plant = Plant(actuators=Actuators())
    path = path_along(np.full(80, 0.19), 0.5)
    track = plant.run(path)
    first = next(k for k, v in enumerate(track.speed_mps) if v > 0.03)
    assert abs(plant.controller._lateral._model.curvature_radpm - 0.19) < 0.05
    assert first * 0.02 > 0.8  # 0.45 rad at 0.47 rad/s
    assert np.hypot(track.x_m[first], track.y_m[first]) < 0.02
