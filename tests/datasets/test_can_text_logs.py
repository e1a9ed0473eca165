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
TRACE_2 = ";$FILEVERSION=2.1\n;$STARTTIME=42176.5\n;$COLUMNS=N,O,T,I,d,l,D\n 1  48.612 DT 09F11201 Rx 2 FF 50\n"
GVRET = (
    "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    "166064000,18FEF100,true,Rx,1,2,FE,6,,,,,,,\n166064001,0000021A,false,Rx,0,0,\n"
)
ASC = (
    "date Tue Nov 14 10:13:20.500 pm 2023\nbase hex  timestamps absolute\ninternal events logged\n"
    "// a comment\nBegin Triggerblock Tue Nov 14 10:13:20.500 pm 2023\n 0.000000 Start of measurement\n"
    " 0.000100 1  18FEF100x  Rx  d 2 FF 0A  Length = 1\n 0.010100 2  123  Tx  d 0\n 0.2 1  Statistic: D 0 R 0\n"
)
PYSOBUS = '1433426120.48\t18FEF31C3D42397722E724B0\t65267\t{"Latitude": 43.5}\n'
SECOND_NS = 1_700_000_000_500_000_000  # 2023-11-14 22:13:20.5


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
    ("text", "frames"),
    [
        (TRACE_2, [("can/can0", CanFrame(1_434_888_000_048_612_000, 0x09F11201, b"\xff\x50"))]),
        (
            PCAN.replace("1.1", "1.3")
            .replace("Rx  ", "2 Rx ")
            .replace("  2  FF", " -  2  FF")
            .replace("  0  ", "  - 0 "),
            [
                ("can/can2", CanFrame(1_434_888_000_048_600_000, 0x09F11201, b"\xff\x50")),
                ("can/can2", CanFrame(1_434_888_001_049_200_000, 0x21, b"")),
            ],
        ),
        (
            GVRET,
            [
                ("can/can1", CanFrame(166_064_000_000, 0x18FEF100, b"\xfe\x06")),
                ("can/can0", CanFrame(166_064_001_000, 0x21A, b"")),
            ],
        ),
        (
            ASC,
            [
                ("can/can1", CanFrame(SECOND_NS + 100_000, 0x18FEF100, b"\xff\x0a")),
                ("can/can2", CanFrame(SECOND_NS + 10_100_000, 0x123, b"")),
            ],
        ),
        (
            "date Di Nov 14 22:13:20.500 2023\nbase dec timestamps relative\n0.1 1 291 Rx d 1 16\n0.1 1 17x Rx d 0\n",
            [
                ("can/can1", CanFrame(SECOND_NS + 100_000_000, 0x123, b"\x10")),
                ("can/can1", CanFrame(SECOND_NS + 200_000_000, 17, b"")),
            ],
        ),
        (PYSOBUS, [("can/can0", CanFrame(1_433_426_120_480_000_000, 0x18FEF31C, bytes.fromhex("3D42397722E724B0")))]),
    ],
)
def test_frames_of_each_format(tmp_path: Path, text: str, frames: list[tuple[str, CanFrame]]) -> None:
    begin = "\ufeff\n# a comment\n"
    for content in (text, text.replace("\n", "\r\n"), begin + text):
        recording = opened(tmp_path, content.encode())
        assert frames_of(recording) == frames
        assert all(row.skipped == 0 for row in recording.table())


def test_identifiers_of_11_bits_are_noted(tmp_path: Path) -> None:
    (note,) = opened(tmp_path, CRTD.encode()).description.notes
    assert note == "can0: 2 of 2 frames have identifiers of 11 bits, which the gateway does not read"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (CRTD, "166.1 R11 0000021A FE 3"),
        (CRTD, "166.1 R11 0000021A 00 01 02 03 04 05 06 07 08"),
        (CRTD, "\x00\xff"),
        (PCAN, "3)  1.0  Rx  0021  2  FF"),
        (PCAN, "3)  1.0  Error  0021  2  FF"),
        (PCAN, "3)  1.0  Rx  0021  2  RTR"),
        (TRACE_2, "3  1.0  RR  0021  Rx  2"),
        (TRACE_2, "3  1.0  FD  0021  Rx  2  FF FF"),
        (TRACE_2, "3  1.0  DT  0021  Rx"),
        (GVRET, "3,1,true,Rx,0,2,FF"),
        (GVRET, "3,1,true,Rx,0,9,00,01,02,03,04,05,06,07,08"),
        (ASC, "0.3 1 ErrorFrame"),
        (ASC, "broken"),
        (ASC, "0.3 1 J1939TP FEE3p 6 0 0 - Rx d 23"),
        (ASC, "0.3 1 123 Rx r 2"),
        (ASC, "0.3 1 123 Rx d 2 FF"),
        (ASC, "0.3 1 123 Rx d 1 XX"),
        (ASC, "0.3 CANFD 1 Rx 123 1 0 8 8 FF"),
        (PYSOBUS, "1433426120.48\t18FEF31C3D4\t1\t{}"),
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
        "furuno-130842-figure8-fast.raw.gz", "can0-1.pcap", "jd.txt",
    }  # fmt: skip
