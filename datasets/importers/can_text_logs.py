"""CAN logs as text: CRTD, GVRET (SavvyCAN), PCAN-View traces from version 1.1 on, Vector ASC, canboat, and pysobus.

Sources: docs.openvehicles.com (CRTD), SavvyCAN `framefileio.cpp`, PEAK "PCAN trace file formats" 2.1.2, python-can
`io/asc.py`, canboat `common/parse.c` (raw NMEA 2000 messages), pysobus `tests/jd.txt`.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from datasets.importers.can_batches import ERROR_FRAME, FD, NO_DATA, Numbered, can_lines, can_recording
from datasets.importers.gnss.clock import DAY_NS, S
from datasets.importers.recording import Open, Recording, Skipped
from messages.command import CanFrame

NAME = "CRTD, GVRET, PCAN trace, Vector ASC, canboat, pysobus"
CHANNEL = "can0"  # for formats that do not name the channel
LOCAL = "times are those of the recording PC, read as UTC"
_CRTD = re.compile(r"(\d+)\.(\d{1,9}) (\d*)[RT](?:11|29) ([0-9A-F]{1,8})((?: [0-9A-F]{2}){0,8})", re.I | re.A)
_CRTD_EVENT = re.compile(r"\d+\.\d+ \d*[A-Z]\w*(?: .*)?", re.A)
_PCAN_HEAD = re.compile(r";\$(FILEVERSION|STARTTIME|COLUMNS)=(\S+)")
_PCAN_COLUMNS = {"1.1": "N,O,d,I,l,D", "1.3": "N,O,B,d,I,R,l,D", "2.0": "N,O,T,I,d,l,D", "2.1": "N,O,T,B,I,d,R,L,D"}
_PCAN_TYPES = {"RR": NO_DATA, "ER": ERROR_FRAME, **dict.fromkeys(("FD", "FB", "FE", "BI"), FD)}
_EXCEL_DAYS = 25_569  # from 1899-12-30, where PCAN counts from, to 1970-01-01
_ASC_DATE = re.compile(
    r"(?:date|begin triggerblock) +\w+ +(\w{3})\w* +(\d+) +(\d+):(\d+):(\d+)(?:\.(\d+))?(?: +([ap])m)? +(\d{4})", re.I
)
_ASC_BASE = re.compile(r"base +(hex|dec)(?: +timestamps +(absolute|relative))?", re.I)
_ASC_EVENT = re.compile(r"(\d+)\.(\d{1,9}) +(\w+)(?: +(.*))?", re.A)
_ASC_OTHER = re.compile(
    r"(?:no +)?internal events logged|end triggerblock"
    r"|[\d.]+ +(?:start of measurement|\d+ +statistic:.*|can +\d+ +status:.*)",
    re.I,
)
_MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "mär": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9,
    "oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12,
}  # fmt: skip
_CANBOAT = re.compile(
    r"(\d{4}-\d\d-\d\d)[T-](\d\d:\d\d:\d\d)[.,](\d{1,9})Z?,(\d),(\d{1,6}),(\d{1,3}),(\d{1,3}),(\d{1,3})((?:,[0-9a-f]{2})*),?",
    re.IGNORECASE | re.ASCII,
)
_PYSOBUS = re.compile(r"(\d+)\.(\d{1,9})\t([0-9A-F]{8})((?:[0-9A-F]{2}){0,8})\t.*", re.I | re.A)
_BEGIN = re.compile(rb"\A(?:\xef\xbb\xbf)?(?:[ \t]*(?:(?:#|//)[^\n]*)?\r?\n)*[ \t]*")


@dataclass
class _Head:
    """What the header of a log says of the lines after it."""

    start_ns: int = 0
    columns: tuple[str, ...] = ()
    base: int = 16
    is_relative: bool = False
    last_ns: int = 0


@dataclass(frozen=True)
class _Format:
    """`start` recognizes the first line; `frame` reads one, given the header, None for a line of the header."""

    name: str
    start: re.Pattern[bytes]
    frame: Callable[[str, _Head], Numbered | None]
    note: str = ""


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a file by its first line, beside comments."""
    begin = _BEGIN.sub(b"", head, count=1)
    found = next((form for form in FORMATS if form.start.match(begin)), None)
    return None if found is None else partial(_open, found)


def _open(form: _Format, path: Path, _: Path | None = None) -> Recording:
    return can_recording(path, form.name, partial(_frames, form, path), (form.note,) if form.note else ())


def _frames(form: _Format, path: Path) -> Iterator[Numbered | Skipped]:
    head = _Head()
    return can_lines(path, lambda line: form.frame(line, head))


def _crtd(line: str, _: _Head) -> Numbered | None:
    found = _CRTD.fullmatch(line)
    if found is None:
        if _CRTD_EVENT.fullmatch(line) and not re.match(r"\S+ \d*[RT](?:11|29)\b", line):
            return None
        raise ValueError("not of the form seconds R11 ID data")
    frame = CanFrame(int(found[1]) * S + _ns(found[2]), int(found[4], 16), bytes.fromhex(found[5]))
    return f"can{found[3] or 0}", frame


def _gvret(line: str, head: _Head) -> Numbered | None:
    values = [value.strip() for value in line.split(",")]
    if not head.columns:
        head.columns = tuple(value.lower() for value in values)
        return None
    row = dict(zip(head.columns, values, strict=False))
    try:
        size, at = int(row["len"]), head.columns.index("d1")
        data = bytes.fromhex("".join(value.zfill(2) for value in values[at : at + size]))
        frame = CanFrame(int(row["time stamp"]) * 1000, int(row["id"], 16), data)
        channel = f"can{int(row['bus'])}"
    except (KeyError, ValueError) as error:
        raise ValueError("not of the form of the header, Time Stamp,ID,...") from error
    if size > 8:
        raise ValueError(FD)
    if len(data) != size:
        raise ValueError("the length is not that of the data")
    return channel, frame


def _pcan(line: str, head: _Head) -> Numbered | None:
    if line.startswith(";"):
        _pcan_head(line, head)
        return None
    row = dict(zip(head.columns, line.split(maxsplit=len(head.columns) - 1), strict=False))
    if "T" not in row and row.get("d") not in ("Rx", "Tx"):
        raise ValueError("not a data frame" if "d" in row else "not of the form of the columns")
    if line.endswith("RTR"):
        raise ValueError(NO_DATA)
    if row.get("T", "DT") != "DT":
        raise ValueError(_PCAN_TYPES.get(row["T"], "not a data frame"))
    try:
        milliseconds, _, fraction = row["O"].partition(".")
        size, content = int(row.get("l", row.get("L", ""))), row.get("D", "")
        data = bytes.fromhex(content)
        identifier, stamp_ns = int(row["I"], 16), int(milliseconds) * 1_000_000 + int(fraction.ljust(6, "0"))
    except KeyError as error:
        raise ValueError("not of the form of the columns") from error
    if len(data) != size:
        raise ValueError("the length is not that of the data")
    return f"can{row['B']}" if "B" in row else CHANNEL, CanFrame(head.start_ns + stamp_ns, identifier, data)


def _pcan_head(line: str, head: _Head) -> None:
    found = _PCAN_HEAD.match(line)
    if found is None:
        return
    if found[1] == "STARTTIME":
        days, _, fraction = found[2].partition(".")
        head.start_ns = (int(days) - _EXCEL_DAYS) * DAY_NS + round(float(f"0.{fraction}") * DAY_NS)
    else:
        head.columns = tuple((_PCAN_COLUMNS.get(found[2], "") if found[1] == "FILEVERSION" else found[2]).split(","))


def _asc(line: str, head: _Head) -> Numbered | None:
    if (begin := _ASC_DATE.match(line)) is not None:
        head.start_ns = _asc_ns(begin)
        return None
    if (base := _ASC_BASE.match(line)) is not None:
        head.base, head.is_relative = 10 if base[1].lower() == "dec" else 16, (base[2] or "").lower() == "relative"
        return None
    event = _ASC_EVENT.fullmatch(line)
    if _ASC_OTHER.fullmatch(line):
        return None
    if event is None:
        raise ValueError("not of the form seconds channel ID Rx d length data")
    since_ns = int(event[1]) * S + _ns(event[2])
    head.last_ns = head.last_ns + since_ns if head.is_relative else since_ns
    words = (event[4] or "").split()
    if event[3] == "CANFD":
        raise ValueError(FD)
    if words[:1] == ["ErrorFrame"]:
        raise ValueError(ERROR_FRAME)
    if not event[3].isdigit() or len(words) < 3 or words[1] not in ("Rx", "Tx", "TxRq"):
        raise ValueError("an event that is no CAN frame")
    if words[2] == "r":
        raise ValueError(NO_DATA)
    size = int(words[3], 16) if len(words) > 3 else 0
    data = bytes(int(word, head.base) for word in words[4 : 4 + size])
    if len(data) != size:
        raise ValueError("the length is not that of the data")
    identifier = int(words[0].rstrip("xX"), head.base)
    return f"can{event[3]}", CanFrame(head.start_ns + head.last_ns, identifier, data)


def _asc_ns(found: re.Match[str]) -> int:
    """Unix time (ns) of a date; raises ValueError."""
    month, day, hour, minute, second, fraction, half, year = found.groups()
    if month.lower() not in _MONTHS:
        raise ValueError(f"{month!r} is no month")
    hour_of_day = int(hour) % 12 + 12 * (half.lower() == "p") if half else int(hour)
    at = datetime(int(year), _MONTHS[month.lower()], int(day), hour_of_day, int(minute), int(second), tzinfo=UTC)
    return round(at.timestamp()) * S + _ns(fraction or "0")


def _canboat(line: str, _: _Head) -> Numbered | None:
    """A message of at most 8 bytes as the frame that carried it; the frames of longer ones are not in the log."""
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


def _pysobus(line: str, _: _Head) -> Numbered | None:
    found = _PYSOBUS.fullmatch(line)
    if found is None:
        raise ValueError("not of the form seconds, ID and data, PGN, values")
    return CHANNEL, CanFrame(int(found[1]) * S + _ns(found[2]), int(found[3], 16), bytes.fromhex(found[4]))


def _ns(fraction: str) -> int:
    return int(fraction.ljust(9, "0"))


FORMATS = (
    _Format("CRTD", re.compile(rb"\d+\.\d+ \d*(?:C[XVE]\w|[RT](?:11|29)) "), _crtd),
    _Format(
        "GVRET", re.compile(rb"Time Stamp,ID,Extended,", re.I), _gvret, "times count as in the log, from its start"
    ),
    _Format("PCAN trace", re.compile(rb";\$FILEVERSION=(?:1\.[13]|2\.[01])\s"), _pcan, LOCAL),
    _Format("Vector ASC", re.compile(rb"(?:date +\w+ +\w+ +\d|base +(?:hex|dec)\b)", re.I), _asc, LOCAL),
    _Format("canboat", re.compile(rb"\d{4}-\d\d-\d\d[T-][\d:]{8}[.,]\d+Z?,\d,\d+,\d+,\d+,\d+,"), _canboat),
    _Format("pysobus", re.compile(rb"\d{10}\.\d+\t[0-9A-F]{8,24}\t\d+\t", re.I), _pysobus),
)
