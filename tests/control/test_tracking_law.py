"""Tracking law, and the closed loop with delay, lag, backlash, slip and noise."""

import math
from dataclasses import replace

import numpy as np
import pytest

from control.tracking_law import TrackingLaw
from tests.control import plant
from tests.control.plant import CONFIG, Actuators, Ground, Plant, SensorNoise, path_along, true_offsets

FIELD = Ground(side_slope_deg=3.0, understeer=0.01, soil_radpm=0.002)
LAW = TrackingLaw.at(CONFIG.tracking, 0.83, 4.6, 0.18)
FAST_ANYWHERE = CONFIG.model_copy(update={"speed": CONFIG.speed.model_copy(update={"far_speed_kmh": 30.0})})


def drive(path, before_m=12.0, after_m=3.0, **kwargs):
    """True offsets in the steady part, cm: (standard deviation, mean, maximum)."""
    plant = Plant(x=path.p_map_m[0, 0], y=path.p_map_m[0, 1], yaw=path.heading_rad[0], **kwargs)
    track = plant.run(path)
    assert track.commands[-1].is_finished
    offset, s = true_offsets(track, path)
    steady = 100.0 * offset[(s > before_m) & (s < path.s_m[-1] - after_m)]
    assert len(steady) > 200
    return float(steady.std()), float(steady.mean()), float(np.abs(steady).max())


# the law


def test_desired_heading_smooth_and_towards_line():
    offsets = np.linspace(-6.0, 6.0, 24001)
    angles = np.array([LAW.approach(e)[0] for e in offsets])
    slopes = np.array([LAW.approach(e)[1] for e in offsets])
    assert np.all(angles[offsets > 0] < 0.0)
    assert np.allclose(angles, -angles[::-1])
    assert np.all(np.diff(angles) <= 1e-12)
    assert np.abs(angles).max() == pytest.approx(math.radians(CONFIG.tracking.approach_deg))
    inner = np.abs(angles[1:-1]) < 0.99 * LAW.approach_rad
    assert np.allclose(np.gradient(angles, offsets)[1:-1][inner], slopes[1:-1][inner], atol=2e-3)


@pytest.mark.parametrize("curvature", [0.0, 0.05, -0.2])
def test_curvature_of_path_without_error(curvature):
    assert LAW.curvature(0.0, 0.0, curvature) == pytest.approx(curvature)


@pytest.mark.parametrize("curvature", [0.0, 0.1, -0.2])
@pytest.mark.parametrize("offset_m", [-0.3, 0.05, 0.5])
def test_error_decay_without_overshoot(curvature, offset_m):
    """Law on its kinematic model: the offset decays to 0 without a change of sign."""
    e, psi, step = offset_m, 0.0, 0.005
    for _ in range(4000):
        k = LAW.curvature(e, psi, curvature)
        psi += step * (k - curvature * math.cos(psi) / (1.0 - e * curvature))
        e += step * math.sin(psi)
        assert e * offset_m > -1e-9
    assert abs(e) < 1e-4


@pytest.mark.parametrize(("speed_mps", "offset_m"), [(0.83, -1.5), (1.39, 0.5), (2.78, -3.0), (2.78, 0.5), (6.0, 3.0)])
def test_no_oscillation_with_limited_steering_rate(speed_mps, offset_m):
    """Large offsets at all speeds: a demand above the steering rate would cause overshoot."""
    plant = Plant(x=2.0, y=offset_m, speed=speed_mps, noise=SensorNoise(map_m=0.0), config=FAST_ANYWHERE)
    track = plant.run(path_along(np.zeros(900), speed_mps), stop=lambda p, _: p.x > 20.0 + 4.0 * speed_mps)
    offsets = np.array(track.y_m) * math.copysign(1.0, offset_m)
    assert -0.04 < offsets.min() < 0.02
    assert abs(offsets[-1]) < 0.03


# the loop


@pytest.mark.parametrize("speed_mps", [0.83, 1.94, 2.78])
def test_straight_line(speed_mps):
    sigma, mean, greatest = drive(path_along(np.zeros(int(150 + 100 * speed_mps)), speed_mps), ground=FIELD)
    assert sigma <= 1.0
    assert abs(mean) <= 1.5
    assert greatest <= 2.5


def test_straight_line_without_localizer_error():
    sigma, mean, greatest = drive(
        path_along(np.zeros(350)), ground=Ground(side_slope_deg=3.0), noise=SensorNoise(map_m=0.0)
    )
    assert sigma <= 0.3
    assert abs(mean) <= 0.3
    assert greatest <= 0.8


@pytest.mark.parametrize(("radius_m", "speed_mps", "side"), [(5.0, 1.39, 1), (10.0, 1.94, -1), (20.0, 2.78, 1)])
def test_circle(radius_m, speed_mps, side):
    path = path_along(np.full(min(int(2 * math.pi * radius_m * 10), 600), side / radius_m), speed_mps)
    sigma, mean, greatest = drive(path, ground=FIELD, noise=SensorNoise(map_m=0.003))
    assert sigma <= 1.5
    assert abs(mean) <= 1.0
    assert greatest <= 2.5


def test_adaptive_curve():
    k = 0.05 * np.sin(np.arange(700) * 0.1 * 2.0 * math.pi / 40.0)
    sigma, _, greatest = drive(path_along(k), ground=FIELD)
    assert sigma <= 2.0
    assert greatest <= 2.5


def test_curvature_steps():
    steps = np.concatenate([np.zeros(100), np.full(100, 0.2), np.full(100, -0.2), np.zeros(150)])
    sigma, _, greatest = drive(path_along(steps, 1.39), before_m=2.0, ground=FIELD, noise=SensorNoise(map_m=0.003))
    assert sigma <= 2.0
    assert greatest <= 5.0


@pytest.mark.parametrize("curvature", [0.0, 0.12])
def test_reverse(curvature):
    path = path_along(np.full(250, curvature), 1.0, direction=-1)
    sigma, mean, greatest = drive(path, ground=FIELD, before_m=6.0)
    assert sigma <= 1.0
    assert abs(mean) <= 1.5
    assert greatest <= 2.5


def test_reverse_returns_to_the_path():
    path = path_along(np.zeros(200), 0.8, direction=-1)
    plant = Plant(x=-1.0, y=0.4, yaw=math.radians(10.0))
    offset, s = true_offsets(plant.run(path), path)
    assert np.abs(offset[s > 12.0]).max() < 0.025


@pytest.mark.parametrize(
    "actuators",
    [
        Actuators(loop_s=0.12, bus_s=0.02),
        Actuators(loop_s=0.45, bus_s=0.08),
        Actuators(dead_s=0.1),
        Actuators(backlash_deg=0.8),
        Actuators(rate_radps=0.3),
    ],
    ids=str,
)
def test_robustness_to_actuator_parameters(actuators):
    sigma, _, greatest = drive(
        path_along(np.zeros(350)), ground=FIELD, actuators=actuators, noise=SensorNoise(map_m=0.0)
    )
    assert sigma <= 1.2
    assert greatest <= 3.0


@pytest.mark.parametrize("zero_deg", [-1.0, 1.0])
def test_angle_sensor_offset_learning(zero_deg):
    noise = SensorNoise(map_m=0.0, angle_zero_deg=zero_deg)
    _, mean, greatest = drive(path_along(np.zeros(300)), before_m=8.0, noise=noise)
    assert abs(mean) <= 0.3
    assert greatest <= 1.0


@pytest.mark.parametrize(("offset_m", "heading_deg", "max_m"), [
    (0.3, 0.0, 5.0), (-0.5, 0.0, 5.0), (1.0, -30.0, 5.0), (0.3, -45.0, 10.0), (3.0, 0.0, 10.0),
])  # fmt: skip
def test_line_acquisition_at_3_kmh(offset_m, heading_deg, max_m):
    """From engagement to where |offset| ≤ 2.5 cm and |heading| ≤ 1° hold for 10 m (T14-6.6.4)."""
    path = path_along(np.zeros(400), 0.833)
    yaw = math.radians(heading_deg)
    plant = Plant(x=3.0, y=offset_m, yaw=yaw, speed=0.833, noise=SensorNoise(map_m=0.003))
    track = plant.run(path, stop=lambda p, _: p.x > 23.5)
    offset, _ = true_offsets(track, path)
    off = (np.abs(offset) > 0.025) | (np.abs(track.yaw_rad) > math.radians(1.0))
    first = int(np.flatnonzero(off).max()) + 1
    assert track.x_m[-1] - track.x_m[first] >= 10.0
    assert math.hypot(track.x_m[first] - 3.0, track.y_m[first] - offset_m) <= max_m


def test_map_pose_jump():
    path = path_along(np.zeros(600), 1.94)
    plant = Plant(noise=SensorNoise(map_m=0.0), ground=FIELD)
    plant.run(path, stop=lambda p, _: p.x > 20.0)
    before = plant.control_command.curvature_radpm
    plant.jump = (0.0, 0.2)
    track = plant.run(path, stop=lambda p, _: p.x > 45.0)
    late = [w.curvature_radpm for w, x in zip(track.commands, track.x_m, strict=True) if x > 20.0]
    assert max(abs(k - before) for k in late) < 0.06  # at once it would be 0.2 / (0.9 · 0.6) = 0.37
    assert track.y_m[-1] == pytest.approx(-0.2, abs=0.02)  # the jump is followed in the end


def test_curvature_limit():
    path = path_along(np.zeros(200), 0.833)
    for yaw in (0.0, 1.5, 3.0, -2.0):
        plant = Plant(x=2.0, y=2.5, yaw=yaw, speed=0.5)
        track = plant.run(path, until_s=8.0)
        assert all(abs(w.curvature_radpm) <= 1 / 4.6 + 1e-9 for w in track.commands)


def test_hydraulic_steering(monkeypatch):
    from configs.strict import CONFIGS, load
    from configs.vehicle import Vehicle

    monkeypatch.setattr(plant, "VEHICLE", load(Vehicle, CONFIGS / "machines" / "tractor_h.yaml"))
    valve = replace(Actuators(), dead_s=0.08, motor_s=0.06, rate_radps=0.6, backlash_deg=0.0)
    sigma, _, greatest = drive(path_along(np.zeros(350)), ground=FIELD, actuators=valve)
    assert sigma <= 1.0
    assert greatest <= 2.5
