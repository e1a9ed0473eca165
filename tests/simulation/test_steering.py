"""Both steering actuators: dead time, rate limit, dead band, backlash, and the position loop."""

import itertools
import math

import pytest

from simulation.machine.steering import DelayLine, Steering, follow_lag, follow_play, open_valve
from tests.simulation.simulated_farm import CONFIG, machine_file

DT = 0.005


def steering_of(name):
    vehicle = machine_file(name)
    return Steering(vehicle.steering, vehicle.drivetrain, CONFIG.machine.steering, DT), vehicle


def respond(name, target_rad, seconds=3.0):
    steering, vehicle = steering_of(name)
    angles = []
    for _ in range(round(seconds / DT)):
        steering.step(target_rad, steering.angle_rad)
        angles.append(steering.angle_rad)
    return angles, steering, vehicle


@pytest.mark.parametrize("name", ["tractor_e", "tractor_h"])
@pytest.mark.parametrize("target_deg", [1.0, -3.0, 10.0, -25.0])
def test_step_response(name, target_deg):
    angles, steering, vehicle = respond(name, math.radians(target_deg))
    dead = round(vehicle.steering.dead_time_s / DT)
    assert all(a == 0.0 for a in angles[: dead - 1])
    rates = [abs(b - a) / DT for a, b in itertools.pairwise(angles)]
    assert max(rates) <= steering.rate_limit_radps * 1.001
    assert math.degrees(angles[-1]) == pytest.approx(target_deg, abs=0.25)
    overshoot = max(abs(a) for a in angles) - math.radians(abs(target_deg))
    assert overshoot < math.radians(0.1 * abs(target_deg) + 0.1)


@pytest.mark.parametrize("name", ["tractor_e", "tractor_h"])
def test_no_limit_cycle(name):
    angles, _, _ = respond(name, math.radians(5.0), 6.0)
    tail = angles[-400:]
    assert max(tail) - min(tail) < math.radians(0.02)


@pytest.mark.parametrize("name", ["tractor_e", "tractor_h"])
def test_released_steering_held(name):
    _, steering, _ = respond(name, math.radians(5.0))
    before = steering.angle_rad
    for _ in range(400):
        steering.step(None, steering.angle_rad)
    assert steering.angle_rad == pytest.approx(before, abs=1e-4)


def test_steering_rate_limit():
    angles, steering, _ = respond("tractor_e", math.radians(25.0))
    half = next(k for k, a in enumerate(angles) if a > math.radians(12.5)) * DT
    assert half > math.radians(12.5) / steering.rate_limit_radps + 0.06


@pytest.mark.parametrize(
    ("command", "share"), [(0.0, 0.0), (0.06, 0.0), (-0.06, 0.0), (0.0601, 1e-4), (1.0, 1.0), (-1.0, -1.0)]
)
def test_valve_dead_band(command, share):
    assert open_valve(command, 0.06) == pytest.approx(share, abs=2e-5)


def test_backlash():
    assert follow_play(0.0, 0.5, 1.0) == 0.0
    assert follow_play(0.0, 0.6, 1.0) == pytest.approx(0.1)
    assert follow_play(0.1, -0.3, 1.0) == 0.1
    assert follow_play(0.1, -0.9, 1.0) == pytest.approx(-0.4)


def test_delay_line():
    line = DelayLine(0.02, 0.005)
    assert [line.step(float(k)) for k in range(1, 7)] == [0, 0, 0, 0, 1, 2]


def test_first_order_lag():
    value = 0.0
    for _ in range(20):
        value = follow_lag(value, 1.0, 0.1, 0.005)
    assert value == pytest.approx(1 - math.exp(-1))
