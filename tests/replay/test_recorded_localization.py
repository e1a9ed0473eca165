"""The localizer on GNSS, IMU and odometry of imported recordings, with and without a lidar."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.long_drive import VEHICLE, odometry, write_drive
from configs.strict import CONFIGS
from messages.errors import LogError
from runtime.replay.prepare import load_configuration, prepare
from runtime.replay.recorded_localization import motion_difference, wheel_sample
from runtime.replay.trajectory import OdometrySamples
from tests.recordings import DATA, SAMPLES, needs
from validation.obstacle_stop.conditions import load_conditions

CONFIGURATION = load_configuration(load_conditions(None))
HUSKY = "robot-localization-bags/test/test1.bag"
GNSS_AND_IMU = """
  gnss:
    main: {mount: {xyz_m: [0.5, 0.0, 1.9]}, has_heading: false, rate_hz: 10, sigma_horizontal_m: 0.02,
      sigma_vertical_m: 0.03, sigma_heading_deg: 1.0}
  imu: {mount: {xyz_m: [0.0, 0.0, 0.5]}, rate_hz: 100, gyro_noise_dps_rthz: 0.005, gyro_bias_dph: 4.0,
    gyro_range_dps: 400, accelerometer_noise_ug_rthz: 60, accelerometer_bias_mg: 1.0, accelerometer_range_g: 6}
  wheels: {topic: odom, rate_hz: 50, speed_sigma_mps: 0.01, angle_sigma_deg: 0.1}
"""


def test_localizer_on_a_recording_without_fixes(tmp_path: Path) -> None:
    """A Jackal with IMU and wheel odometry that sets off after one second, before the initial tilt."""
    vehicle = tmp_path / "vehicle.yaml"
    husky = (CONFIGS / "vehicles" / "husky.yaml").read_text()
    vehicle.write_text(husky.replace("      topic: /fix\n", "").replace("/husky_velocity", "/jackal_velocity"))
    with pytest.raises(LogError, match="no lidar topic") as error:
        prepare(SAMPLES / "bag" / "jackal.bag", None, vehicle, CONFIGURATION)
    assert "no fixes; 0 odometries, 0 poses in map; the initial tilt, which needs a standstill" in str(error.value)
    assert "samples dropped" not in str(error.value)  # all 6,121 were read by the localizer


@needs(HUSKY)
def test_localizer_on_recorded_fixes_of_husky() -> None:
    with pytest.raises(LogError, match="no lidar topic") as error:
        prepare(DATA / HUSKY, None, CONFIGS / "vehicles" / "husky.yaml", CONFIGURATION)
    text = str(error.value)
    assert "989 of 989 fixes usable" in text
    assert int(text.partition("odometries, ")[2].partition(" poses")[0]) > 3500  # of 3,953 in 395 s
    median_m = float(text.partition("in 10 s ")[2].partition(" m")[0])
    assert 0.0 < median_m < 0.3


def test_localizer_beside_a_lidar(tmp_path: Path) -> None:
    """Of a generated drive whose odometry is true, the localizer's differs by the noise of the IMU only."""
    log, vehicle = tmp_path / "drive.mcap", tmp_path / "vehicle.yaml"
    write_drive(log, 20.0)
    vehicle.write_text(VEHICLE + GNSS_AND_IMU)
    prepared = prepare(log, None, vehicle, CONFIGURATION)
    assert prepared.odometry.topic == "odom/wheels"
    note = prepared.localization
    assert note is not None
    assert "200 of 200 fixes usable" in note
    assert float(note.partition("in 10 s ")[2].partition(" m")[0]) < 0.2
    assert note in prepared.inspection_table()["notes"]


def test_vehicle_without_gnss_has_no_localizer(tmp_path: Path) -> None:
    log, vehicle = tmp_path / "drive.mcap", tmp_path / "vehicle.yaml"
    write_drive(log, 3.0)
    vehicle.write_text(VEHICLE)
    assert prepare(log, None, vehicle, CONFIGURATION).localization is None


def test_difference_of_motions() -> None:
    """One odometry runs 2 % faster than the other, in another frame and at other times."""
    true, fast = OdometrySamples(), OdometrySamples()
    turned = np.array([[0.0, -1, 0, 5], [1, 0, 0, 7], [0, 0, 1, 0], [0, 0, 0, 1]])
    for k in range(1500):
        one = odometry(10.0 + 0.02 * k)
        true.add(one)
        T = one.T_odom_base.copy()
        T[:2, 3] *= 1.02
        if k % 7 == 0:
            fast.add(replace(one, T_odom_base=turned @ T))
    median_m, most_m = motion_difference(fast, true) or (0.0, 0.0)
    assert median_m == pytest.approx(0.02 * 30.0, rel=0.05)
    assert most_m >= median_m
    assert motion_difference(true, true) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert motion_difference(true, OdometrySamples()) is None


def test_wheel_sample_of_an_odometry() -> None:
    one = replace(odometry(20.0), speed_mps=2.0, yaw_rate_radps=0.4)
    assert math.tan(wheel_sample(one, 2.5).steering_angle_rad) / 2.5 == pytest.approx(0.2)
    assert wheel_sample(replace(one, speed_mps=0.0), 2.5).steering_angle_rad == 0.0
