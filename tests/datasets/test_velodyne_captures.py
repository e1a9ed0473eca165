"""Velodyne captures: a wall, the truth cloud of nebula, recorded models and positions, damaged and mixed packets."""

import math
import struct
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from datasets.importers.captures.continuity import LATE
from datasets.importers.captures.velodyne import GAP, recognize
from datasets.importers.formats import open_recording
from datasets.importers.recording import Recording
from messages.errors import LogError
from messages.sensors import GnssFix, GnssSolution, LidarScan
from tests.datasets.capture_samples import SECOND, write_packets
from tests.datasets.imported import reasons, scans_of
from tests.recordings import DATA, needs

LIDAR = DATA / "devices/lidar"
NS = 1_000_000_000
WALL_M = 12.0
ELEVATION_DEG = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15])
PACKET_S = 24 * 55.296e-6
PER_TURN = 75  # packets of 12 blocks of 0.4°


def data_packet(number: int, model: int = 0x22, mode: int = 0x37, wall_m: float = WALL_M) -> bytes:
    """Packet of a VLP-16 before the wall x = `wall_m`; intensity is the number of the channel."""
    blocks = b""
    firing, channel = np.mgrid[0:2, 0:16]
    for k in range(12):
        azimuth_deg = ((number * 12 + k) * 0.4) % 360.0
        at = np.radians(azimuth_deg + 0.4 * (firing * 55.296 + channel * 2.304) / 110.592)
        range_m = wall_m / np.where(np.cos(at) > 0.1, np.cos(at), np.inf) / np.cos(np.radians(ELEVATION_DEG))
        units = np.zeros((2, 16), np.dtype([("distance", "<u2"), ("intensity", "u1")]))
        units["distance"], units["intensity"] = np.round(range_m / 0.002), channel
        blocks += b"\xff\xee" + struct.pack("<H", round(azimuth_deg * 100) % 36_000) + units.tobytes()
    microseconds = round(SECOND % 3600 * 1e6 + number * PACKET_S * 1e6)
    return blocks + struct.pack("<I", microseconds % 3_600_000_000) + bytes([mode, model])


def position_packet(sentence: str) -> bytes:
    body = sentence.encode()
    total = 0
    for byte in body:
        total ^= byte
    return bytes(206) + (b"$" + body + b"*%02X\r\n" % total).ljust(306, b"\0")


def capture(path: Path, payloads: list[bytes]) -> Recording:
    sent = [(k * PACKET_S + 2e-3, "10.0.0.7", 2368, p) for k, p in enumerate(payloads)]
    return open_recording(write_packets(path / "x.pcap", sent))


def test_wall(tmp_path: Path) -> None:
    source = capture(tmp_path, [data_packet(k) for k in range(3 * PER_TURN)])
    found = scans_of(source)
    assert [s.source_type for s in source.description.sensors] == ["Velodyne VLP-16"]
    assert len(found) == 4  # cut at the rear: half, two whole, half
    for scan in found[1:3]:
        np.testing.assert_allclose(scan.xyz_m[:, 0], WALL_M, atol=0.02)
        assert scan.xyz_m[:, 1].min() < -50.0
        assert scan.xyz_m[:, 1].max() > 50.0
        elevation = np.degrees(np.arctan2(scan.xyz_m[:, 2], np.hypot(scan.xyz_m[:, 0], scan.xyz_m[:, 1])))
        np.testing.assert_allclose(elevation, ELEVATION_DEG[scan.intensity], atol=0.1)
        bearing = np.arctan2(scan.xyz_m[:, 1], scan.xyz_m[:, 0])
        assert np.corrcoef(bearing, scan.offset_s)[0, 1] < -0.999  # clockwise
        assert scan.offset_s.max() <= 0.0
    assert [s.stamp_ns for s in found] == sorted(s.stamp_ns for s in found)
    period_s = (found[2].stamp_ns - found[1].stamp_ns) * 1e-9
    assert period_s == pytest.approx(PER_TURN * PACKET_S, abs=1e-5)
    assert SECOND * NS < found[0].stamp_ns < SECOND * NS + NS // 10


@needs("devices/lidar/nebula-velodyne")
def test_truth_cloud_of_nebula() -> None:
    folder = LIDAR / "nebula-velodyne"
    truth = scans_of(open_recording(next(folder.glob("*.truth.pcd"))))[
        0
    ].xyz_m  # nebula: x at azimuth 0, y left, as ours; cut there
    found = scans_of(open_recording(folder / "vlp16.pcap"))
    everything = np.concatenate([s.xyz_m for s in found])
    assert cKDTree(everything).query(truth)[0].max() < 0.05
    distance_m = cKDTree(truth).query(found[-1].xyz_m)[0]
    assert (distance_m < 0.05).mean() > 0.999
    assert distance_m.max() < 0.1  # returns nearer than 0.5 m, which nebula leaves out


@needs("devices/lidar/mrpt-velodyne")
def test_recorded_hdl32() -> None:
    source = open_recording(LIDAR / "mrpt-velodyne/sample_velodyne_hdl32.pcap")
    found = scans_of(source)
    assert [s.source_type for s in source.description.sensors] == ["Velodyne HDL-32E"]
    # every nonzero distance of the 500 packets of 12 blocks of 32 channels
    assert sum(len(s.xyz_m) for s in found) == 146_705
    assert {len(np.unique(np.round(elevations(s), 0))) >= 30 for s in found} == {True}


def elevations(scan: LidarScan) -> np.ndarray:
    return np.degrees(np.arctan2(scan.xyz_m[:, 2], np.hypot(scan.xyz_m[:, 0], scan.xyz_m[:, 1])))


@needs("devices/lidar/rust-lidar-utils")
def test_recorded_position() -> None:
    received = list(open_recording(LIDAR / "rust-lidar-utils/velodyne_vlp32.pcap").read())
    (fix,) = [m for _, _, m in received if isinstance(m, GnssFix)]
    assert math.degrees(fix.latitude_rad) == pytest.approx(37 + 8.3443 / 60)
    assert math.degrees(fix.longitude_rad) == pytest.approx(-121 - 39.4299 / 60)
    assert fix.solution is GnssSolution.SBAS
    assert fix.satellites is None


@pytest.mark.parametrize(
    ("sentence", "text"),
    [
        ("GPVTG,1,T,,,2,N,3,K,A", "without position and time"),
        ("GPXYZ,1", "GPXYZ|XYZ"),
        ("GPGGA,250000,4800,N,1100,E,1,08,1.0,500,M,0,M,,", "250000|time"),
    ],
)
def test_unreadable_sentences_are_counted(tmp_path: Path, sentence: str, text: str) -> None:
    good = position_packet("GPGGA,120000,4800.0,N,01100.0,E,1,08,1.0,500,M,0,M,,")
    source = capture(tmp_path, [good, position_packet(sentence), good[:206] + b"$GPGGA*00" + good[215:]])
    ((_, topic, fix),) = source.read()
    assert topic == "gnss/10_0_0_7_2368"
    assert fix.satellites == 8
    assert sum(reasons(source).values()) == 2
    assert abs(fix.stamp_ns - SECOND * NS) < 86_400 * NS


def count_returns(payload: bytes) -> int:
    units = np.frombuffer(payload[:1200], np.uint8).reshape(12, 100)[:, 4:].reshape(-1, 3)
    return int(units[:, :2].any(axis=1).sum())


MISSING = "packet missing at azimuth {}° to {}°"
TURN = [data_packet(k) for k in range(PER_TURN)]
COUNT = sum(count_returns(p) for p in TURN)


@pytest.mark.parametrize(
    ("change", "points", "expected"),
    [
        (lambda p: p, COUNT, {}),
        (lambda p: p[:10] + p[20:], None, {MISSING.format(0, 90): 9, MISSING.format(90, 180): 1}),
        (lambda p: [*p[:5], p[6], p[5], *p[7:]], COUNT, {}),
        (lambda p: [p[k ^ 1] for k in range(PER_TURN // 2 * 2)] + p[PER_TURN // 2 * 2 :], COUNT, {}),
        (lambda p: [q for q in p for _ in range(2)], COUNT, {"repeated datagram": PER_TURN}),
        (
            lambda p: [q for k in range(len(p)) for q in (p[k], p[max(0, k - 3)])],
            COUNT,
            {"repeated datagram": PER_TURN},
        ),
        (lambda p: [*p[:5], *p[6:12], p[5], *p[12:]], None, {LATE: 1, MISSING.format(0, 90): 1}),
        (lambda p: [*p, p[0][:-1]], COUNT, {"another Velodyne model in UDP datagrams of 1205 bytes is not read": 1}),
        (lambda p: [*p, b"\0" * 1206], COUNT, {"unknown content in UDP datagrams of 1206 bytes is not read": 1}),
        (
            lambda p: [*p, p[0][:-1] + b"\x77"],
            COUNT,
            {"another Velodyne model in UDP datagrams of 1206 bytes is not read": 1},
        ),
        (lambda p: [*p, p[0][:2] + b"\xff\xff" + p[0][4:]], COUNT, {"azimuth of 655.35°": 1}),
        (lambda p: [*p, p[7][:1200] + b"\xff" * 4 + p[7][1204:]], COUNT, {"time of 4294967295 µs after the hour": 1}),
        (lambda p: [*p[:7], p[7][:1200] + bytes(4) + p[7][1204:], *p[8:]], COUNT, {GAP: 2}),
        (lambda p: p[:1], None, {}),
        (lambda p: [data_packet(0, wall_m=0.0)], 0, {}),
    ],
    ids=[
        "whole",
        "lost",
        "order",
        "swapped",
        "twice",
        "again",
        "late",
        "short",
        "zeros",
        "model",
        "azimuth",
        "time",
        "time back",
        "one",
        "no return",
    ],
)
def test_damaged_streams(tmp_path: Path, change: Any, points: int | None, expected: dict[str, int]) -> None:
    source = capture(tmp_path, change(TURN))
    found = scans_of(source)
    total = sum(len(s.xyz_m) for s in found)
    assert total == points if points is not None else 0 < total < COUNT
    assert reasons(source) == expected
    assert all(np.isfinite(s.xyz_m).all() and (np.abs(s.offset_s + 0.1) <= 0.1).all() for s in found)
    assert all(abs(s.stamp_ns - SECOND * NS) < NS for s in found)


def test_models_mixed_on_one_port(tmp_path: Path) -> None:
    mixed = [q for k in range(PER_TURN) for q in (data_packet(k), data_packet(k, 0x24))]
    source = capture(tmp_path, mixed)
    assert [(s.topic, s.source_type) for s in source.description.sensors] == [
        ("lidar/10_0_0_7_2368", "Velodyne VLP-16"),
        ("lidar/10_0_0_7_2368_2", "Velodyne Puck Hi-Res"),
    ]
    counts = Counter(topic for _, topic, _ in source.read())
    assert counts == {"lidar/10_0_0_7_2368": 2, "lidar/10_0_0_7_2368_2": 2}


def test_recognition_of_other_datagrams() -> None:
    assert recognize(b"") is None
    assert recognize(bytes(512)) is None
    assert recognize(TURN[0][:100] + b"\0" + TURN[0][101:]) is None
    assert recognize(TURN[0]) == "Velodyne VLP-16"


@pytest.mark.parametrize("seed", range(10))
def test_random_bytes_in_packets(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    sent = [bytearray(p) for p in TURN]
    for packet in sent[1:]:
        at = int(random.integers(0, 1186))
        packet[at : at + 20] = random.bytes(20)
    found = scans_of(capture(tmp_path, [bytes(p) for p in sent]))
    assert all(np.isfinite(s.xyz_m).all() for s in found)


def test_nothing_but_damaged_packets_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="unknown content in UDP datagrams of 1206 bytes is not read"):
        capture(tmp_path, [bytes(1206)] * 3)
