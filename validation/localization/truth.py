"""Truth of a recording: positions by stamp from TUM, CSV, arrays, or the fixes of another recording.

    TUM     stamp_s x y z qx qy qz qw in `map`, its datum in a line `# datum LATITUDE_DEG LONGITUDE_DEG HEIGHT_M`
    CSV     header with stamp_s (or time) and latitude_deg, longitude_deg[, height_m], or x_m, y_m[, z_m]
    folder  comma2k19's `global_pose`: frame_times (s) and frame_positions (earth-fixed)
    else    any recording with fixes, such as RTKLIB's .pos

Positions in metres without a datum have an unknown frame: they are turned and shifted to the trajectory.
"""

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.importers.comma2k19 import read_array
from datasets.importers.formats import open_recording
from geometry.arrays import Float64, Int64
from geometry.geodesy import Datum, ellipsoidal
from messages.errors import LogError
from messages.sensors import GnssFix, GnssSolution

TIMES, ECEF = "frame_times", "frame_positions"
STAMPS = ("stamp_s", "time", "t", "timestamp")
FORMATS = "TUM, CSV with stamp_s and latitude_deg, longitude_deg or x_m, y_m, comma2k19's global_pose, or fixes"


@dataclass(frozen=True, eq=False)
class Truth:
    """Horizontal positions (N, 2) at increasing stamps (N,), of the antenna or of base.

    `is_placed`: in `map`; otherwise in an unknown frame.
    """

    source: str
    stamps_ns: Int64
    p_m: Float64
    is_antenna: bool
    is_placed: bool


def read_truth(path: Path, datum: Datum) -> Truth:
    """Truth of a file or folder in the `map` of a datum; raises LogError that names what is wrong."""
    if path.is_dir() and (path / TIMES).is_file():
        return _of_arrays(path, datum)
    if path.is_file() and (text := _text(path)) is not None:
        rows = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
        if rows and all(len(row) == 8 for row in rows[:20]) and _is_number(rows[0][0]):
            return _of_tum(path, text, rows, datum)
        if (first := text.lstrip().partition("\n")[0].lower()) and any(name in _names(first) for name in STAMPS):
            return _of_csv(path, text, datum)
    try:
        return of_fixes(str(path), (m for _, _, m in open_recording(path).read() if isinstance(m, GnssFix)), datum)
    except LogError as error:
        raise LogError(f"{path}: no truth that is read ({FORMATS}): {error}") from error


def of_fixes(source: str, fixes: Iterable[GnssFix], datum: Datum) -> Truth:
    """The antenna positions of fixes; raises LogError without any."""
    found = [
        f for f in fixes if f.solution is not GnssSolution.NONE and math.isfinite(f.latitude_rad + f.longitude_rad)
    ]
    if not found:
        raise LogError(f"{source}: no fix")
    stamps = [f.stamp_ns for f in found]
    height_m = [f.height_m if math.isfinite(f.height_m) else datum.height_m for f in found]
    places = [datum.to_map(f.latitude_rad, f.longitude_rad, h) for f, h in zip(found, height_m, strict=True)]
    return _truth(source, stamps, places, is_antenna=True, is_placed=True)


def _text(path: Path) -> str | None:
    """Text of a table, None for bytes of another kind."""
    try:
        data = path.read_bytes()
        return None if b"\0" in data[:4096] else data.decode()
    except UnicodeDecodeError:
        return None
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _names(line: str) -> list[str]:
    return [name.strip().strip('"') for name in line.split(",")]


def _of_arrays(path: Path, datum: Datum) -> Truth:
    times, ecef = read_array(path / TIMES), read_array(path / ECEF)
    if times.ndim != 1 or ecef.shape != (len(times), 3):
        raise LogError(f"{path}: {TIMES} {times.shape} and {ECEF} {ecef.shape} do not fit")
    places = [datum.to_map(*ellipsoidal(*row)) for row in ecef.tolist()]
    return _truth(str(path), np.rint(times * 1e9).astype(np.int64).tolist(), places, is_antenna=True, is_placed=True)


def _of_tum(path: Path, text: str, rows: list[list[str]], datum: Datum) -> Truth:
    own = next((line.split()[2:5] for line in text.splitlines() if line.startswith("# datum ")), None)
    try:
        values = np.array(rows, np.float64)
        other = None if own is None else Datum(math.radians(float(own[0])), math.radians(float(own[1])), float(own[2]))
    except (ValueError, IndexError) as error:
        raise LogError(f"{path}: not a TUM file: {error}") from error
    stamps = [_stamp(row[0], path) for row in rows]
    places = values[:, 1:4].tolist()
    if other is not None:
        places = [datum.to_map(*other.to_ellipsoid(*p)) for p in places]
    return _truth(str(path), stamps, places, is_antenna=False, is_placed=other is not None)


def _stamp(word: str, path: Path) -> int:
    """Seconds as text to ns, without the rounding of a float."""
    if not _is_number(word):
        raise LogError(f"{path}: {word!r} is not a time in s")
    whole, _, fraction = word.partition(".")
    if fraction.isdigit() and whole.lstrip("+").isdigit():
        return int(whole) * 10**9 + int(fraction[:9].ljust(9, "0"))
    return round(float(word) * 1e9)


def _of_csv(path: Path, text: str, datum: Datum) -> Truth:
    reader = csv.reader(io.StringIO(text))
    names = [name.strip().lower() for name in next(reader)]
    column = {name: k for k, name in enumerate(names)}
    stamp = next(column[name] for name in STAMPS if name in column)
    is_geodetic = {"latitude_deg", "longitude_deg"} <= column.keys()
    if not is_geodetic and not {"x_m", "y_m"} <= column.keys():
        raise LogError(f"{path}: columns {', '.join(names)}; needed are latitude_deg, longitude_deg or x_m, y_m")
    keys = ("latitude_deg", "longitude_deg", "height_m") if is_geodetic else ("x_m", "y_m", "z_m")
    stamps, places = [], []
    for number, row in enumerate(reader, start=2):
        if not row:
            continue
        words = [row[column[k]] if k in column and column[k] < len(row) else "0" for k in keys]
        if len(row) <= stamp or not all(map(_is_number, words)):
            raise LogError(f"{path}:{number}: {','.join(row)[:60]!r} is not a row of numbers")
        a, b, c = map(float, words)
        c = datum.height_m if is_geodetic and "height_m" not in column else c
        stamps.append(_stamp(row[stamp], path))
        places.append(datum.to_map(math.radians(a), math.radians(b), c) if is_geodetic else (a, b, c))
    return _truth(str(path), stamps, places, is_antenna=is_geodetic, is_placed=is_geodetic)


def _truth(
    source: str, stamps: list[int], places: list[tuple[float, float, float]], *, is_antenna: bool, is_placed: bool
) -> Truth:
    t, p = np.array(stamps, np.int64), np.array(places, np.float64).reshape(-1, 3)[:, :2]
    order = np.argsort(t, kind="stable")
    keep = np.concatenate([[True], np.diff(t[order]) > 0]) & np.isfinite(p[order]).all(axis=1) if len(t) else order
    if not len(t) or not keep.any():
        raise LogError(f"{source}: no position")
    return Truth(source, t[order][keep], p[order][keep], is_antenna, is_placed)
