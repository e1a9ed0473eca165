"""CAN logs as text: CRTD, PCAN-View traces of version 1.1, and canboat's raw NMEA 2000 messages; as candump otherwise.

Sources: docs.openvehicles.com (CRTD), PEAK "PCAN trace file formats" 2.1.2, canboat `common/parse.c`.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from datasets.importers.can_batches import can_batches
from datasets.importers.gnss.clock import DAY_NS, S
from datasets.importers.recording import Description, Open, Recording, Sensor, Skipped
from messages.command import CanFrame
from messages.errors import LogError

NAME = "CRTD, PCAN trace, canboat"
CHANNEL = "can0"  # for formats that do not name the channel
_CRTD = re.compile(r"(\d+)\.(\d{1,9}) (\d*)[RT](?:11|29) ([0-9A-F]{1,8})((?: [0-9A-F]{2}){0,8})", re.IGNORECASE)
_CRTD_EVENT = re.compile(r"\d+\.\d+ \d*[A-Z]\w*(?: .*)?")
_PCAN = re.compile(r"\d+\)\s+(\d+)\.(\d) +[RT]x +([0-9A-F]{4,8}) +(\d)((?: +[0-9A-F]{2}){0,8})", re.IGNORECASE)
_PCAN_START = re.compile(r";\$STARTTIME=(\d+)\.(\d+)")
_CANBOAT = re.compile(
    r"(\d{4}-\d\d-\d\d)[T-](\d\d:\d\d:\d\d)[.,](\d{1,9})Z?,(\d),(\d{1,6}),(\d{1,3}),(\d{1,3}),(\d{1,3})((?:,[0-9a-f]{2})*),?",
    re.IGNORECASE,
)
_EXCEL_DAYS = 25_569  # from 1899-12-30, where PCAN counts from, to 1970-01-01
Numbered = tuple[str, CanFrame] | None


@dataclass(frozen=True)
class _Format:
    """`start` recognizes the first line; `frame` reads one, given the start of the trace, None for a comment."""

    name: str
    start: re.Pattern[bytes]
    frame: Callable[[str, int], Numbered]
    note: str = ""


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a file by its first line."""
    found = next((form for form in FORMATS if form.start.match(head)), None)
    return None if found is None else partial(_open, found)


def _open(form: _Format, path: Path, _: Path | None = None) -> Recording:
    items = partial(_frames, form, path)
    channels = dict.fromkeys(item[0] for item in items() if not isinstance(item, Skipped))
    sensors = tuple(Sensor(f"can/{channel}", "", channel, form.name) for channel in channels)
    notes = (form.note,) if form.note else ()
    return Recording(path, Description(form.name, sensors, notes=notes), lambda: can_batches(items()))


def _frames(form: _Format, path: Path) -> Iterator[tuple[str, CanFrame] | Skipped]:
    start_ns = last_ns = 0
    try:
        with path.open(encoding="ascii", errors="replace") as file:
            for line in filter(None, map(str.strip, file)):
                start_ns = _start_ns(line) or start_ns
                try:
                    found = form.frame(line, start_ns)
                except ValueError as error:
                    yield Skipped(last_ns, path.name, "lines", str(error))
                    continue
                if found is not None:
                    last_ns = found[1].stamp_ns
                    yield found
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error})") from error


def _start_ns(line: str) -> int:
    found = _PCAN_START.match(line)
    return 0 if found is None else (int(found[1]) - _EXCEL_DAYS) * DAY_NS + round(float("0." + found[2]) * DAY_NS)


def _crtd(line: str, _: int) -> Numbered:
    found = _CRTD.fullmatch(line)
    if found is None:
        if _CRTD_EVENT.fullmatch(line) and not re.match(r"\S+ \d*[RT](?:11|29)\b", line):
            return None
        raise ValueError("not of the form seconds R11 ID data")
    frame = CanFrame(int(found[1]) * S + _ns(found[2]), int(found[4], 16), bytes.fromhex(found[5]))
    return f"can{found[3] or 0}", frame


def _pcan(line: str, start_ns: int) -> Numbered:
    if line.startswith(";"):
        return None
    found = _PCAN.fullmatch(line)
    if found is None or len(data := bytes.fromhex(found[5])) != int(found[4]):
        raise ValueError("not of the form number) milliseconds Rx ID length data")
    stamp_ns = start_ns + int(found[1]) * 1_000_000 + int(found[2]) * 100_000
    return CHANNEL, CanFrame(stamp_ns, int(found[3], 16), data)


def _canboat(line: str, _: int) -> Numbered:
    """A message of at most 8 bytes as the frame that carried it; the frames of longer ones are not in the log."""
    if line.startswith("#"):
        return None
    found = _CANBOAT.fullmatch(line)
    if found is None:
        raise ValueError("not of the form time,priority,PGN,source,destination,length,data")
    priority, pgn, source, destination, length = (int(found[k]) for k in range(4, 9))
    data = bytes.fromhex(found[9].replace(",", ""))
    if len(data) != length or priority > 7 or pgn >= 1 << 18 or max(source, destination) > 255:
        raise ValueError("a number is out of range, or the length is not that of the data")
    if length > 8:
        raise ValueError("assembled message of more than 8 bytes, not a frame")
    time = datetime.fromisoformat(f"{found[1]}T{found[2]}").replace(tzinfo=UTC)
    addressed = pgn | destination if pgn >> 8 & 0xFF < 240 else pgn  # PDU 1 carries the destination
    identifier = priority << 26 | addressed << 8 | source
    return CHANNEL, CanFrame(round(time.timestamp()) * S + _ns(found[3]), identifier, data)


def _ns(fraction: str) -> int:
    return int(fraction.ljust(9, "0"))


FORMATS = (
    _Format("CRTD", re.compile(rb"\A\d+\.\d+ \d*(?:C[XVE]\w|[RT](?:11|29)) "), _crtd),
    _Format(
        "PCAN trace", re.compile(rb"\A;\$FILEVERSION=1\.1\s"), _pcan, "times are those of the recording PC, read as UTC"
    ),
    _Format(
        "canboat", re.compile(rb"\A(?:#[^\n]*\n)*\d{4}-\d\d-\d\d[T-][\d:]{8}[.,]\d+Z?,\d,\d+,\d+,\d+,\d+,"), _canboat
    ),
)
