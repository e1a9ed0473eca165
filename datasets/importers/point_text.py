"""Points as text: one per line, x y z [intensity] or with a line of names; separated by spaces, commas or semicolons.

Names of fields as in CloudCompare and VeloView; without names 3, 4 (intensity), 6 or 7 (and colour) columns. A first
line with the number of points (Leica PTS) is skipped. A table of numbers that no lidar measures (a trajectory, samples
of an IMU, geographic coordinates) is refused.
"""

import re

import numpy as np

from datasets.importers.point_clouds import TIME_FIELDS, time_unit_s
from datasets.importers.point_files import PointFormat, Points, name_of_field, points_of_text
from datasets.importers.recording import HEAD_BYTES
from messages.errors import LogError

NAME = "point text"
COLORS = ("red", "green", "blue")
COLUMNS = {
    3: ("x", "y", "z"),
    4: ("x", "y", "z", "intensity"),
    6: ("x", "y", "z", *COLORS),
    7: ("x", "y", "z", "intensity", *COLORS),
}
# Names besides x, y and z; a table with others (poses, say) is not taken for points.
OTHER_NAMES = {
    "intensity", "reflectivity", "i", "ring", "laser_id", "channel", "t", "time", "timestamp", "adjustedtime",
    "azimuth", "distance_m", "range", "vertical_angle", "r", "g", "b", *COLORS,
}  # fmt: skip
# Names of a comment above other tables
OTHER_TABLES = {
    *TIME_FIELDS, "lat", "lon", "latitude", "longitude", "ax", "ay", "az", "acc_x", "gyr_x", "roll", "pitch", "yaw"
}  # fmt: skip
# What any lidar measures: points per second, extent of all (m), most of the points nearer than this to their middle (m)
MIN_POINTS_PER_S, MIN_EXTENT_M, MAX_RANGE_M = 1000.0, 0.1, 1000.0
# Share of the rows with a later time than the one before
MIN_RISING = 0.95
# Fewer rows are not judged.
MIN_ROWS = 8


def is_point_text(head: bytes) -> bool:
    """Whether a file begins with lines of points only."""
    lines = head.decode("ascii", "replace").splitlines()
    lines = lines[:-1] if len(head) == HEAD_BYTES else lines  # the last may be cut
    try:
        return len(_parse(lines)) > 0
    except (LogError, ValueError):
        return False


def read_text(data: bytes) -> Points:
    """Points with the names of their columns; raises one of `DAMAGED` with the line, or the column of no points."""
    lines = data.decode("ascii").splitlines()
    points = _parse(lines)
    if len(points) >= MIN_ROWS and (reason := _implausible(points, lines)):
        raise LogError(f"a table that is no point cloud: {reason}")
    return points


def _implausible(points: Points, lines: list[str]) -> str:
    """Why no lidar has measured such points, empty if one may have."""
    names = points.dtype.names or ()
    head = [_words(line) for line in lines[: len(lines) - len(points) + 1]]
    is_named = any({"x", "y", "z"} <= set(found) for found in head)
    comment = next((found for found in head if len(found) == len(names) and set(found) & OTHER_TABLES), None)
    if not is_named and comment is not None:
        return f"its columns are {', '.join(comment)}"
    first = points[names[0]]
    if not is_named and (np.diff(first) > 0.0).mean() > MIN_RISING:
        return f"column 1 rises from row to row, from {first[0]} to {first[-1]}, as a time does"
    for name in () if is_named else (name for name in names if name in COLORS):
        values = points[name]
        if values.min() < 0.0 or (values.max() > 1.0 and (values % 1.0).any()):
            return f"column {names.index(name) + 1} is no colour, from {values.min()} to {values.max()}"
    for name in (name for name in TIME_FIELDS if name in names):
        span = float(np.ptp(points[name]))
        duration_s = span * time_unit_s(span, not (points[name] % 1.0).any())
        if len(points) < MIN_POINTS_PER_S * duration_s:
            return f"{len(points)} rows in {duration_s:.6g} s of column {names.index(name) + 1} ({name})"
    xyz_m = np.stack([points[name] for name in "xyz"], axis=1)
    xyz_m = xyz_m[np.isfinite(xyz_m).all(axis=1) & xyz_m.any(axis=1)]
    if len(xyz_m) < MIN_ROWS:
        return ""
    far_m = float(np.median(np.abs(xyz_m - np.median(xyz_m, axis=0)).max(axis=1)))
    columns = ", ".join(f"{names.index(name) + 1} ({name})" for name in "xyz")
    if far_m > MAX_RANGE_M:
        return f"columns {columns} are {far_m:.6g} m from their middle"
    if (np.ptp(xyz_m, axis=0)[:2] < MIN_EXTENT_M).all():
        return f"columns {columns} differ by less than {MIN_EXTENT_M} m (coordinates in degrees, or no coordinates)"
    return ""


def _words(line: str) -> list[str]:
    return [name_of_field(word) for word in re.split(r"[\s,;]+", line.lstrip("#/ ").strip())]


def _parse(lines: list[str]) -> Points:
    rows = [line.replace(",", " ").replace(";", " ").strip() for line in lines]
    names = None
    while rows and (names is None or not rows[0]):
        first = rows[0].lstrip("#/ ")
        found = _words(first)
        if {"x", "y", "z"} <= set(found):
            names = found
        elif first and not rows[0].startswith(("#", "//")) and not re.fullmatch(r"[0-9]+", first):
            break
        rows.pop(0)
    rows = [row for row in rows if row and not row.startswith(("#", "//"))]
    if not rows:
        raise LogError("it holds no points")
    names = names or list(COLUMNS.get(len(rows[0].split()), ()))
    if not names or not set(names) <= OTHER_NAMES | {"x", "y", "z"} or len(set(names)) < len(names):
        raise LogError(f"its columns are no points: {rows[0][:60]!r}")
    return points_of_text(rows, [(name, "f8") for name in names])


FORMAT = PointFormat("points", (".xyz", ".txt", ".csv", ".pts", ".asc"), is_point_text, read_text)
sniff = FORMAT.sniff
