"""Containers and network layers of packet captures: all link types, damage, fragments; every real file answers."""

import struct
from pathlib import Path

import dpkt
import numpy as np
import pytest

from datasets.importers.captures.clock import SensorClock
from datasets.importers.captures.container import frames, is_capture
from datasets.importers.captures.network import MAX_PARTIAL, Network
from datasets.importers.formats import open_recording
from messages.errors import LogError
from tests.datasets.capture_samples import (
    SECOND,
    block,
    ethernet,
    fragments,
    interface,
    packet,
    section,
    write_packets,
    write_pcap,
)
from tests.recordings import DATA, needs

DEVICES = DATA / "devices"
LIDAR_FILES = sorted(p for p in (DEVICES / "lidar").rglob("*") if p.is_file()) if DEVICES.exists() else []
CAPTURES = sorted(p for p in DEVICES.rglob("*.pcap*") if p.suffix in (".pcap", ".pcapng")) if DEVICES.exists() else []
NS = 1_000_000_000
FRAME = ethernet("10.0.0.7", 2368, b"content")


def datagrams(path: Path) -> tuple[list[tuple[int, str, int, bytes]], list[str], dict[tuple[str, str], int]]:
    damages: list[str] = []
    network = Network()
    found = [(d.receive_ns, d.source, d.port, d.payload) for d in network.datagrams(frames(path, damages))]
    return found, damages, dict(network.skipped)


@pytest.mark.parametrize("capture", CAPTURES, ids=lambda p: p.name)
def test_frames_equal_those_of_dpkt(capture: Path) -> None:
    damages: list[str] = []
    ours = list(frames(capture, damages))
    with capture.open("rb") as file:
        theirs = list(dpkt.pcap.UniversalReader(file))
    assert damages == []
    assert [f.data for f in ours] == [bytes(data) for _, data in theirs]
    np.testing.assert_allclose([f.receive_ns * 1e-9 for f in ours], [float(t) for t, _ in theirs], rtol=0, atol=1e-6)


@pytest.mark.parametrize("magic", [b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d"])
def test_byte_orders_and_resolutions_of_pcap(tmp_path: Path, magic: bytes) -> None:
    order, unit = (
        ("<" if magic[0] in (0xD4, 0x4D) else ">"),
        (1000 if magic[:1] + magic[-1:] in (b"\xd4\xa1", b"\xa1\xd4") else 1),
    )
    head = magic + struct.pack(f"{order}HHiIII", 2, 4, 0, 0, 65535, 1)
    record = struct.pack(f"{order}IIII", 5, 123_456_000 // unit, len(FRAME), len(FRAME)) + FRAME
    (tmp_path / "x").write_bytes(head + record)
    assert datagrams(tmp_path / "x") == ([(5_123_456_000, "10.0.0.7", 2368, b"content")], [], {})


@pytest.mark.parametrize("order", ["<", ">"])
def test_interfaces_and_sections_of_pcapng(tmp_path: Path, order: str) -> None:
    raw = FRAME[14:]
    data = section(order) + interface(1, None, order) + interface(101, 9, order) + interface(113, 0x80 | 20, order)
    data += packet(0, 3_000_001, FRAME, order) + packet(1, 3_000_000_001, raw, order)
    data += packet(2, 3 << 20, bytes(14) + b"\x08\x00" + raw, order) + block(5, b"statistics", order)
    data += section() + interface(276) + packet(0, 4_000_000, b"\x08\x00" + bytes(18) + raw)
    data += block(3, struct.pack("<I", 20 + len(raw)) + b"\x08\x00" + bytes(18) + raw)
    (tmp_path / "x").write_bytes(data)
    found, damages, skipped = datagrams(tmp_path / "x")
    assert [t for t, *_ in found] == [3_000_001_000, 3_000_000_001, 3 * NS, 4 * NS, 4 * NS]
    assert {rest for _, *rest in map(tuple, found) for rest in [tuple(rest)]} == {("10.0.0.7", 2368, b"content")}
    assert (damages, skipped) == ([], {})


@pytest.mark.parametrize("vlans", [1, 2])
def test_vlan_tags(tmp_path: Path, vlans: int) -> None:
    path = write_pcap(tmp_path / "x", [(0.0, ethernet("10.0.0.7", 1, b"a", vlans))])
    assert [p for *_, p in datagrams(path)[0]] == [b"a"]


def test_ipv6(tmp_path: Path) -> None:
    udp = struct.pack(">HHHH", 1, 7502, 11, 0) + b"abc"
    ip = struct.pack(">IHBB", 6 << 28, len(udp), 17, 64) + bytes(15) + b"\1" + bytes(15) + b"\2" + udp
    path = write_pcap(tmp_path / "x", [(0.0, bytes(12) + b"\x86\xdd" + ip + b"padding")])
    assert datagrams(path)[0] == [(SECOND * NS, "::1", 7502, b"abc")]


def test_fragments_in_any_order(tmp_path: Path) -> None:
    payload = bytes(range(256)) * 40
    pieces = fragments(ethernet("10.0.0.7", 7502, payload))
    assert len(pieces) == 7
    order = [3, 0, 0, 6, 1, 5, 2, 4]  # one twice
    path = write_pcap(tmp_path / "x", [(k * 1e-3, pieces[i]) for k, i in enumerate(order)])
    assert datagrams(path) == ([(SECOND * NS + 7_000_000, "10.0.0.7", 7502, payload)], [], {})


def test_lost_fragments_are_counted_and_bounded(tmp_path: Path) -> None:
    count = MAX_PARTIAL + 20
    pieces = []
    for k in range(count):
        frame = bytearray(fragments(ethernet("10.0.0.7", 7502, bytes(3000)))[0])
        struct.pack_into(">H", frame, 18, k)
        pieces.append((0.0, bytes(frame)))
    found, _, skipped = datagrams(write_pcap(tmp_path / "x", pieces))
    assert found == []
    assert skipped == {("UDP", "fragments of a datagram are missing"): count}


@pytest.mark.parametrize(
    ("damage", "left", "text"),
    [
        (lambda d: d[:-5], 9, "the last record has"),
        (lambda d: d[: 24 + 3 * (16 + len(FRAME)) + 7], 3, "the last record is cut off"),
        (lambda d: d[:24], 0, ""),
        (lambda d: d[:20], 0, "no complete file header"),
        (lambda d: d[: 24 + 8] + b"\xff\xff\xff\xff" + d[24 + 12 :], 9, "no record"),
        (lambda d: d[:200] + b"\xa5" * 150 + d[200:], 8, "no record"),
        (lambda d: d[: 24 + 16 + len(FRAME)] + bytes(100) + d[24 + 16 + len(FRAME) :], 10, ""),
        (lambda d: d[:24] + b"\xff" * 3_000_000, 0, "the rest is not read"),
    ],
)  # fmt: skip
def test_readable_part_of_a_damaged_pcap(tmp_path: Path, damage, left: int, text: str) -> None:
    path = write_pcap(tmp_path / "x", [(k * 0.1, FRAME) for k in range(10)])
    path.write_bytes(damage(path.read_bytes()))
    found, damages, _ = datagrams(path)
    assert len(found) >= left
    assert (text in " ".join(damages)) if text else True


@pytest.mark.parametrize("seed", range(20))
def test_random_damage_keeps_the_rest(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    count = 40
    if seed % 2:
        data = section() + interface(1) + b"".join(packet(0, SECOND * 10**6 + k, FRAME) for k in range(count))
        (tmp_path / "x").write_bytes(data)
    else:
        write_pcap(tmp_path / "x", [(k * 0.1, FRAME) for k in range(count)])
    raw = bytearray((tmp_path / "x").read_bytes())
    start = int(random.integers(100, len(raw) - 200))
    raw[start : start + 100] = random.bytes(int(random.integers(1, 200)))
    (tmp_path / "x").write_bytes(raw)
    found, _, _ = datagrams(tmp_path / "x")
    assert sum(payload == b"content" for *_, payload in found) >= count - 6


def test_records_of_other_content_are_counted(tmp_path: Path) -> None:
    tcp = [dpkt.ip.IP(p=6, data=dpkt.tcp.TCP(sport=2112, dport=9, data=d)) for d in (b"rest", b"\2\2\2\2s", b"rest")]
    short = ethernet("10.0.0.7", 9, b"x" * 50)[:60]
    data = [
        bytes(12) + b"\x08\x06" + bytes(28),
        *(bytes(12) + b"\x08\x00" + bytes(segment) for segment in tcp),
        short,
        b"abc",
        bytes(12) + b"\x81\x00",
    ]
    found, _, skipped = datagrams(write_pcap(tmp_path / "x", [(0.0, d) for d in data]))
    assert found == []
    assert skipped == {
        ("ARP", "no sensor data"): 1,
        ("TCP ports 2112 to 9", "SICK CoLa B over TCP is not read"): 3,
        ("UDP port 9", "datagrams cut off by the capture or of a wrong length"): 1,
        ("frame", "of 3 bytes ends within its headers"): 1,
        ("frame", "of 14 bytes ends within its headers"): 1,
    }


def test_unknown_content_is_refused_with_its_reason(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"10.0.0.7:99: unknown content in UDP datagrams of 3 bytes is not read"):
        open_recording(write_packets(tmp_path / "x.pcap", [(0.0, "10.0.0.7", 99, b"abc")]))
    with pytest.raises(LogError, match="no packets"):
        open_recording(write_packets(tmp_path / "x.pcap", []))
    with pytest.raises(LogError, match="link type 189: its frames are not read"):
        open_recording(write_pcap(tmp_path / "x.pcap", [(0.0, bytes(16))], link=189))
    segment = b"\x02\x02\x02\x02\x01" + bytes(100)
    with pytest.raises(LogError, match=r"SICK compact segments in UDP datagrams of 105 bytes is not read"):
        open_recording(write_packets(tmp_path / "x.pcap", [(0.0, "10.0.0.7", 2115, segment)]))
    assert not is_capture(b"\n\r\r\n" + bytes(20))


@pytest.mark.parametrize("capture", CAPTURES, ids=lambda p: p.name)
def test_every_capture_is_read_or_refused_with_its_reason(capture: Path) -> None:
    try:
        source = open_recording(capture)
    except LogError as error:
        assert "no readable sensor data; " in str(error)  # noqa: PT017
        return
    received = list(source.read())
    assert received
    table = source.table()
    assert all(row.reasons for row in table if row.skipped)
    assert sum(row.read for row in table) == len(received)


@pytest.mark.parametrize("file", LIDAR_FILES, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_every_file_of_a_lidar_is_read_or_refused_with_its_reason(file: Path) -> None:
    try:
        assert sum(1 for _ in open_recording(file).read()) > 0
    except LogError as error:
        texts = (
            ", which is not read; ",
            "no readable sensor data; ",
            "contains no readable message; ",
            "no points scan (",
        )
        is_named = any(text in str(error) for text in texts)
        is_text = file.suffix in ("", ".txt", ".md", ".yaml", ".csv", ".dat") and "no known recording format" in str(
            error
        )
        assert is_named or is_text, error  # noqa: PT017


def test_clock_of_a_sensor() -> None:
    clock = SensorClock()
    assert [clock.stamp_ns(10 * NS + k, 10 * NS + k + 3_000_000) for k in (0, 5)] == [10 * NS, 10 * NS + 5]
    clock = SensorClock()
    delays_ms = [5.0, 2.0, 9.0, 2.5]
    offset, sent = SECOND * NS, [k * NS // 10 for k in range(4)]
    stamps = [clock.stamp_ns(t, offset + t + round(d * 1e6)) for t, d in zip(sent, delays_ms, strict=True)]
    late_ms = [(stamp - offset - t) * 1e-6 for t, stamp in zip(sent, stamps, strict=True)]
    # the smallest delay, with a drift of 0.01 ms per 0.1 s
    assert late_ms == pytest.approx([5.0, 2.0, 2.01, 2.02], abs=2e-3)
    restarted = clock.stamp_ns(0, SECOND * NS + 60 * NS)
    assert restarted == SECOND * NS + 60 * NS


@needs("devices/radar/nebula-continental/ars548.pcap")
def test_radar_capture() -> None:
    source = open_recording(DEVICES / "radar/nebula-continental/ars548.pcap")
    ((_, topic, scan),) = source.read()
    assert topic == "radar/10_13_1_113_42102"
    assert len(scan.range_m) == 308
    assert [(r.source_type, r.read, r.skipped) for r in source.table()] == [
        ("Continental ARS548 detections", 1, 0),
        ("Continental ARS548 objects", 0, 1),
    ]
