"""Calibrations on drawn plants against the truth: a drive along a line and back, and a standstill in the yard."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.recording import Recording
from calibration.result import CalibrationResult, NotEnough
from calibration.wizards import calibrate
from tests.calibration.driven import Trial, circles_at_the_stops, trial
from tests.simulation.simulated_farm import IMPLEMENT, machine_file

SEEDS = (1, 2, 3)
LIMITS = {  # largest standard deviation at which a value is worth to be stored
    "wheel_radius": 0.006, "steering_zero": 0.03, "imu_level": 0.08, "hitch_time": 0.03,
    "antenna_side": 0.03, "pto_time": 0.05,
}  # fmt: skip
SIGMAS = 3.5


@pytest.fixture(scope="module", params=SEEDS)
def driven(request: pytest.FixtureRequest) -> Trial:
    return trial(request.param)


def truth_of(found: Trial) -> dict[str, float]:
    """True values by their keys in the setup."""
    vehicle, drive = found.plant.vehicle, found.plant.models.machine.drive
    assert vehicle.sensors.imu is not None
    slip = drive.slip_per_traction * drive.rolling_resistance_mps2 / 9.80665
    radius_m = vehicle.drivetrain.wheel_radius_m * (1.0 + drive.wheel_radius_error)
    return {
        "vehicle.drivetrain.wheel_radius_m": radius_m / (1.0 + slip),
        "vehicle.sensors.wheels.angle_zero_deg": found.angle_zero_deg,
        "vehicle.sensors.imu.mount.rpy_deg.0": vehicle.sensors.imu.mount.rpy_deg[0],
        "vehicle.sensors.imu.mount.rpy_deg.1": vehicle.sensors.imu.mount.rpy_deg[1],
        "vehicle.sensors.gnss.main.mount.xyz_m.1": vehicle.sensors.gnss["main"].mount.xyz_m[1],
        "implement.pto_stop_s": run_down_s(found),
        "implement.lower_s": found.plant.implement.lower_s,
        "implement.lift_s": found.plant.implement.lift_s,
    }


def run_down_s(found: Trial) -> float:
    """Time in which a shaft that follows with a lag falls to 5 rpm, after a command that is sent every 0.1 s."""
    implement = found.plant.models.machine.implement
    return 0.05 + implement.pto_lag_s * math.log(implement.pto_rpm / 5.0)


def result_of(name: str, found: Trial, recording: Recording | None = None) -> CalibrationResult:
    return calibrate(name, recording or found.recording, found.vehicle, IMPLEMENT)


@pytest.mark.parametrize("name", LIMITS)
def test_a_drive_gives_the_true_value_within_its_error(driven: Trial, name: str) -> None:
    result, truth = result_of(name, driven), truth_of(driven)
    assert result.is_verified, result.ratio
    for one in result.estimates:
        assert one.sigma < LIMITS[name]
        assert abs(one.value - truth[one.key]) < SIGMAS * one.sigma, one
    assert np.isfinite(result.plot.points).all()
    assert np.isfinite(result.plot.line).all()


def test_all_seeds_together_are_nearer_to_the_truth_than_the_tape_measure() -> None:
    before, after = dict[str, list[float]](), dict[str, list[float]]()
    for seed in (4, 5, 6):
        found = trial(seed)
        truth = truth_of(found)
        for name in ("wheel_radius", "steering_zero", "imu_level", "hitch_time"):
            for one in result_of(name, found).estimates:
                before.setdefault(one.key, []).append(one.present - truth[one.key])
                after.setdefault(one.key, []).append(one.value - truth[one.key])
    for key, errors in before.items():
        assert np.hypot.reduce(after[key]) < 0.7 * np.hypot.reduce(errors), key


@pytest.mark.parametrize("seed", SEEDS)
def test_circles_at_both_stops_give_the_smallest_radius(seed: int) -> None:
    found = circles_at_the_stops(seed)
    result = result_of("steering_range", found)
    (one,) = result.estimates
    assert result.is_verified, result.ratio
    assert abs(one.value - found.smallest_radius_m) < 0.04, (one, found.smallest_radius_m)
    assert one.sigma < 0.02
    one_side = replace(found.recording, wheel=found.recording.wheel[found.recording.wheel[:, 0] < 16.0])
    with pytest.raises(NotEnough, match="at_both_stops_deg"):
        result_of("steering_range", found, one_side)


def test_a_zero_that_changes_in_the_trial_is_not_verified(driven: Trial) -> None:
    wheel = driven.recording.wheel.copy()
    way_m = np.cumsum(0.02 * wheel[:, 1])
    back = way_m > way_m[-1] - 22.0  # half of the way back
    wheel[back, 2] += math.radians(0.3)
    assert not result_of("steering_zero", driven, replace(driven.recording, wheel=wheel)).is_verified


def test_one_direction_is_not_enough(driven: Trial) -> None:
    at = 40.0  # on the way there
    arrays = {name: getattr(driven.recording, name) for name in ("imu", "wheel", "gnss", "machine", "command")}
    there = Recording(**{name: array[array[:, 0] < at] for name, array in arrays.items()}, scans={})
    for name in ("steering_zero", "imu_level", "antenna_side", "pto_time"):
        with pytest.raises(NotEnough):
            result_of(name, driven, there)


@pytest.mark.parametrize("name", [*LIMITS, "steering_range", "lidar_mount.front"])
def test_an_empty_recording_is_not_enough(name: str) -> None:
    empty = Recording(*(np.zeros((0, width)) for width in (7, 3, 8, 3, 3)), scans={})
    with pytest.raises(NotEnough):
        calibrate(name, empty, machine_file("tractor_e", ("lidar", "gnss", "imu", "wheels")), IMPLEMENT)


@pytest.fixture(scope="module", params=SEEDS)
def standing(request: pytest.FixtureRequest) -> Trial:
    return trial(request.param, ("lidar", "wheels", "gnss", "imu"), 8.0)


@pytest.mark.parametrize("name", ["front", "front_left", "front_right", "rear"])
def test_a_standstill_gives_the_mount_of_a_lidar(standing: Trial, name: str) -> None:
    result, true = result_of(f"lidar_mount.{name}", standing), standing.plant.vehicle.sensors.lidar[name].mount
    assert result.is_verified, result.ratio
    for one, truth in zip(result.estimates, (true.rpy_deg[0], true.rpy_deg[1], true.xyz_m[2]), strict=True):
        assert one.sigma < (0.01 if one.key.endswith("xyz_m.2") else 0.12)
        assert abs(one.value - truth) < SIGMAS * one.sigma, one


def test_a_lidar_that_moves_is_not_verified(standing: Trial) -> None:
    scans = standing.recording.scans["front"]
    half = len(scans) // 2
    turned = [scan @ np.array([[1.0, 0.0, -0.03], [0.0, 1.0, 0.0], [0.03, 0.0, 1.0]], np.float32) for scan in scans]
    moved = {"front": (*scans[:half], *turned[half:])}
    recording = replace(standing.recording, scans=moved)
    assert not result_of("lidar_mount.front", standing, recording).is_verified
