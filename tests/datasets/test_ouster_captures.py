"""Ouster captures: digests of Ouster, geometry of a wall and of ouster-sdk, lost and foreign packets, metadata."""

import hashlib
import json
import math
import shutil
import struct
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.importers.captures.devices import Stream
from datasets.importers.captures.ouster import OusterLidar, beams, open_decoder, recognize
from datasets.importers.captures.ouster_format import ENCODER, PROFILES, read_metadata
from datasets.importers.formats import open_recording
from datasets.importers.packet_captures import open_capture
from messages.errors import LogError
from messages.sensors import ImuSample, LidarScan
from tests.datasets.capture_samples import SECOND, Packet, write_packets
from tests.recordings import DATA, needs

SDK = DATA / "devices/lidar/ouster-sdk"
NS = 1_000_000_000
SINGLE = "RNG19_RFL8_SIG16_NIR16"
PIXELS, COLUMNS = 16, 64
WALL_M = 12.0
AZIMUTH_DEG = np.tile([3.0, 1.0, -1.0, -3.0], 4)
ALTITUDE_DEG = np.linspace(15.0, -15.0, PIXELS)
# XYZ (m) of ouster-sdk 1.0.1 (`XYZLut`, range 50 m, first and last pixel) at pixel 0 of column 0 and the last pixel of
# column W // 3; the largest difference of all pixels and columns of these files was 1e-13 m.
REFERENCE = {
    "metadata/2_0_0_os1-991913000010-64.json": [
        [-47.81552293, 2.56634513, 14.42494297],
        [21.60502351, 42.74733043, -14.31080112],
    ],
    "pcaps/OS-0-128-U1_v2.3.0_1024x10.json": [
        [-34.22905052, 6.79687234, 35.8314571],
        [10.99549308, 32.78249627, -36.06806099],
    ],
    "pcaps/OS-0-32-U1_v2.2.0_1024x10.json": [
        [-36.0012528, -1.82234309, 34.67451384],
        [15.06591391, 31.71968351, -35.54542054],
    ],
    "pcaps/OS-1-64_sensor_config_reduced.json": [
        [-47.88032877, 2.60920566, 14.20002832],
        [21.52313912, 42.76867305, -14.37012808],
    ],
    "pcaps/same_ports.2.json": [
        [-46.54151946, 3.38398026, 17.98962854],
        [21.65464225, 45.06717412, -0.11212587],
    ],
    "pcaps/windowed_frame1_0.json": [
        [-33.99231217, 6.50367994, 36.1102565],
        [11.20211721, 33.26756795, -35.55766647],
    ],
}


def metadata(profile: str = "RNG19_RFL8_SIG16_NIR16", **changes: Any) -> dict[str, Any]:
    form = {"pixels_per_column": PIXELS, "columns_per_packet": 16, "columns_per_frame": COLUMNS}
    return {
        "prod_line": "OS-1-16", "prod_sn": "77", "lidar_mode": "64x10",
        "beam_altitude_angles": ALTITUDE_DEG.tolist(), "beam_azimuth_angles": AZIMUTH_DEG.tolist(),
        "lidar_origin_to_beam_origin_mm": 15.806,
        "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1],
        "data_format": form | {"udp_profile_lidar": profile},
    } | changes  # fmt: skip


def wall_ranges() -> np.ndarray:
    """Ranges (COLUMNS, PIXELS) in mm to the wall x = WALL_M of the sensor frame; 0 = no return.

    Solved by geometry: the beam starts 15.806 mm from the axis in the direction of the encoder, and the range counts
    from the axis along beam origin and beam.
    """
    encoder = 2.0 * math.pi * (1.0 - np.arange(COLUMNS) / COLUMNS)[:, None]
    azimuth = encoder - np.radians(AZIMUTH_DEG)
    forward = -np.cos(azimuth) * np.cos(np.radians(ALTITUDE_DEG))  # the lidar frame is turned by 180°
    start = -0.015806 * np.cos(encoder)
    with np.errstate(divide="ignore"):
        range_m = (WALL_M - start) / forward + 0.015806
    return np.where((forward > 0.05) & (range_m < 200.0), np.round(range_m * 1e3), 0).astype(np.uint64)


def lidar_packets(profile: str, ranges: np.ndarray, frame: int = 5, start_ns: int = 10**12) -> list[bytes]:
    """Packets of one frame; reflectivity is the number of the pixel."""
    words, layout = PROFILES[profile]
    pixels = np.zeros((COLUMNS, PIXELS, words), np.uint32)
    values = {"RANGE": ranges, "RANGE2": ranges // 2, "REFLECTIVITY": np.arange(PIXELS) + 0 * ranges}
    for name, (word, _, shift) in layout.items():
        value = values[name.removesuffix("2") if name == "REFLECTIVITY2" else name].astype(np.uint64)
        pixels[..., word] |= (value >> np.uint64(shift) if shift >= 0 else value << np.uint64(-shift)).astype(np.uint32)
    out = []
    for first in range(0, COLUMNS, 16):
        columns = b"".join(
            column(profile, m, frame, start_ns + m * 1_000_000, pixels[m]) for m in range(first, first + 16)
        )
        out.append(header(profile, frame) + columns + (b"" if profile == "LEGACY" else bytes(32)))
    return out


def header(profile: str, frame: int) -> bytes:
    if profile == "LEGACY":
        return b""
    serial = (77).to_bytes(5, "little")
    if profile.startswith("FUSA"):
        return (b"\1\0\0\0" + struct.pack("<I", frame) + bytes(3) + serial).ljust(32, b"\0")
    return (struct.pack("<HH", 1, frame) + bytes(3) + serial).ljust(32, b"\0")


def column(profile: str, number: int, frame: int, time_ns: int, pixels: np.ndarray) -> bytes:
    if profile == "LEGACY":
        return (
            struct.pack("<QHHI", time_ns, number, frame, number * ENCODER // COLUMNS) + pixels.tobytes() + b"\xff" * 4
        )
    return struct.pack("<QHH", time_ns, number, 1) + pixels.tobytes()


def capture(folder: Path, packets: list[bytes], values: dict[str, Any] | None = None) -> Path:
    (folder / "x.json").write_text(json.dumps(metadata() if values is None else values))
    sent: list[Packet] = [(k * 1e-3, "10.0.0.7", 7502, p) for k, p in enumerate(packets)]
    return write_packets(folder / "x.pcap", sent)


def scans(path: Path) -> tuple[list[LidarScan], dict[str, int]]:
    source = open_recording(path)
    found = [m for _, _, m in source.read() if isinstance(m, LidarScan)]
    return found, {reason: count for row in source.table() for reason, count in row.reasons.items()}


@pytest.mark.parametrize("profile", list(PROFILES))
def test_wall(tmp_path: Path, profile: str) -> None:
    ranges = wall_ranges()
    path = capture(tmp_path, lidar_packets(profile, ranges), metadata(profile))
    ((scan,), _) = scans(path)
    count = int((ranges > 0).sum())
    near = (ranges // 8 // 2 if "RNG15" in profile else ranges // 2) > 0
    assert len(scan.xyz_m) == count + (int(near.sum()) if "RANGE2" in PROFILES[profile][1] else 0)
    step_m = 0.008 if "RNG15" in profile else 0.001
    np.testing.assert_allclose(scan.xyz_m[:count, 0], WALL_M, atol=step_m)
    assert scan.xyz_m[:count, 1].min() < -30.0
    assert scan.xyz_m[:count, 1].max() > 30.0
    _, pixel = np.nonzero(ranges)
    np.testing.assert_array_equal(scan.intensity[:count], pixel)
    assert (np.diff(scan.xyz_m[:count][pixel == 3, 1]) < 0).all()  # clockwise, from left to right
    assert scan.stamp_ns == SECOND * NS + 3_000_000  # the clock of the sensor is not that of the capture
    assert scan.offset_s.min() >= -0.063
    assert scan.offset_s.max() <= 0.0


def test_range_beyond_16_bits_does_not_wrap(tmp_path: Path) -> None:
    ranges = np.zeros((COLUMNS, PIXELS), np.uint64)
    ranges[0, 8] = 240_000
    ((scan,), _) = scans(capture(tmp_path, lidar_packets(SINGLE, ranges)))
    assert np.linalg.norm(scan.xyz_m) == pytest.approx(240.0, abs=0.05)


@pytest.mark.parametrize(("name", "expected"), REFERENCE.items())
@needs("devices/lidar/ouster-sdk")
def test_points_equal_those_of_ouster_sdk(name: str, expected: list[list[float]]) -> None:
    directions, offsets = beams(read_metadata(SDK / name))
    points = directions * 50.0 + offsets
    np.testing.assert_allclose([points[0, 0], points[len(points) // 3, -1]], expected, atol=1e-7)


def digest(values: np.ndarray, kind: str) -> str:
    return hashlib.md5(values.astype(kind).tobytes()).hexdigest()


@pytest.mark.parametrize("name", ["OS-0-128-U1_v2.3.0_1024x10", "OS-0-32-U1_v2.2.0_1024x10"])
@needs("devices/lidar/ouster-sdk")
def test_digests_of_ouster(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    complete = []
    original = OusterLidar._scan

    def observed(self: OusterLidar) -> LidarScan:
        complete.append((self._frame_id, self.columns.copy(), self.metadata.format))
        return original(self)

    monkeypatch.setattr(OusterLidar, "_scan", observed)
    path = SDK / "pcaps" / f"{name}.pcap"
    (scan,) = [m for _, _, m in open_recording(path).read() if isinstance(m, LidarScan)]
    ((frame, column, form),) = complete
    fields = form.fields(column["pixels"])
    kinds = {k: "u4" if k.startswith("RANGE") else "u1" for k in fields}
    found = {k: digest(v.T, kinds[k]) for k, v in fields.items()} | {
        "FRAME_ID": str(frame),
        "TIMESTAMP": digest(column["timestamp_ns"], "u8"),
        "STATUS": digest(column["status"], "u8"),
        "MEASUREMENT_ID": digest(column["measurement"], "u2"),
    }
    (expected,) = json.loads((SDK / "pcaps" / f"{name}_digest.json").read_text())["scans"]
    assert found == {k: v for k, v in expected.items() if k in found}
    assert len(scan.xyz_m) == sum(np.count_nonzero(v) for k, v in fields.items() if k.startswith("RANGE"))


@needs("devices/lidar/ouster-sdk")
def test_reference_capture() -> None:
    source = open_recording(SDK / "pcaps/OS-1-128_v2.3.0_1024x10_lb_n3.pcap")
    received = list(source.read())
    assert Counter(type(m) for _, _, m in received) == {LidarScan: 3, ImuSample: 30}
    assert [t for t, _, _ in received] == sorted(t for t, _, _ in received)
    counts = [len(m.xyz_m) for _, _, m in received if isinstance(m, LidarScan)]
    assert counts == [107_647, 107_357, 107_532]  # as ouster-sdk 1.0.1
    level = np.mean([m.acceleration_mps2 for _, _, m in received if isinstance(m, ImuSample)], axis=0)
    assert level[2] == pytest.approx(9.81, abs=0.1)  # on a car that brakes
    for receive_ns, _, message in received:
        assert abs(receive_ns - message.stamp_ns) < NS // 10
    (mount,) = source.description.extrinsics
    assert (mount.parent, mount.child) == ("os_sensor", "os_imu")
    np.testing.assert_allclose(mount.T_parent_child[:3, 3], [0.006253, -0.011775, 0.007645], atol=1e-9)


@needs("devices/lidar/ouster-sdk")
def test_two_sensors_on_one_port() -> None:
    for name in ("same_ports", "same_ports_legacy", "same_ports_nonlegacy"):
        source = open_recording(SDK / "pcaps" / f"{name}.pcap")
        lidars = [s for s in source.description.sensors if s.topic.startswith("lidar")]
        notes = " ".join(source.description.notes)
        assert {s.frame for s in lidars} == {"os_sensor", "os_sensor_2"}
        assert "OS-1-64-AH" in notes
        assert "OS-0-128" in notes
        assert Counter(topic for _, topic, _ in source.read()) == {s.topic: 1 for s in source.description.sensors}


@needs("devices/lidar/ouster-sdk")
def test_legacy_capture_of_the_first_firmware(tmp_path: Path) -> None:
    name = "OS-1-64_1024x10_fw20"
    with pytest.raises(LogError, match=rf"needs the metadata of the sensor as {name}.json"):
        open_recording(SDK / "pcaps" / f"{name}.pcap")
    shutil.copy(SDK / "pcaps" / f"{name}.pcap", tmp_path)
    shutil.copy(SDK / "pcaps/OS-1-64_sensor_config_reduced.json", tmp_path / f"{name}.json")
    source = open_recording(tmp_path / f"{name}.pcap")
    assert "lacks packet format LEGACY" in " ".join(source.description.notes)
    (scan,) = [m for _, _, m in source.read() if isinstance(m, LidarScan)]
    assert len(scan.xyz_m) == 16_749  # as ouster-sdk 1.0.1


def test_columns_of_a_turn_that_the_encoder_contradicts(tmp_path: Path) -> None:
    values = metadata("LEGACY")
    values["data_format"] |= {"columns_per_frame": 2 * COLUMNS}
    with pytest.raises(LogError, match=f"columns_per_frame {2 * COLUMNS}, the packets have {COLUMNS}"):
        open_recording(capture(tmp_path, lidar_packets("LEGACY", wall_ranges()), values))


# --- damaged and foreign packets


MISSING = "frame with missing columns"
JUMP = "times of the columns of a packet differ by more than 1 s"


def packets(count: int = 3, frame: int = 0, start_ns: int = 10**12) -> list[bytes]:
    """Packets of successive frames, 0.1 s each."""
    return [p for k in range(count) for p in lidar_packets(SINGLE, wall_ranges(), frame + k, start_ns + k * 10**8)]


FULL = int((wall_ranges() > 0).sum())


@pytest.mark.parametrize(
    ("change", "scans_left", "points", "reasons"),
    [
        (lambda p: p, 3, 3 * FULL, {}),
        (lambda p: p[:5] + p[6:], 3, None, {MISSING: 1}),  # lost columns
        (lambda p: [*p[:4], p[5], p[4], *p[6:]], 3, 3 * FULL, {}),  # out of order
        (lambda p: [*p[:6], p[3], *p[6:]], 3, 3 * FULL, {"repeated datagram": 1}),
        (lambda p: [q for q in p for _ in range(2)], 3, 3 * FULL, {"repeated datagram": 12}),
        (lambda p: [p[0], *p[:2], *p], 3, 3 * FULL, {"repeated datagram": 3}),
        (lambda p: p[8:] + p[:4], 1, FULL, {"packet of frame 0 after the start of frame 2": 4}),
        (lambda p: [*p, p[3][:-1], p[3] + b"\0", b"", b"\0" * 48], 3, 3 * FULL, {}),
        (lambda p: [*p[:2], p[2][:32] + b"\xff" * (len(p[2]) - 32), *p[3:]], 3, None, {}),
        (lambda p: [bytes([9]) + q[1:] if k == 2 else q for k, q in enumerate(p)], 3, None, {}),
        (lambda p: [*p[:2], p[2][:32] + b"\x7f" * 8 + p[2][40:], *p[3:]], 3, None, {JUMP: 1}),
        (lambda p: [*p[:6], *packets(1, 1, 0)[2:], *p[8:]], 4, 3 * FULL, {}),
        (lambda p: p[:1], 1, None, {MISSING: 1}),
        (lambda p: p + packets(3, 0, 0), 6, 6 * FULL, {}),
        (lambda p: p + packets(3, 900, 0), 6, 6 * FULL, {}),  # the sensor restarts, its time is zero again
    ],
    ids=["whole", "lost", "order", "late", "twice", "repeat", "older", "sizes", "garbage", "type", "column time",
         "time back", "one", "restart", "restart of numbers"],
)  # fmt: skip
def test_damaged_streams(
    tmp_path: Path, change: Any, scans_left: int, points: int | None, reasons: dict[str, int]
) -> None:
    if change(packets()) == packets() * 2:
        sent = packets() + [
            p for k in range(3) for p in lidar_packets("RNG19_RFL8_SIG16_NIR16", wall_ranges(), k + 900, k)
        ]
    else:
        sent = change(packets())
    found, table = scans(capture(tmp_path, sent))
    assert len(found) == scans_left
    total = sum(len(s.xyz_m) for s in found)
    assert total == points if points is not None else 0 <= total < 3 * FULL
    assert {r: c for r, c in table.items() if r in reasons} == reasons
    assert all(np.isfinite(s.xyz_m).all() and (np.abs(s.offset_s + 0.1) <= 0.1).all() for s in found)


@pytest.mark.parametrize("seed", range(10))
def test_random_bytes_in_packets(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    sent = [bytearray(p) for p in packets()]
    for packet in sent:
        at = int(random.integers(0, len(packet) - 20))
        packet[at : at + 20] = random.bytes(20)
    found, _ = scans(capture(tmp_path, [bytes(packets()[0]), *map(bytes, sent)]))
    assert all(np.isfinite(s.xyz_m).all() for s in found)
    assert sum(len(s.xyz_m) for s in found) > FULL


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"beam_altitude_angles": []}, "0 altitude and 16 azimuth angles"),
        ({"beam_altitude_angles": ["x"] * 16}, "no metadata"),
        ({"beam_azimuth_angles": [math.inf] * 16}, "no list of angles"),
        ({"data_format": {"udp_profile_lidar": "NEW"}}, "UDP profile NEW is not one of"),
        ({"data_format": {}}, "no metadata"),
        ({"data_format": 7}, "no metadata"),
        ({"data_format": {"pixels_per_column": 16, "columns_per_packet": 16, "columns_per_frame": -1}}, "-1 per frame"),
        ({"prod_sn": "78"}, "of the sensor 78"),
        ({"lidar_to_sensor_transform": [1, 2, 3]}, "no metadata"),
    ],
)
def test_unsuitable_metadata_is_named(tmp_path: Path, values: dict[str, Any], text: str) -> None:
    path = capture(tmp_path, packets(1), metadata(**values))
    with pytest.raises(LogError, match=text):
        open_capture(path)


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff\xfe", b"{", b'{"a": 1}', b"7"])
def test_other_json_files_are_passed_over(tmp_path: Path, content: bytes) -> None:
    path = capture(tmp_path, packets(1))
    (tmp_path / "x.json").rename(tmp_path / "x.sensor.json")
    (tmp_path / "x.json").write_bytes(content)
    assert len(scans(path)[0]) == 1


def test_rule_for_the_name_of_the_metadata(tmp_path: Path) -> None:
    path = capture(tmp_path, packets(1))
    for name in ("x.1.json", "x_0.json", "sensor.json"):
        found = next(tmp_path.glob("*.json"))
        found.rename(tmp_path / name)
        assert name in " ".join(open_recording(path).description.notes)
    path = path.rename(tmp_path / "sensor_drive_2.pcap")
    (tmp_path / "other.json").write_text("{}")
    assert "sensor.json" in " ".join(open_recording(path).description.notes)
    path = path.rename(tmp_path / "drive.pcap")
    with pytest.raises(LogError, match=r"as drive.json beside it \(none found\)"):
        open_recording(path)


def test_recognition_of_other_datagrams() -> None:
    assert recognize(b"\0" * 48) is None
    assert recognize(struct.pack("<QQQ6f", 1, 2, 3, *[math.nan] * 6)) is None
    assert recognize(b"") is None
    assert recognize(bytes(8448)) is None
    with pytest.raises(LogError, match="needs the metadata"):
        open_decoder(Stream("a", 1, "Ouster lidar"), b"", Path("/nowhere/x.pcap"))


def test_two_sensors_of_one_address(tmp_path: Path) -> None:
    for name, serial in (("x.1.json", "77"), ("x.2.json", "78")):
        (tmp_path / name).write_text(json.dumps(metadata(prod_sn=serial, imu_to_sensor_transform=np.eye(4).tolist())))
    other = [p[:7] + b"\x4e" + p[8:] for p in packets(1)]
    imu = struct.pack("<QQQ6f", 10**12, 10**12, 10**12, 0, 0, 1, 0, 0, 0)
    sent = [(k * 1e-3, "10.0.0.7", 7502, p) for k, p in enumerate([*packets(1), *other])] + [
        (0.1, "10.0.0.7", 7503, imu)
    ]
    source = open_recording(write_packets(tmp_path / "x.pcap", sent))
    assert [s.frame for s in source.description.sensors] == ["os_sensor", "os_sensor_2", "os_imu"]
    assert source.description.extrinsics == ()  # of which sensor the IMU is, is unknown
    assert len(list(source.read())) == 3
