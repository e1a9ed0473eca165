"""Solution files of RTKLIB (`.pos`): geodetic, earth-fixed or baseline coordinates in GPST, UTC or JST.

Columns as in RTKLIB's manual, appendix B.1. Times are Unix time of UTC. Unknown: age without corrections (Q 5 and 6),
standard deviations that are all zero, the ellipsoidal height where the file has geodetic heights.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from datasets.importers.gnss.clock import GPS_START_NS, WEEK_NS, S, utc_of_gps
from datasets.importers.gnss.fix import fix_of
from datasets.importers.recording import Description, Open, Received, Recording, Sensor, Skipped
from geometry.geodesy import Datum, ellipsoidal
from messages.errors import LogError
from messages.sensors import GnssSolution

NAME = "RTKLIB .pos"
TOPIC = "gnss/rtklib"
COLUMNS = re.compile(rb"^%[ \t]+(GPST|UTC|JST)[\s,;]+(latitude\(|x-ecef\(|e-baseline\()", re.MULTILINE)
NUMBER = re.compile(r"-?[0-9]{1,10}(\.[0-9]{0,12})?", re.ASCII)
MAX_WEEKS = 10_000
SNIFF_BYTES = 1 << 16
SOLUTIONS = {1: GnssSolution.RTK_FIXED, 2: GnssSolution.RTK_FLOAT, 3: GnssSolution.SBAS, 4: GnssSolution.SBAS,
             5: GnssSolution.SINGLE, 6: GnssSolution.PPP}  # fmt: skip
WITH_CORRECTIONS = (1, 2, 3, 4)
GEODETIC = "geodetic heights: the ellipsoidal height is unknown"
Row = dict[str, float]
Values = dict[str, Any]


@dataclass(frozen=True)
class _Header:
    """Meaning of the rows that follow it; `reference` is the base of baselines."""

    system: str = ""
    columns: tuple[str, ...] = ()
    is_geodetic: bool = False
    datum: str = "WGS84"
    reference: Datum | None = None


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a file with RTKLIB's line of column names."""
    if not head.startswith(b"%"):
        return None
    with path.open("rb") as file:
        return open_pos if COLUMNS.search(file.read(SNIFF_BYTES)) else None


def open_pos(path: Path, _: Path | None = None) -> Recording:
    """A solution file; `read` raises LogError when no row can be read."""
    notes = (GEODETIC,) if any(header.is_geodetic for header, _ in _lines(path)) else ()
    return Recording(path, Description(NAME, (Sensor(TOPIC, "", TOPIC, NAME),), notes=notes), partial(_messages, path))


def _messages(path: Path) -> Iterator[Received | Skipped]:
    last_ns = 0
    for header, line in _lines(path):
        try:
            last_ns, row = _row(header, line)
            yield last_ns, TOPIC, fix_of(_values(header, row), last_ns)
        except (LogError, ValueError, KeyError, OverflowError) as error:
            yield Skipped(last_ns, TOPIC, NAME, str(error))


def _lines(path: Path) -> Iterator[tuple[_Header, str]]:
    """Every row with the header above it."""
    header = _Header()
    try:
        with path.open(encoding="ascii", errors="replace") as file:
            for line in file:
                if line.startswith("%"):
                    header = _header(header, line)
                elif line.strip():
                    yield header, line
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error


def _header(header: _Header, line: str) -> _Header:
    words = _words(line.removeprefix("%"))
    if words[:1] in (["GPST"], ["UTC"], ["JST"]):
        return replace(header, system=words[0], columns=tuple(_names(words[1:])))
    if line.startswith("% ref pos") and len(words) >= 3:
        return replace(header, reference=_reference(words[-3:]))
    if (found := re.search(r"height=(\w+)/(\w+)|ecef=(\w+)", line)) is not None:
        return replace(header, datum=found[1] or found[3], is_geodetic=found[2] == "geodetic")
    return header


def _names(words: list[str]) -> Iterator[str]:
    """Names of the columns without units; degrees, minutes and seconds are three columns."""
    for word in words:
        name, _, unit = word.partition("(")
        yield from (f"{name}:{part}" for part in "dms") if unit.startswith("d'") else (name,)


def _reference(words: list[str]) -> Datum | None:
    """Base station from latitude, longitude and height, or earth-fixed."""
    try:
        a, b, c = map(float, words)
    except ValueError:
        return None
    if abs(a) <= 90.0 and abs(b) <= 360.0:
        return Datum(math.radians(a), math.radians(b), c)
    return Datum(*ellipsoidal(a, b, c))


def _row(header: _Header, line: str) -> tuple[int, Row]:
    """Unix time and numbers by column."""
    if not header.columns:
        raise LogError("row without column names above it")
    words = _words(line)
    if len(words) < 2 + len(header.columns[:5]):
        raise LogError("row is cut off")
    bad = [word for word in words[2:] if NUMBER.fullmatch(word) is None]
    if bad:
        raise LogError(f"{bad[0]!r} is not a number")
    values = map(float, words[2:])
    return _time_ns(header.system, *words[:2]), dict(zip(header.columns, values, strict=False))


def _words(line: str) -> list[str]:
    return [word for word in re.split(r"[\s,;]+", line) if word]


def _time_ns(system: str, first: str, second: str) -> int:
    """Unix time of `yyyy/mm/dd hh:mm:ss.s`, or of GPS week and time of week."""
    if "/" not in first:
        gps_ns = int(first) * WEEK_NS + _ns(second)
    else:
        hour, minute, seconds = second.split(":")
        begin = datetime(*map(int, first.split("/")), int(hour), int(minute), tzinfo=UTC)  # type: ignore[misc,arg-type,call-arg]
        gps_ns = round(begin.timestamp()) * S + _ns(seconds) - GPS_START_NS
    if not 0 <= gps_ns < MAX_WEEKS * WEEK_NS:
        raise LogError(f"{first!r} is not a GPS time")
    if system == "GPST":
        return utc_of_gps(gps_ns)
    return GPS_START_NS + gps_ns - (9 * 3600 * S if system == "JST" else 0)


def _ns(seconds: str) -> int:
    if NUMBER.fullmatch(seconds) is None or not 0.0 <= float(seconds) <= WEEK_NS / S:
        raise LogError(f"{seconds!r} s is not a time")
    whole, _, fraction = seconds.partition(".")
    return int(whole) * S + int(fraction[:9].ljust(9, "0"))


def _values(header: _Header, row: Row) -> Values:
    """Position, accuracy and the rest of a row by the names of GnssFix."""
    if header.datum != "WGS84":
        raise LogError(f"datum {header.datum} is not WGS84")
    quality, satellites = _integer(row, "Q"), _integer(row, "ns")
    values = _place(header, row) | {"solution": SOLUTIONS.get(quality, GnssSolution.NONE), "satellites": satellites}
    if quality in WITH_CORRECTIONS and "age" in row:
        values["correction_age_s"] = row["age"]
    if {"vn", "ve", "vu"} <= row.keys():
        values["velocity_enu_mps"] = np.array((row["ve"], row["vn"], row["vu"]))
    return values


def _place(header: _Header, row: Row) -> Values:
    if "x-ecef" in row:
        return _of_earth(row)
    if "e-baseline" in row:
        if header.reference is None:
            raise LogError("baseline without the position of its base (ref pos)")
        enu = row["e-baseline"], row["n-baseline"], row["u-baseline"]
        return _geodetic(header.reference.to_ellipsoid(*enu)) | _sigma(row)
    latitude, longitude = (_degrees(row, name) for name in ("latitude", "longitude"))
    height = math.nan if header.is_geodetic else row["height"]
    return _geodetic((math.radians(latitude), math.radians(longitude), height)) | _sigma(row)


def _of_earth(row: Row) -> Values:
    """An earth-fixed position; RTKLIB's covariances are the signed roots of their magnitudes."""
    latitude, longitude, height = ellipsoidal(row["x-ecef"], row["y-ecef"], row["z-ecef"])
    place = _geodetic((latitude, longitude, height))
    names = (("sdx", "sdxy", "sdzx"), ("sdxy", "sdy", "sdyz"), ("sdzx", "sdyz", "sdz"))
    if not {name for line in names for name in line} <= row.keys() or not row["sdx"]:
        return place
    root = np.array([[row[name] for name in line] for line in names])
    east = np.array((-math.sin(longitude), math.cos(longitude), 0.0))
    up = np.array(
        (math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude), math.sin(latitude))
    )
    turn = np.stack((east, np.cross(up, east), up))
    variance = np.diagonal(turn @ (np.sign(root) * root**2) @ turn.T)
    return place | {"sigma_enu_m": np.sqrt(np.where(variance >= 0.0, variance, np.nan))}


def _geodetic(place: tuple[float, float, float]) -> Values:
    latitude, longitude, height = place
    if not (abs(latitude) <= math.pi / 2 and abs(longitude) <= math.pi):
        raise LogError(f"latitude {math.degrees(latitude)}, longitude {math.degrees(longitude)} is no place")
    return {"latitude_rad": latitude, "longitude_rad": longitude, "height_m": height}


def _sigma(row: Row) -> Values:
    if not {"sdn", "sde", "sdu"} <= row.keys():
        return {}
    sigma_m = np.array((row["sde"], row["sdn"], row["sdu"]))
    if (sigma_m < 0.0).any():
        raise LogError(f"standard deviations {sigma_m.tolist()} m")
    return {"sigma_enu_m": sigma_m} if sigma_m.any() else {}


def _degrees(row: Row, name: str) -> float:
    """A column of degrees, or three of degrees, minutes and seconds, with the sign of the degrees."""
    if name in row:
        return row[name]
    degrees, minutes, seconds = (row[f"{name}:{part}"] for part in "dms")
    return math.copysign(abs(degrees) + minutes / 60.0 + seconds / 3600.0, degrees)


def _integer(row: Row, name: str) -> int:
    if name not in row or row[name] != int(row[name]) or row[name] < 0.0:
        raise LogError(f"{name} {row.get(name)} is not a number of its kind")
    return int(row[name])
