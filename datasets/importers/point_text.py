"""Points as text: one per line, x y z [intensity] or with a line of names; separated by spaces, commas or semicolons.

Names of fields as in CloudCompare and VeloView; without names 3, 4 (intensity), 6 or 7 (and colour) columns. A first
line with the number of points (Leica PTS) is skipped.
"""

import re

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


def is_point_text(head: bytes) -> bool:
    """Whether a file begins with lines of points only."""
    lines = head.decode("ascii", "replace").splitlines()
    lines = lines[:-1] if len(head) == HEAD_BYTES else lines  # the last may be cut
    try:
        return len(_parse(lines)) > 0
    except (LogError, ValueError):
        return False


def read_text(data: bytes) -> Points:
    """Points with the names of their columns; raises one of `DAMAGED` with the line."""
    return _parse(data.decode("ascii").splitlines())


def _parse(lines: list[str]) -> Points:
    rows = [line.replace(",", " ").replace(";", " ").strip() for line in lines]
    names = None
    while rows and (names is None or not rows[0]):
        first = rows[0].lstrip("#/ ")
        found = [name_of_field(word) for word in first.split()]
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
