"""Limiters of speed, brake and curvature."""

import math

import pytest

from messages.command import ControlCommand
from safety.config import SafetyConfig
from safety.output.limiters import (
    braking_demand,
    curve_deceleration,
    limit_acceleration,
    limit_curvature,
    limit_jerk,
    stopping_deceleration,
    target_speed,
)
from safety.stopping_distance import Braking
from tests.safety.safety_world import START_NS, around

NOMINAL = Braking(0.6, 0.4, 2.5)


def control_command(speed: float = 2.0, acceleration: float = 0.0, curvature: float = 0.0) -> ControlCommand:
    return ControlCommand(START_NS, speed, acceleration, curvature, True, True, 1, 0.0, 0.0, 0.0, False)


def test_target_speed() -> None:
    assert target_speed(None, 5.0, 0.0, 0.1, 1) == 0.0
    assert target_speed(control_command(math.nan), 5.0, 0.0, 0.1, 1) == 0.0
    assert target_speed(control_command(2.0), 5.0, 0.0, 0.1, 1) == 2.0
    assert target_speed(control_command(-2.0), 1.0, 0.0, 0.1, -1) == -1.0
    assert target_speed(control_command(-2.0), 1.0, 1.0, 0.1, -1) == 0.0
    for speed_mps in (-2.0, 2.0):  # where nothing is looked for
        assert target_speed(control_command(speed_mps), 1.0, 0.0, 0.1, round(-0.5 * speed_mps)) == 0.0
    assert target_speed(control_command(0.03), 5.0, 0.0, 0.1, 1) == 0.03  # control's own last centimetres
    assert math.copysign(1.0, target_speed(control_command(0.0), 5.0, 0.0, 0.1, 1)) == 1.0
    assert target_speed(control_command(2.0), 5.0, 1.0, 0.1, 1) == 2.0
    assert target_speed(control_command(0.4), 5.0, 1.0, 0.1, 1) == 0.4
    assert target_speed(control_command(-2.0), 1.0, 0.2, 0.1, -1) == -1.0  # creeping, it may turn round
    assert target_speed(control_command(-2.0), 1.0, 0.21, 0.1, -1) == 0.0
    for allowed in around(0.1, 0.01):
        assert (target_speed(control_command(2.0), allowed, 0.0, 0.1, 1) > 0.0) == (allowed >= 0.1), allowed


def test_acceleration_limit() -> None:
    assert limit_acceleration(2.0, 1.0, 1.0, 0.1) == pytest.approx(1.1)
    assert limit_acceleration(-2.0, -1.0, -1.0, 0.1) == pytest.approx(-1.1)
    assert limit_acceleration(0.5, 1.0, 1.0, 0.1) == 0.5
    assert limit_acceleration(0.0, 1.0, 1.0, 0.1) == 0.0
    assert limit_acceleration(2.0, 0.0, 1.5, 0.1) == pytest.approx(1.6)
    assert limit_acceleration(2.0, -1.0, -1.0, 0.1) == pytest.approx(0.1)
    assert limit_acceleration(2.0, 1.0, 0.0, 0.1) == pytest.approx(1.1)  # of a machine that is slow to follow
    assert limit_acceleration(1.0, 1.0, 1.0, 0.1) == 1.0


def test_braking_demand(config: SafetyConfig) -> None:
    braking = config.braking
    assert braking_demand(control_command(), 3.0, 2.0, math.inf, NOMINAL, braking) == 0.0
    assert braking_demand(control_command(acceleration=-0.7), 3.0, 2.0, math.inf, NOMINAL, braking) == 0.7
    assert braking_demand(control_command(acceleration=math.nan), 3.0, 2.0, math.inf, NOMINAL, braking) == 0.0
    assert braking_demand(None, 3.0, 2.0, math.inf, NOMINAL, braking) == 0.0
    assert (
        braking_demand(control_command(acceleration=-99.0), 3.0, 2.0, math.inf, NOMINAL, braking) == braking.full_mps2
    )
    for over in around(0.05, 0.01):
        asked = braking_demand(control_command(), 2.0, 2.0 + over, math.inf, NOMINAL, braking)
        assert (asked > 0.0) == (over > 0.05 + 1e-9), over
    assert braking_demand(control_command(), 0.0, 3.0, 1.5, NOMINAL, braking) == braking.full_mps2
    assert braking_demand(control_command(), 0.0, 0.05, math.inf, NOMINAL, braking) == 0.0
    assert braking_demand(control_command(), 2.0, 2.2, 20.0, NOMINAL, braking) < 2.0
    by_curve = curve_deceleration(2.2, NOMINAL)
    assert braking_demand(control_command(), 2.0, 2.2, math.inf, NOMINAL, braking) == pytest.approx(
        by_curve + 0.4
    )  # gone in 0.5 s


def test_braking_along_speed_curve() -> None:
    assert curve_deceleration(2.0, NOMINAL) == pytest.approx(2.0 / (0.6 + 0.2 + 0.8))
    assert curve_deceleration(2.0, Braking(0.6, 0.5, 0.8)) == pytest.approx(2.0 / (0.6 + 0.25 + 2.5))
    assert curve_deceleration(2.0, Braking(0.6, 0.4, 0.0)) == 0.0


def test_stopping_deceleration_and_jerk_limit(config: SafetyConfig) -> None:
    assert stopping_deceleration(2.0, math.inf, config.braking) == config.braking.controlled_mps2
    assert stopping_deceleration(3.0, 2.0, config.braking) == pytest.approx(9.0 / 2.0 / 1.1)
    assert limit_jerk(1.0, 0.0, 1.5, 0.06) == 0.06
    assert limit_jerk(1.5, 0.0, 1.5, 0.06) == 0.06
    assert limit_jerk(1.6, 0.0, 1.5, 0.06) == 1.6
    assert limit_jerk(0.2, 1.0, 1.5, 0.06) == 0.2


def test_curvature_limit() -> None:
    assert limit_curvature(None, 0.1, 0.2, 0.01) == 0.1
    assert limit_curvature(control_command(curvature=math.nan), 0.1, 0.2, 0.01) == 0.1
    assert limit_curvature(control_command(curvature=9.0), 0.1, 0.2, 1.0) == 0.2
    assert limit_curvature(control_command(curvature=-9.0), 0.1, 0.2, 0.01) == pytest.approx(0.09)
