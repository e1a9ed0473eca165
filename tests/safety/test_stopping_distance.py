"""Stopping distance, required range, highest speed."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.stopping_distance import (
    Braking,
    highest_speed,
    needed_deceleration,
    on_grade,
    required_range,
    stopping_distance,
    stopping_time,
)
from tests.safety.safety_world import around

NOMINAL = Braking(0.6, 0.4, 2.5)
SETTINGS = settings(derandomize=True, deadline=None, max_examples=200)
brakings = st.builds(Braking, st.floats(0.0, 1.5), st.floats(0.0, 1.0), st.floats(0.5, 8.0))


@pytest.mark.parametrize(("speed_kmh", "printed_m"), [(7.0, 2.3), (15.0, 6.8), (30.0, 20.5)])
def test_values_of_the_requirements(speed_kmh: float, printed_m: float) -> None:
    assert stopping_distance(speed_kmh / 3.6, NOMINAL) == pytest.approx(printed_m, abs=0.05)


def test_caps_of_a_40_m_sensor() -> None:
    assert highest_speed(20.0, NOMINAL, 0.0) * 3.6 == pytest.approx(29.5, abs=0.6)
    assert stopping_distance(30 / 3.6, NOMINAL) * 2 > 40.0


def simulated(speed: float, braking: Braking) -> tuple[float, float]:
    """Distance and time by integration of the brake's build-up."""
    v, distance, t, dt = speed, speed * braking.reaction_s, 0.0, 1e-4
    while v > 0.0:
        a = braking.deceleration_mps2 * min(1.0, (t + dt / 2) / braking.build_up_s)
        distance += max(0.0, v * dt - a * dt * dt / 2)
        v, t = v - a * dt, t + dt
    return distance, braking.reaction_s + t


@pytest.mark.parametrize("speed", [0.05, 0.3, *around(0.5, 0.02), 1.0, 2.78, 8.3])
def test_stopping_distance_against_integration(speed: float) -> None:
    distance, time = simulated(speed, NOMINAL)
    assert stopping_distance(speed, NOMINAL) == pytest.approx(distance, abs=2e-3)
    assert stopping_time(speed, NOMINAL) == pytest.approx(time, abs=2e-3)


def test_standstill_and_no_brake() -> None:
    no_brake = Braking(0.6, 0.4, 0.0)
    assert stopping_distance(0.0, NOMINAL) == 0.0
    assert stopping_time(0.0, NOMINAL) == 0.6
    assert stopping_time(0.0, no_brake) == 0.6
    assert stopping_distance(-1.0, NOMINAL) == 0.0
    assert math.isinf(stopping_distance(0.1, no_brake))
    assert math.isinf(stopping_time(0.1, no_brake))
    assert highest_speed(10.0, no_brake, 0.0) == 0.0


@pytest.mark.parametrize(("range_m", "speed"), [(math.inf, math.inf), (math.nan, 0.0), (-math.inf, 0.0), (0.0, 0.0)])
def test_range_limits(range_m: float, speed: float) -> None:
    assert highest_speed(range_m, NOMINAL, 0.0) == speed


def test_highest_speed_within_range() -> None:
    for range_m in np.linspace(0.01, 60.0, 500):
        assert stopping_distance(highest_speed(range_m, NOMINAL, 0.0), NOMINAL) <= range_m


def test_required_range_of_approaching_obstacle() -> None:
    way_m, time_s = stopping_distance(2.0, NOMINAL), stopping_time(2.0, NOMINAL)
    assert required_range(2.0, NOMINAL, 1.0) == way_m + 1.0
    assert required_range(2.0, NOMINAL, 1.0, 1.5) == pytest.approx(way_m + 1.0 + 1.5 * time_s)
    assert required_range(2.0, NOMINAL, 1.0, -1.5) == way_m + 1.0  # who goes away may stop
    assert math.isinf(required_range(2.0, Braking(0.6, 0.4, 0.0), 1.0))


def test_allowance_at_standstill() -> None:
    assert highest_speed(1.999, NOMINAL, 2.0) == 0.0
    assert highest_speed(2.001, NOMINAL, 2.0) > 0.0
    assert highest_speed(2.5, NOMINAL, 0.0, obstacle_mps=5.0) == 0.0


@given(brakings, st.floats(0.0, 60.0), st.floats(0.0, 5.0), st.sampled_from([0.0, 0.5, 1.5]))
@SETTINGS
def test_inverse_is_the_highest_speed(braking: Braking, range_m: float, allowance: float, obstacle: float) -> None:
    speed = highest_speed(range_m, braking, allowance, obstacle)
    if speed > 0.0:
        assert required_range(speed, braking, allowance, obstacle) <= range_m + 1e-9
        assert required_range(speed * 1.0001 + 1e-4, braking, allowance, obstacle) > range_m
    else:
        assert required_range(1e-4, braking, allowance, obstacle) > range_m - 1e-3


@given(brakings, st.floats(0.0, 60.0), st.floats(0.0, 5.0), st.floats(0.0, 3.0), st.floats(0.0, 1.0))
@SETTINGS
def test_highest_speed_monotonic(braking: Braking, range_m: float, less: float, obstacle: float, slower: float) -> None:
    base = highest_speed(range_m, braking, 1.0, obstacle)
    assert highest_speed(range_m - less, braking, 1.0, obstacle) <= base
    assert highest_speed(range_m, braking, 1.0 + less, obstacle) <= base
    assert highest_speed(range_m, braking, 1.0, obstacle + less) <= base + 1e-9
    late = Braking(braking.reaction_s + slower, braking.build_up_s, braking.deceleration_mps2)
    assert highest_speed(range_m, late, 1.0, obstacle) <= base + 1e-9


@given(st.floats(0.0, 60.0), st.floats(-0.3, 0.3), st.floats(0.0, 0.2))
@SETTINGS
def test_steeper_downhill_is_never_faster(range_m: float, slope: float, more: float) -> None:
    gentle, steep = (on_grade(NOMINAL, angle, 0.5) for angle in (slope, slope + more))
    assert highest_speed(range_m, steep, 0.0) <= highest_speed(range_m, gentle, 0.0) + 1e-9


def test_grade() -> None:
    assert on_grade(Braking(0.6, 0.4, 0.5), 0.0, 0.5).deceleration_mps2 == 0.5
    downhill = math.atan(0.08)
    assert on_grade(NOMINAL, downhill, 0.5).deceleration_mps2 == pytest.approx(2.5 - 9.80665 * math.sin(downhill))
    assert on_grade(NOMINAL, -downhill, 0.5).deceleration_mps2 == 2.5
    least = math.asin(2.0 / 9.80665)
    assert on_grade(NOMINAL, least - 1e-6, 0.5).deceleration_mps2 == pytest.approx(0.5, abs=1e-4)
    assert on_grade(NOMINAL, least + 1e-6, 0.5).deceleration_mps2 == 0.0


def test_needed_deceleration() -> None:
    assert needed_deceleration(0.0, 1.0, 0.3, 6.0) == 0.0
    assert needed_deceleration(0.0, 0.0, 0.3, 6.0) == 0.0
    assert needed_deceleration(0.5, 0.65, 0.3, 6.0) == pytest.approx(0.25)
    assert needed_deceleration(2.0, 1.4, 0.3, 6.0) == pytest.approx(2.5)
    assert needed_deceleration(2.0, 0.6, 0.3, 6.0) == 6.0
    assert needed_deceleration(2.0, 2.6, 0.3, 6.0) == pytest.approx(1.0)
    assert needed_deceleration(2.0, 0.7, 0.3, 6.0) == 6.0
