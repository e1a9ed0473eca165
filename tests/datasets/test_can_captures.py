"""CAN captures and candump logs: frames in batches, other frames and lines skipped and counted."""

import struct
from pathlib import Path

import can
import pytest

from datasets.importers.formats import open_recording
from messages.command import CanFrames
from messages.errors import LogError
from tests.datasets.capture_samples import SECOND, interface, packet, section, write_pcap
from tests.datasets.imported import reasons
from tests.recordings import DATA, needs

NS = 1_000_000_000
CAPTURE = DATA / "devices/can/canboat-nmea2000/can0-1.pcap"


def socketcan(identifier: int, data: bytes, size: int | None = None) -> bytes:
    return struct.pack(">IBxxx", identifier, len(data) if size is None else size) + data


def test_frames_of_a_capture(tmp_path: Path) -> None:
    frames = [
        (0.000, socketcan(0x98FEF100, b"12345678")),
        (0.010, socketcan(0x123, b"ab")),
        (0.015, socketcan(0xC0000001, b"", 8)),  # a remote frame
        (0.018, socketcan(0x20000004, bytes(8))),
        (0.019, socketcan(0x1, bytes(20))),
        (0.019, socketcan(0x1, b"12", 3)),
        (0.020, b"short"),
        (0.030, socketcan(0x7FF, b"next")),
    ]
    source = open_recording(write_pcap(tmp_path / "x", frames, link=227))
    first, second = (m for _, _, m in source.read() if isinstance(m, CanFrames))
    assert [(f.identifier, f.data) for f in first.frames] == [(0x18FEF100, b"12345678"), (0x123, b"ab")]
    assert first.stamp_ns == SECOND * NS + 10_000_000
    assert [f.data for f in second.frames] == [b"next"]
    (row,) = source.table()
    assert (row.topic, row.read, row.skipped) == ("can/can0", 2, 5)
    assert row.reasons["more than 8 bytes in a frame, or fewer than it states"] == 2


def test_other_links_in_a_capture_are_counted(tmp_path: Path) -> None:
    data = section() + interface(227) + interface(1) + packet(0, 1, socketcan(1, b"a")) + packet(1, 2, bytes(60))
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
    (tmp_path / "x").write_text("\n".join([*lines, ""]), encoding="latin-1")
    source = open_recording(tmp_path / "x")
    assert [f.identifier for _, _, m in source.read() for f in m.frames] == [1, 2]
    assert sum(row.skipped or 0 for row in source.table()) == 4
    (tmp_path / "x").write_text("(1.0) can0 1#0\n")
    with pytest.raises(LogError, match="contains no readable message"):
        list(open_recording(tmp_path / "x").read())


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("(1.0) can0 1#R8", "remote frame, without data"),
        (" (1.0)  can0  123   [0]  remote request", "remote frame, without data"),
        ("(1.0) can0 20000004#0004000000000000", "error frame of the interface"),
        (" (1.0)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME", "error frame of the interface"),
        ("(1.0) can0 123##1" + "00" * 12, "CAN FD frame, which is not read"),
        (" (1.0)  can0  123  [12]  " + "00 " * 12, "CAN FD frame, which is not read"),
        ("(1700000000123.0) can0 123#00", "a time before 1970 or after 2262 (is it in ms?)"),
        ("(1.0) can0 4FFFFFFF#00", "an identifier of more than 29 bits"),
        (" (1.0)  can0  123   [2]  00", "the length is not that of the data"),
        (" (2023-13-14 22:13:20.000000)  can0  123   [0]", "month must be in 1..12"),
    ],
)
def test_lines_of_candump_without_data_are_skipped_with_the_reason(tmp_path: Path, line: str, reason: str) -> None:
    (tmp_path / "x").write_text(f"(1.0) can0 18FEF100#01\n{line}\n(2.0) can0 18FEF100#02\n")
    source = open_recording(tmp_path / "x")
    assert [f.data for _, _, m in source.read() for f in m.frames] == [b"\1", b"\2"]
    assert reasons(source) == {reason: 1}


def test_candump_on_screen_with_times(tmp_path: Path) -> None:
    (tmp_path / "x").write_text(
        "\ufeff\n# recorded here\n (1700000000.000100)  can0  18FEF100   [2]  FF 0A   '..'\n"
        " (1700000000.000200)  can0  RX - -  18FEF100   [0]\n (2023-11-14 22:13:20.000300)  can0  123   [1]  01\n",
        encoding="utf-8",
    )
    source = open_recording(tmp_path / "x")
    frames = [f for _, _, m in source.read() for f in m.frames]
    assert [f.stamp_ns - 1_700_000_000 * NS for f in frames] == [100_000, 200_000, 300_000]
    assert [(f.identifier, f.data) for f in frames] == [(0x18FEF100, b"\xff\n"), (0x18FEF100, b""), (0x123, b"\1")]
    assert any("read as UTC" in note for note in source.description.notes)


def test_cut_last_line_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("(1.0) can0 18FEF100#0102\n(2.0) can0 18FEF100#01")
    source = open_recording(tmp_path / "x")
    assert [f.data for _, _, m in source.read() for f in m.frames] == [b"\1\2"]
    assert reasons(source) == {"the last line has no line end: it may be cut off": 1}


def blf(path: Path) -> Path:
    with can.BLFWriter(path) as writer:
        for message in (
            can.Message(timestamp=1_700_000_000.0001, arbitration_id=0x18FEF100, data=b"12345678", channel=0),
            can.Message(timestamp=1_700_000_000.0002, arbitration_id=0x123, is_extended_id=False, data=b"a", channel=1),
            can.Message(timestamp=1_700_000_000.0003, arbitration_id=0x123, is_remote_frame=True, dlc=2, channel=0),
            can.Message(timestamp=1_700_000_000.0004, arbitration_id=0x1, is_error_frame=True, channel=0),
            can.Message(timestamp=1_700_000_000.0005, arbitration_id=0x1, is_fd=True, data=bytes(12), channel=0),
        ):
            writer.on_message_received(message)
    return path


def test_blf(tmp_path: Path) -> None:
    source = open_recording(blf(tmp_path / "a.blf"))
    frames = [(topic, f.stamp_ns - 1_700_000_000 * NS, f.identifier, f.data) for _, topic, m in source.read()
              for f in m.frames]  # fmt: skip
    assert frames == [("can/can1", 100_000, 0x18FEF100, b"12345678"), ("can/can2", 200_000, 0x123, b"a")]
    assert reasons(source) == {
        "remote frame, without data": 1, "error frame of the interface": 1, "CAN FD frame, which is not read": 1
    }  # fmt: skip


def test_damaged_blf(tmp_path: Path) -> None:
    data = blf(tmp_path / "a.blf").read_bytes()
    (tmp_path / "a.blf").write_bytes(data[:-20])
    assert "the file is cut off" in " ".join(
        r for row in open_recording(tmp_path / "a.blf").table() for r in row.reasons
    )
    for content in (data[:40], data[:160] + bytes(len(data) - 160)):
        (tmp_path / "a.blf").write_bytes(content)
        with pytest.raises(LogError, match=r"a\.blf: (?:no header of a BLF file|contains no readable message)"):
            list(open_recording(tmp_path / "a.blf").read())
