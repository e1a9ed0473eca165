"""CRTD, PCAN and canboat logs: the frames of the file, bad lines counted; every file of devices/can."""

import gzip
import re
from pathlib import Path

import pytest

from datasets.importers.formats import open_recording
from datasets.importers.recording import Recording
from messages.command import CanFrame, CanFrames
from messages.errors import LogError
from tests.recordings import DATA, needs

CAN = DATA / "devices/can"
CRTD = "166.064000 CXX GVRET-PC\n166.064000 R11 0000021A FE 36\n166.5 2T29 18FEF100 00\n167.0 R11 00000001\n"
PCAN = ";$FILEVERSION=1.1\n;$STARTTIME=42176.5\n;\n 1)   48.6  Rx  09F11201  2  FF 50 \n 2)  1049.2  Rx  0021  0  \n"
CANBOAT = (
    "# format=FAST\n2026-08-03T05:05:27.983Z,2,129026,52,255,8,ff,fc,f5,bf,3f,01,ff,ff\n"
    "2026-08-03-05:05:27.985,6,59904,35,52,3,14,f0,01\n"
)


def opened(folder: Path, data: bytes) -> Recording:
    path = folder / "log"
    path.write_bytes(data)
    return open_recording(path)


def frames_of(recording: Recording) -> list[tuple[str, CanFrame]]:
    return [(topic, f) for _, topic, m in recording.read() if isinstance(m, CanFrames) for f in m.frames]


def test_crtd(tmp_path: Path) -> None:
    frames = frames_of(opened(tmp_path, CRTD.encode()))
    assert sorted(frames, key=lambda f: f[1].stamp_ns) == [
        ("can/can0", CanFrame(166_064_000_000, 0x21A, b"\xfe\x36")),
        ("can/can2", CanFrame(166_500_000_000, 0x18FEF100, b"\x00")),
        ("can/can0", CanFrame(167_000_000_000, 1, b"")),
    ]


def test_pcan(tmp_path: Path) -> None:
    noon_ns = 1_434_888_000_000_000_000  # 2015-06-21 12:00, 42176.5 days after 1899-12-30
    assert [f for _, f in frames_of(opened(tmp_path, PCAN.encode()))] == [
        CanFrame(noon_ns + 48_600_000, 0x09F11201, b"\xff\x50"),
        CanFrame(noon_ns + 1_049_200_000, 0x21, b""),
    ]


def test_canboat(tmp_path: Path) -> None:
    assert [f for _, f in frames_of(opened(tmp_path, CANBOAT.encode()))] == [
        CanFrame(1_785_733_527_983_000_000, 0x09F80234, bytes.fromhex("fffcf5bf3f01ffff")),
        CanFrame(1_785_733_527_985_000_000, 0x18EA3423, bytes.fromhex("14f001")),  # to the address 0x34
    ]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (CRTD, "166.1 R11 0000021A FE 3"),
        (CRTD, "166.1 R11 0000021A 00 01 02 03 04 05 06 07 08"),
        (CRTD, "\x00\xff"),
        (PCAN, "3)  1.0  Rx  0021  2  FF"),
        (PCAN, "3)  1.0  Error  0021  2  FF"),
        (CANBOAT, "2026-08-03T05:05:27.983Z,2,129026,52,255,8,ff"),
        (CANBOAT, "2026-08-03T05:05:27.983Z,9,129026,52,255,1,ff"),
        (CANBOAT, "2026-08-03T05:05:27.983Z,2,999999,52,255,1,ff"),
        (CANBOAT, "2026-13-03T05:05:27.983Z,2,129026,52,255,1,ff"),
        (CANBOAT, "2026-08-03T05:05:27.983Z,2,129026,52,255,9,00,01,02,03,04,05,06,07,08"),
    ],
)
def test_bad_line_is_counted(tmp_path: Path, text: str, line: str) -> None:
    expected = len(frames_of(opened(tmp_path, text.encode())))
    recording = opened(tmp_path, text.encode() + line.encode("latin-1") + b"\n")
    assert len(frames_of(recording)) == expected
    assert sum(row.skipped or 0 for row in recording.table()) == 1


@needs("devices/can")
@pytest.mark.parametrize(
    ("name", "pattern", "skipped"),
    [
        ("savvycan/CRTD_Log.txt.gz", rb" R11 ", 0),
        ("savvycan/candump.log.gz", rb" vcan0 ", 0),
        ("canboat-nmea2000/sample3_PCAN-View.trc.gz", rb"\) +[\d.]+  [RT]x ", 0),
        ("canboat-nmea2000/raymarine-ev1.raw.gz", rb"(?m)^\d.*,[0-8](?:,[0-9a-f]{2}){0,8}\s*$", None),
        ("canboat-nmea2000/furuno-130842-figure8-fast.raw.gz", rb"(?m)^\d.*,[0-8](?:,[0-9a-f]{2}){0,8}\s*$", None),
    ],
)
def test_numbers_of_frames(tmp_path: Path, name: str, pattern: bytes, skipped: int | None) -> None:
    data = gzip.decompress((CAN / name).read_bytes())
    recording = opened(tmp_path, data)
    assert len(frames_of(recording)) == len(re.findall(pattern, data))
    lost = sum(row.skipped or 0 for row in recording.table())
    lines = sum(
        1 for line in data.splitlines() if line.strip() and not line.startswith((b"#", b";")) and b" CXX " not in line
    )
    assert lost == (lines - len(frames_of(recording)) if skipped is None else skipped)


@needs("devices/can")
def test_every_file_of_devices_is_imported_or_refused_with_the_reason() -> None:
    read = set()
    for path in sorted(p for p in CAN.rglob("*") if p.is_file()):
        try:
            read |= {path.name} if list(open_recording(path).read()) else set()
        except LogError as error:
            assert len(str(error)) > len(str(path)) + 10  # noqa: PT017
    assert read == {
        "CRTD_Log.txt.gz", "candump.log.gz", "sample3_PCAN-View.trc.gz", "raymarine-ev1.raw.gz",
        "furuno-130842-figure8-fast.raw.gz", "can0-1.pcap",
    }  # fmt: skip
