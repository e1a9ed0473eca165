"""Samples of real recordings that every clone contains: scan, NMEA, CAN and bag, read through the public importers."""

import json
import math
from collections import Counter

import numpy as np
import pytest

from datasets.importers.formats import open_recording
from messages.command import CanFrames
from messages.sensors import GnssFix, GnssSolution, ImuSample, LidarScan
from tests.recordings import SAMPLES


def test_lidar_scan() -> None:
    ((_, topic, scan),) = open_recording(SAMPLES / "lidar/qt64.pcd").read()
    assert isinstance(scan, LidarScan)
    assert topic == "lidar/pcd"
    assert scan.points_m.shape == (34158, 3)
    raw = (SAMPLES / "lidar/qt64.pcd").read_bytes().partition(b"DATA binary\n")[2]
    np.testing.assert_array_equal(scan.points_m, np.frombuffer(raw, np.float32).reshape(-1, 3))


def test_candump() -> None:
    path = SAMPLES / "can/think_city.log"
    messages = [message for _, _, message in open_recording(path).read()]
    frames = [frame for message in messages if isinstance(message, CanFrames) for frame in message.frames]
    lines = path.read_text().split("\n")[:-1]
    assert len(frames) == len(lines) == 3000
    for frame, line in zip(frames, lines, strict=True):
        assert line.split()[2] == f"{frame.identifier:03X}#{frame.data.hex().upper()}"


def test_ros1_bag() -> None:
    messages = list(open_recording(SAMPLES / "bag/jackal.bag").read())
    counts = Counter(topic for _, topic, _ in messages)
    assert counts == {"imu/imu_data": 3061, "odom/jackal_velocity_controller_odom": 3060}
    gravity = [m.acceleration_mps2 for _, _, m in messages if isinstance(m, ImuSample)]
    assert np.linalg.norm(np.mean(gravity, axis=0)) == pytest.approx(9.81, abs=0.3)


def test_nmea_fixes_agree_with_gpsd() -> None:
    recording = open_recording(SAMPLES / "gnss/nmea_rtk.log")
    fixes = [message for _, _, message in recording.read() if isinstance(message, GnssFix)]
    reference = [json.loads(line) for line in (SAMPLES / "gnss/nmea_rtk.tpv.jsonl").read_text().splitlines()]
    assert not any(row.skipped for row in recording.table())
    assert {fix.solution for fix in fixes} >= {GnssSolution.SBAS}
    expected = np.array([(r["lat"], r["lon"], r["altHAE"]) for r in reference])
    for fix in fixes:
        place = math.degrees(fix.latitude_rad), math.degrees(fix.longitude_rad), fix.height_m
        assert (np.abs(expected - place) <= (2e-9, 2e-9, 2e-3)).all(axis=1).any(), place
    assert len(fixes) == (SAMPLES / "gnss/nmea_rtk.log").read_bytes().count(b"RMC,")
