"""Drivetrain and brakes of the simulated tractor, against independent formulas."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulation.machine.drivetrain import BrakeSystem, advance_speed, ramp
from tests.simulation.simulated_farm import Farm, flat, machine_file


@pytest.fixture
def farm():
    farm = Farm(config=flat(machine={"drive": {"rolling_resistance_mps2": 0.0}}))
    yield farm
    farm.close()


@pytest.mark.parametrize("speed_mps", [0.4, 1.0, 2.78, 5.0, 8.3])
def test_braking_distance(speed_mps):
    brake = machine_file().brake
    dt = 0.005
    system, v, distance_m = BrakeSystem(brake, dt), speed_mps, 0.0
    while v > 0.0:
        v = advance_speed(v, 0.0, system.step(9.0), dt)
        distance_m += v * dt
    a, tb, tau = brake.deceleration_mps2, brake.build_up_s, brake.dead_time_s
    if speed_mps >= a * tb / 2:
        formula = speed_mps * (tau + tb) - a * tb**2 / 6 + (speed_mps - a * tb / 2) ** 2 / (2 * a)
    else:
        formula = speed_mps * tau + 2 / 3 * speed_mps * math.sqrt(2 * speed_mps * tb / a)
    assert distance_m == pytest.approx(formula, rel=0.02, abs=0.01)


def test_brake_capacity_and_partial_request():
    brake = machine_file().brake
    system = BrakeSystem(brake, 0.005)
    assert max(system.step(9.0) for _ in range(200)) == pytest.approx(4.0)
    assert [system.step(1.5) for _ in range(200)][-1] == pytest.approx(1.5)


def test_braking_distance_over_bus(farm):
    farm.drive_at(2.78)
    v, x = farm.machine.speed_mps, farm.machine.x_m
    farm.brake_mps2, farm.speed_mps = 8.0, 0.0
    farm.drive(3.0)
    assert farm.machine.speed_mps == 0.0
    formula = v * (0.15 + 0.3) - 4.0 * 0.09 / 6 + (v - 0.6) ** 2 / 8.0
    assert farm.machine.x_m - x == pytest.approx(formula, abs=0.02 * v + 0.05)  # one bus period and 1 cm of the formula


@pytest.mark.parametrize("speed_mps", [0.5, 1.39, 2.78, -1.0])
def test_speed_loop_set_point(farm, speed_mps):
    farm.drive_at(speed_mps)
    assert farm.machine.wheel_speed_mps == pytest.approx(speed_mps, abs=0.02)


def test_wheel_slip_while_working(farm):
    farm.drive_at(2.78)
    farm.is_lowered = True
    farm.drive(4.0)
    assert farm.machine.attached.is_working
    slip = farm.machine.wheel_speed_mps / farm.machine.speed_mps - 1.0
    assert 0.02 < slip < 0.06


def test_grade_of_eight_percent():
    config = flat(terrain={"grade": 0.08, "grade_length_m": 180.0, "flat_m": 0.0})
    farm = Farm(config=config, site=None or _site_on_grade())
    farm.drive_at(2.78)
    assert abs(farm.machine.T_map_base[2, 0]) > 0.05
    assert farm.machine.wheel_speed_mps == pytest.approx(2.78, abs=0.05)
    farm.speed_mps = 0.0
    farm.drive(4.0)
    x = farm.machine.x_m
    farm.drive(2.0)
    assert farm.machine.x_m == x
    farm.close()


def _site_on_grade():
    from tests.simulation.simulated_farm import SITE

    yard = SITE.yard.model_copy(update={"outline_m": ((-50.0, -5.0), (-30.0, -5.0), (-30.0, 5.0), (-50.0, 5.0))})
    return SITE.model_copy(update={"yard": yard})


@given(st.floats(-5, 5), st.floats(-3, 3), st.floats(0, 10))
@settings(derandomize=True, max_examples=100)
def test_friction_opposes_motion(speed, drive, friction):
    after = advance_speed(speed, drive, friction, 0.005)
    if abs(drive) <= friction:
        assert after * speed >= 0.0
        assert abs(after) <= abs(speed)


@given(st.floats(-10, 10), st.floats(-10, 10))
@settings(derandomize=True, max_examples=100)
def test_ramp_limit(value, target):
    step = ramp(value, target, 0.6, 1.0, 0.01)
    assert abs(step) <= 0.01 + 1e-12
    assert abs(target - value - step) <= abs(target - value)
