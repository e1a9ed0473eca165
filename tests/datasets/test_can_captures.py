"""CAN captures and candump logs: frames in batches, other frames and lines skipped and counted."""

import struct
from pathlib import Path

import pytest

from datasets.importers.formats import open_recording
from messages.command import CanFrames
from messages.errors import LogError
from tests.datasets.capture_samples import SECOND, interface, packet, section, write_pcap
from tests.recordings import DATA, needs

NS = 1_000_000_000
CAPTURE = DATA / "devices/can/canboat-nmea2000/can0-1.pcap"


def can(identifier: int, data: bytes, size: int | None = None) -> bytes:
    return struct.pack(">IBxxx", identifier, len(data) if size is None else size) + data


def test_frames_of_a_capture(tmp_path: Path) -> None:
    frames = [
        (0.000, can(0x98FEF100, b"12345678")),
        (0.010, can(0x123, b"ab")),
        (0.015, can(0xC0000001, b"", 8)),  # a request without data
        (0.018, can(0x20000004, bytes(8))),
        (0.019, can(0x1, bytes(20))),
        (0.019, can(0x1, b"12", 3)),
        (0.020, b"short"),
        (0.030, can(0x7FF, b"next")),
    ]
    source = open_recording(write_pcap(tmp_path / "x", frames, link=227))
    first, second = (m for _, _, m in source.read() if isinstance(m, CanFrames))
    assert [(f.identifier, f.data) for f in first.frames] == [(0x18FEF100, b"12345678"), (0x123, b"ab"), (1, b"")]
    assert first.stamp_ns == SECOND * NS + 15_000_000
    assert [f.data for f in second.frames] == [b"next"]
    (row,) = source.table()
    assert (row.topic, row.read, row.skipped) == ("can/can0", 2, 4)
    assert row.reasons["more than 8 bytes in a frame, or fewer than it states"] == 2


def test_other_links_in_a_capture_are_counted(tmp_path: Path) -> None:
    data = section() + interface(227) + interface(1) + packet(0, 1, can(1, b"a")) + packet(1, 2, bytes(60))
    (tmp_path / "x").write_bytes(data + b"damaged block")
    source = open_recording(tmp_path / "x")
    assert len(list(source.read())) == 1
    assert dict(source.table()[0].reasons) == {"frame of link type 1": 1}
    assert "byte" in " ".join(source.table()[1].reasons)


@needs("devices/can/canboat-nmea2000/can0-1.pcap")
def test_recorded_capture() -> None:
    received = [m for _, _, m in open_recording(CAPTURE).read() if isinstance(m, CanFrames)]
    assert sum(len(m.frames) for m in received) == 49_928  # as dpkt
    assert {f.identifier > 0x7FF for m in received for f in m.frames} == {True}


def test_bad_lines_of_candump_are_counted(tmp_path: Path) -> None:
    lines = ["(1.0) can0 1#00", "broken", "(1.1) can0 1#0", "(1.2) can0 1#" + "00" * 9, "(1.3) can0 2#FF", "\xff"]
    (tmp_path / "x").write_text("\n".join(lines), encoding="latin-1")
    source = open_recording(tmp_path / "x")
    assert [f.identifier for _, _, m in source.read() for f in m.frames] == [1, 2]
    assert sum(row.skipped or 0 for row in source.table()) == 4
    (tmp_path / "x").write_text("(1.0) can0 1#0\n")
    with pytest.raises(LogError, match="contains no readable message"):
        list(open_recording(tmp_path / "x").read())
