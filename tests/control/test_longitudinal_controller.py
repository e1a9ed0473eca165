"""Longitudinal controller: speed on grades, stop at the path end, integration, brake demand."""

import math

import numpy as np
import pytest

from control.longitudinal_controller import LongitudinalController
from tests.control.plant import CONFIG, Actuators, Ground, Plant, path_along


@pytest.mark.parametrize(("grade", "speed_gain"), [(-0.08, 1.05), (-0.08, 0.94), (0.08, 0.94)])
def test_speed_error_on_grade(grade, speed_gain):
    """Error of the tractor speed loop of 5 % and by load: within 0.1 km/h (BD-5.2.5a)."""
    plant = Plant(ground=Ground(grade=grade), actuators=Actuators(speed_gain=speed_gain))
    track = plant.run(path_along(np.zeros(500), 2.0), stop=lambda p, _: p.x > 45.0)
    steady = np.array(track.speed_mps)[np.array(track.x_m) > 25.0]
    assert np.abs(steady - 2.0).max() * 3.6 <= 0.1


def test_speed_error_after_draft_change():
    plant = Plant()
    path = path_along(np.zeros(700), 2.0)
    plant.run(path, stop=lambda p, _: p.x > 20.0)
    plant.ground.grade = 0.04
    track = plant.run(path, stop=lambda p, _: p.x > 45.0)
    late = np.array(track.speed_mps)[np.array(track.x_m) > 35.0]
    assert np.abs(late - 2.0).max() * 3.6 <= 0.1


@pytest.mark.parametrize(
    ("speed_mps", "direction", "grade"),
    [(2.78, 1, 0.0), (2.78, 1, -0.08), (1.39, 1, 0.08), (0.5, -1, 0.08), (0.5, -1, -0.08)],
)
def test_stop_at_path_end(grade, speed_mps, direction):
    length_m = 15 if speed_mps > 1.0 else 5
    path = path_along(np.zeros(10 * length_m), speed_mps, direction=direction)
    plant = Plant(ground=Ground(grade=grade), speed=0.0)
    track = plant.run(path, until_s=90.0)
    assert track.commands[-1].is_finished
    for _ in range(50):
        plant.control()
        plant.move()
        plant.now_ns += 20_000_000
    assert abs(plant.speed) < 0.02
    assert abs(length_m - direction * plant.x) <= 0.05


def test_deceleration_before_slower_section():
    path = path_along(np.zeros(500), 2.78)
    path.speed_mps.flags.writeable = True
    path.speed_mps[300:] = np.minimum(path.speed_mps[300:], 1.0)
    track = Plant().run(path)
    slow = np.array(track.x_m) > 30.2
    assert np.array(track.speed_mps)[slow].max() < 1.15


def test_speed_limit_far_from_path():
    track = Plant(y=1.5).run(path_along(np.zeros(500), 2.78), stop=lambda p, _: p.x > 30.0)
    far = np.abs(np.array(track.y_m)) > CONFIG.speed.far_offset_m
    assert np.array(track.speed_mps)[far].max() < CONFIG.speed.far_mps + 0.1
    assert track.speed_mps[-1] > 2.5


def test_no_integration_during_supervisor_stop():
    plant = Plant(actuators=Actuators(speed_gain=1.0))
    path = path_along(np.zeros(600), 2.0)
    plant.run(path, stop=lambda p, _: p.x > 15.0)
    learned = plant.controller._longitudinal._integral_mps
    plant.is_enabled = False
    plant.run(path, until_s=10.0)
    assert plant.speed == pytest.approx(0.0, abs=0.02)
    assert plant.controller._longitudinal._integral_mps == pytest.approx(learned, abs=0.01)
    plant.is_enabled = True
    track = plant.run(path, stop=lambda p, _: p.x > 35.0)
    assert max(track.speed_mps) < 2.2


def test_command_ramp_when_stuck():
    control = LongitudinalController(CONFIG.speed)
    commanded = [control.command(0.3, 0.0, 0.02, True)[0] for _ in range(200)]
    assert commanded[-1] > commanded[0] + 0.2
    assert max(commanded) <= 0.3 + CONFIG.speed.integral_max_mps + 1e-9


@pytest.mark.parametrize("speed_mps", [0.0, 0.5, 1.0, 1.2, 1.3, 2.0, 5.0])
def test_brake_demand_on_overspeed_only(speed_mps):
    control = LongitudinalController(CONFIG.speed)
    for _ in range(200):
        _, acceleration = control.command(1.0, speed_mps, 0.02, True)
    excess = speed_mps - 1.0 - CONFIG.speed.overspeed_mps
    assert (acceleration < -1e-6) == (excess > 1e-6)
    assert acceleration >= -CONFIG.speed.max_braking_mps2
    assert control.command(0.0, speed_mps, 0.02, True) == (0.0, pytest.approx(-braking_to_stand(speed_mps)))


@pytest.mark.parametrize("grade", [0.0, 0.04, 0.08])
def test_brakes_slow_the_machine_downhill(grade):
    """A machine that rolls freely with 0.4 m/s too much is at its speed within 4 s, and is not slowed below it."""
    control, speed_mps, braking_mps2, speeds = LongitudinalController(CONFIG.speed), 2.4, 0.0, []
    for _ in range(500):
        _, acceleration = control.command(2.0, speed_mps, 0.02, True, grade)
        braking_mps2 += (-acceleration - braking_mps2) * 0.02 / 0.3
        rolls = (
            9.81 * grade - braking_mps2 if acceleration < 0.0 else 1.5 * (2.0 - speed_mps)
        )  # the drive holds it then
        speed_mps += 0.02 * rolls
        speeds.append(speed_mps)
    assert max(speeds) < 2.5
    assert max(speeds[200:]) < 2.05
    assert min(speeds) > 1.85


def braking_to_stand(speed_mps):
    speed = CONFIG.speed
    return min(max(speed.overspeed_per_s * speed_mps, speed.holding_mps2), speed.max_braking_mps2)


def test_continuous_deceleration_at_path_end():
    plant = Plant()
    path = path_along(np.zeros(100), 2.0)
    plant.inbox.messages["path"] = path
    plant.control()
    plan, config = plant.controller._plan, CONFIG.speed
    far = np.linspace(0.0, 5.0, 5001)
    speeds = np.array([plan.ending_mps(d, config) for d in far])
    assert speeds[0] == 0.0
    assert np.all(np.diff(speeds) > 0.0)
    braking = speeds[1:] * np.diff(speeds) / np.diff(far)
    assert braking.max() <= config.braking_mps2 * 1.01
    assert math.isclose(plan.ending_mps(-1.0, config), 0.0)


def test_brakes_begin_before_the_overspeed_where_a_machine_rolls_faster():
    """Beyond a crest with a drive that does not hold: half of what the supervisor takes for disobedience."""
    control, speed_mps, braking_mps2, speeds = LongitudinalController(CONFIG.speed), 2.4, 0.0, []
    for k in range(200):
        _, acceleration = control.command(2.78, speed_mps, 0.02, True, 0.1 if k > 40 else 0.0)
        braking_mps2 += (-acceleration - braking_mps2) * 0.02 / 0.4
        speed_mps += 0.02 * (1.0 - braking_mps2)
        speeds.append(speed_mps)
    assert max(speeds) - 2.78 < 0.4
