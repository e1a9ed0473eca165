"""Hesai captures: a wall for each model, the truth clouds of nebula, dual returns, angles, damaged packets."""

import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from datasets.importers.captures.continuity import LATE
from datasets.importers.captures.hesai import GAP, is_return, recognize
from datasets.importers.captures.hesai_models import MODELS, START, TAILS, Model
from datasets.importers.formats import open_recording
from datasets.importers.recording import Recording
from messages.errors import LogError
from tests.datasets.capture_samples import SECOND, write_packets
from tests.datasets.imported import reasons, scans_of
from tests.recordings import DATA, needs

FOLDER = DATA / "devices/lidar/nebula-hesai"
NS = 1_000_000_000
WALL_M = 12.0
STEP = 20  # azimuth between blocks, 0.01°
XT32 = next(m for m in MODELS if m.name == "PandarXT32")


def angles(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Elevation and azimuth of test units in degrees."""
    return np.linspace(15.0, -15.0, model.channels), np.tile([1.0, -1.0, 3.0, -3.0], model.channels // 4)


def data_packet(model: Model, number: int, mode: int = 0x37, time_s: float | None = None) -> bytes:
    """Packet before the wall x = WALL_M; reflectivity is the number of the channel."""
    out = np.zeros(1, model.dtype)[0]
    elevation, offset = (np.radians(a) for a in angles(model))
    returns = 2 if mode == 0x39 else 1
    azimuth = (np.arange(model.blocks) // returns + number * (model.blocks // returns)) * STEP % 36_000
    at = np.radians(azimuth * 0.01)[:, None] + offset
    range_m = WALL_M / np.where(np.cos(at) > 0.1, np.cos(at), np.inf) / np.cos(elevation)
    out["blocks"]["azimuth"] = azimuth
    out["blocks"]["channels"]["distance"] = np.round(range_m / 0.004)
    out["blocks"]["channels"]["reflectivity"] = np.arange(model.channels)
    if model.header == 0:
        out["blocks"]["start"] = 0xEEFF
    tail, at_s = bytearray(out["tail"].tobytes()), 0.3 + number * 1e-3 if time_s is None else time_s
    names = TAILS[model.tail]
    tail[names["mode"]] = mode
    tail[names["date"] : names["date"] + 6] = bytes([2023 - names["year"], 11, 14, 22, 13, 20])  # SECOND
    struct.pack_into("<I", tail, names["us"], round(at_s * 1e6))
    out["tail"] = np.frombuffer(bytes(tail), np.uint8)
    body = out.tobytes()
    if model.header == 8:
        body = START + bytes([model.channels, model.blocks, 0, 4, 0, 0]) + body[8:]
    elif model.header == 12:
        body = START + bytes([6, 1, 0, 0, model.channels, model.blocks, 0, 4, returns, 0]) + body[12:]
    return body + (b"" if model.header == 8 else struct.pack("<I", number))


def packets(model: Model, turns: float = 1.0, mode: int = 0x37) -> list[bytes]:
    returns = 2 if mode == 0x39 else 1
    count = round(turns * 36_000 / STEP * returns / model.blocks)
    return [data_packet(model, k, mode, 0.3 + k * model.blocks / returns * 5e-5) for k in range(count)]


def capture(folder: Path, model: Model, payloads: list[bytes]) -> Recording:
    rows = [f"{k + 1},{e},{a}" for k, (e, a) in enumerate(zip(*angles(model), strict=True))]
    (folder / "x.csv").write_text("\n".join(["Laser id,Elevation,Azimuth", *rows]))
    period_s = model.blocks * 5e-5
    sent = [(0.3 + k * period_s + 2e-3, "10.0.0.7", 2368, p) for k, p in enumerate(payloads)]
    return open_recording(write_packets(folder / "x.pcap", sent))


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_wall(tmp_path: Path, model: Model) -> None:
    source = capture(tmp_path, model, packets(model, 3.0))
    assert [s.source_type for s in source.description.sensors] == [f"Hesai {model.name}"]
    assert source.description.notes[0] == "10.0.0.7:2368: angles of x.csv"
    found = scans_of(source)
    assert len(found) == 4  # cut at the rear: half, two whole, half
    elevation_deg, _ = angles(model)
    for scan in found[1:3]:
        np.testing.assert_allclose(scan.xyz_m[:, 0], WALL_M, atol=0.003)
        assert scan.xyz_m[:, 1].min() < -50.0
        assert scan.xyz_m[:, 1].max() > 50.0
        elevation = np.degrees(np.arctan2(scan.xyz_m[:, 2], np.hypot(scan.xyz_m[:, 0], scan.xyz_m[:, 1])))
        np.testing.assert_allclose(elevation, elevation_deg[scan.intensity], atol=1e-3)
        bearing = np.arctan2(scan.xyz_m[:, 1], scan.xyz_m[:, 0])
        assert np.corrcoef(bearing, scan.offset_s)[0, 1] < -0.99  # clockwise
        assert scan.offset_s.max() <= 0.0
        assert scan.offset_s.min() > -0.1
    period_s = (found[2].stamp_ns - found[1].stamp_ns) * 1e-9
    assert period_s == pytest.approx(0.09, abs=5e-4)
    assert abs(found[0].stamp_ns - SECOND * NS - 0.345e9) < 2e6


@pytest.mark.parametrize(("name", "near"), [("40p", 0.3), ("qt64", 0.1), ("xt32", 0.05)])
@needs("devices/lidar/nebula-hesai")
def test_truth_clouds_of_nebula(name: str, near: float) -> None:
    truth = scans_of(open_recording(next(FOLDER.glob(f"{name}.*.truth.pcd"))))[0].xyz_m
    truth = np.stack([truth[:, 1], -truth[:, 0], truth[:, 2]], axis=1)  # nebula: y at azimuth 0, x right
    found = scans_of(open_recording(FOLDER / f"{name}.pcap"))
    everything = np.concatenate([s.xyz_m for s in found])
    assert cKDTree(everything).query(truth)[0].max() < 1e-4
    # The truth is one turn between azimuth 0 and 0, at the end of the capture: ours with the same times lie in it.
    turn = np.concatenate([s.xyz_m for s in found[-2:]])
    distance_m = cKDTree(truth).query(turn[np.linalg.norm(turn, axis=1) > near])[0]
    assert (distance_m < 0.05).mean() > 0.99


def test_returns_of_one_firing_are_kept_once() -> None:
    distance = np.array([[[5, 0, 7], [5, 9, 8], [1, 1, 0], [2, 1, 0]]], np.uint16)
    dual = is_return(distance, np.array([2]))
    assert dual[0].tolist() == [[True, False, True], [False, True, True], [True, True, False], [True, False, False]]
    assert is_return(distance, np.array([1])).sum() == np.count_nonzero(distance)
    triple = is_return(np.array([[[3], [4], [3], [6], [6], [6]]], np.uint16), np.array([3]))
    assert triple[0, :, 0].tolist() == [True, True, False, True, False, False]


def test_dual_returns(tmp_path: Path) -> None:
    single = sum(len(s.xyz_m) for s in scans_of(capture(tmp_path, XT32, packets(XT32))))
    dual = scans_of(capture(tmp_path, XT32, packets(XT32, mode=0x39)))
    assert sum(len(s.xyz_m) for s in dual) == single  # equal pairs


def test_firing_times() -> None:
    single, dual = XT32.firing_ns(1), XT32.firing_ns(2)
    assert single[7, 0] == 6_000
    assert single[7, 31] - single[7, 0] == 31 * 1_512
    assert single[0, 0] == 6_000 - 7 * 50_000
    assert dual[0, 0] == dual[1, 0] == 6_000 - 3 * 50_000


@needs("devices/lidar/nebula-hesai")
def test_rule_for_the_angles(tmp_path: Path) -> None:
    shutil.copy(FOLDER / "40p.pcap", tmp_path / "x.pcap")
    with pytest.raises(LogError, match=r"needs the angles of the Pandar40P as x\.csv beside it"):
        open_recording(tmp_path / "x.pcap")
    table = (FOLDER / "calibration/Pandar40P.csv").read_text()
    for text, error in (
        (table.replace("14.794", "nan"), "is not finite"),
        ("\n".join(table.splitlines()[:-1]), "angles of 39 channels"),
        (table.replace("Elevation", "Height"), "no table of channel"),
        (table.replace("\n3,", "\n4,"), "not numbered from 1"),
        ("", "no table"),
    ):
        (tmp_path / "x.csv").write_text(text)
        with pytest.raises(LogError, match=error):
            open_recording(tmp_path / "x.pcap")
    (tmp_path / "x.csv").unlink()
    (tmp_path / "Pandar-40P.csv").write_text(table)
    assert "angles of Pandar-40P.csv" in " ".join(open_recording(tmp_path / "x.pcap").description.notes)


def test_design_angles_are_noted(tmp_path: Path) -> None:
    capture(tmp_path, XT32, packets(XT32))
    (tmp_path / "x.csv").unlink()
    source = open_recording(tmp_path / "x.pcap")
    assert source.description.notes[0] == "10.0.0.7:2368: design angles of PandarXT32, not of the unit"
    assert len(scans_of(source)) == 2


TURN = packets(XT32)
MISSING = "packet missing at azimuth {}° to {}°"
UNKNOWN = "another Hesai model in UDP datagrams of {} bytes is not read"
TAIL = 12 + 8 * 130  # offset of the tail


@pytest.mark.parametrize(
    ("change", "count", "expected"),
    [
        (lambda p: p, 2, {}),
        (lambda p: p[:100] + p[140:], 2, {MISSING.format(90, 180): 13, MISSING.format(180, 270): 27}),
        (lambda p: [*p[:5], p[6], p[5], *p[7:]], 2, {}),
        (lambda p: [p[k ^ 1] for k in range(len(p) // 2 * 2)], 2, {}),
        (lambda p: [p[0], *p[2:9], p[1], *p[9:]], 2, {LATE: 1, MISSING.format(0, 90): 1}),
        (lambda p: [q for q in p for _ in range(2)], 2, {"repeated datagram": len(TURN)}),
        (lambda p: [*p, p[0][:-9]], 2, {UNKNOWN.format(1071): 1}),
        (lambda p: [*p, bytes(1080)], 2, {"unknown content in UDP datagrams of 1080 bytes is not read": 1}),
        (lambda p: [*p, p[0][:6] + b"\x11" + p[0][7:]], 2, {UNKNOWN.format(1080): 1}),
        (lambda p: [*p, p[0][:12] + b"\xff\xff" + p[0][14:]], 2, {"azimuth of 655.35°, return mode 0x37": 1}),
        (lambda p: [*p, p[0][: TAIL + 10] + b"\0" + p[0][TAIL + 11 :]], 2, {"azimuth of 1.40°, return mode 0x00": 1}),
        (lambda p: [*p, p[0][: TAIL + 14] + b"\x0d" + p[0][TAIL + 15 :]], 2, {"month must be in 1..12": 1}),
        (lambda p: [q[: TAIL + 13] + bytes(6) + q[TAIL + 19 :] for q in p], 2, {}),
        (lambda p: p + [data_packet(XT32, k, time_s=0.01 + k * 4e-4) for k in range(225)], 4, {GAP: 1}),
        (lambda p: p[:30] + p[190:], 2, {GAP: 1}),
        (lambda p: p[:1], 1, {}),
    ],
    ids=["whole", "lost", "order", "swapped", "late", "twice", "short", "zeros", "lasers", "azimuth", "mode", "month",
         "no date", "time back", "gap", "one"],
)  # fmt: skip
def test_damaged_streams(tmp_path: Path, change: Any, count: int, expected: dict[str, int]) -> None:
    source = capture(tmp_path, XT32, change(TURN))
    found = scans_of(source)
    assert len(found) == count
    total = reasons(source)
    assert {r: c for r, c in total.items() if "azimuth" not in r} == {
        r: c for r, c in expected.items() if "azimuth" not in r
    }
    assert sum(total.values()) == sum(expected.values())
    assert all(np.isfinite(s.xyz_m).all() and (s.offset_s <= 0.0).all() for s in found)
    assert all(abs(s.stamp_ns - SECOND * NS) < 2 * NS for s in found)


def test_missing_packets_by_their_sequence_numbers(tmp_path: Path) -> None:
    sent = [p[: XT32.dtype.itemsize] + (k + 7).to_bytes(4, "little") for k, p in enumerate(TURN)]
    source = capture(tmp_path, XT32, sent[:20] + sent[23:])
    assert len(scans_of(source)) == 2
    assert reasons(source) == {MISSING.format(0, 90): 3}


@pytest.mark.parametrize("seed", range(10))
def test_random_bytes_in_packets(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    sent = [bytearray(p) for p in TURN]
    for packet in sent[1:]:
        at = int(random.integers(0, 1060))
        packet[at : at + 20] = random.bytes(20)
    found = scans_of(capture(tmp_path, XT32, [bytes(p) for p in sent]))
    assert all(np.isfinite(s.xyz_m).all() for s in found)


def test_recognition_of_other_datagrams() -> None:
    assert recognize(b"") is None
    assert recognize(bytes(1262)) is None
    assert recognize(TURN[0]) == "Hesai PandarXT32"
