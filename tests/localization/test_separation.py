"""Mounts, tyres and gyros that are not perfect are no fault of GNSS and do not tilt the machine."""

import dataclasses
import math

import numpy as np
import pytest

from geometry.transforms import planar, rpy_of, transform
from localization.gnss_gate import Position
from localization.graph.smoother import State
from localization.separation import OdometrySeparation, Swing, VelocitySeparation
from messages.motion import LidarLocalization
from messages.sensors import GnssSolution, ImuSample
from tests.localization.harness import configuration, run
from tests.localization.synthetic_drive import START_NS, drive

CONFIG = configuration().map_alignment.gnss_monitor
DETECTED = CONFIG.detect_sigmas


def fix(t_s, p_m, velocity_mps=(0.0, 0.0)):
    sigma = np.full(3, 0.007)
    velocity = np.array([*velocity_mps, 0.0])
    return Position(
        round(t_s * 1e9), np.array([*p_m, 0.0]), sigma, sigma, math.nan, math.nan, 0.0, GnssSolution.RTK_FIXED,
        velocity, 0.03, sigma,
    )  # fmt: skip


@pytest.mark.parametrize("is_known", [True, False])
def test_an_antenna_that_swings_faster_than_fixes_come_does_not_contradict_itself(is_known):
    separation, still = VelocitySeparation(CONFIG.separation), Swing(np.zeros(2), np.zeros(2), 0.0)
    turn = 2.0 * math.pi * 9.8  # 0.4 degrees of pitch below an antenna at 3 m, aliased to 0.2 Hz
    for t_s in np.arange(0.0, 5.01, 0.1):
        arm_m, swing_mps = 0.02 * math.sin(turn * t_s), 0.02 * turn * math.cos(turn * t_s)
        swing = Swing(np.array([arm_m, 0.0]), np.array([swing_mps, 0.0]), 0.0) if is_known else still
        separation.add(fix(t_s, (2.0 * t_s + arm_m, 0.0), (2.0 + swing_mps, 0.0)), swing)
    found = max(separation.since(round(t_s * 1e9)).ratio for t_s in (0.0, 2.5, 3.0, 4.0))
    assert (found < 1.0) is is_known
    assert (found > DETECTED) is not is_known


@pytest.mark.parametrize("is_known", [True, False])
def test_lever_arm_and_gyro_scale_do_not_contradict_the_wheels_after_a_half_turn(is_known):
    config = CONFIG.separation
    if not is_known:
        config = config.model_copy(update={"lever_arm_m": 0.0, "gyro_scale": 0.0})
    separation = OdometrySeparation(config, np.full(4, 1e-4), 0.002, 1e-5, 0.05)
    p_m, yaw, dt_s = np.zeros(2), 0.0, 0.2
    for k in range(120):
        speed, rate = (1.6, 1.6 / 6.0) if 20 <= k < 79 else (2.5 if 79 <= k < 115 else 0.0, 0.0)
        columns = np.array([[speed * dt_s, 0.0, 0.0, 0.0], [0.0, speed * dt_s, 0.0, 0.0], [0.0] * 4])
        separation.advance(planar(0.0, 0.0, 1.005 * yaw + 0.5 * rate * dt_s), columns)
        yaw += rate * dt_s
        p_m = p_m + speed * dt_s * np.array([math.cos(yaw - 0.5 * rate * dt_s), math.sin(yaw - 0.5 * rate * dt_s)])
        velocity = np.array([speed * math.cos(yaw), speed * math.sin(yaw), 0.0])
        sigmas = np.concatenate([np.full(15, 1e-4), [0.002, 0.001, 0.01, 0.01]])
        state = State(
            round((k + 1) * dt_s * 1e9), planar(*p_m, yaw), velocity, np.zeros(6), np.array([1.0, 0.0, 0.0, 0.0]),
            np.eye(6) * 1e-7, sigmas,
        )  # fmt: skip
        base_m = p_m + 0.03 * np.array([-math.sin(yaw), math.cos(yaw)])
        separation.add(fix(state.stamp_ns * 1e-9, base_m), np.array([*base_m, 0.0]), state, np.eye(4), np.eye(4), 0.0)
    ratio = separation.since(round(2.0e9)).ratio
    assert (ratio < DETECTED) is is_known


def stood(edit, extra=()):
    """State after 12 s of standstill with a change of its messages."""
    truth = drive(12.0, legs=[(100.0, 0.0, 0.0)])
    messages = [(arrival, topic, edit(message)) for arrival, topic, message in truth.messages]
    result = run(sorted([*messages, *extra], key=lambda m: m[0]))
    return result.localizer._map_alignment.state


def test_a_body_that_squats_on_its_tyres_while_the_wheels_stand_is_no_gyro_bias():
    squat_rad = math.radians(0.5)

    def edit(message):
        t_s = (message.stamp_ns - START_NS) * 1e-9
        if not isinstance(message, ImuSample) or t_s < 5.0:
            return message
        rate = np.array([0.0, squat_rad / 0.2 if t_s < 5.2 else 0.0, 0.0])
        force = np.array([-9.81 * squat_rad * min(1.0, (t_s - 5.0) / 0.2), 0.0, 0.0])
        return dataclasses.replace(
            message, rate_radps=message.rate_radps + rate, acceleration_mps2=message.acceleration_mps2 + force
        )

    squatted, before = stood(edit), stood(lambda m: m)
    assert np.max(np.abs(squatted.bias[3:] - before.bias[3:])) < math.radians(10.0) / 3600.0
    assert rpy_of(squatted.T_map_body)[1] - rpy_of(before.T_map_body)[1] == pytest.approx(squat_rad, abs=1e-3)


def test_a_lidar_map_that_is_off_beside_fixed_ambiguities_does_not_tilt_the_machine():
    T = transform((0.0, 0.05, 0.0), (0.0, 0.0, 0.0)) @ drive(12.0, legs=[(100.0, 0.0, 0.0)]).at(START_NS)
    covariance = np.diag([1.0, 1.0, 0.001, 0.01, 0.01, 1.0]) ** 2
    stamps = range(START_NS + 3_000_000_000, START_NS + 11_000_000_000, 200_000_000)
    found = [(s + 80_000_000, "lidar_localization", LidarLocalization(s, T, covariance, True, "", 300)) for s in stamps]
    with_map, without = (rpy_of(stood(lambda m: m, extra).T_map_body) for extra in (found, ()))
    assert np.degrees(np.max(np.abs(with_map - without))) < 0.05
