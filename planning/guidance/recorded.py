"""Guidance lines of a field file as lines in `map`."""

import math
from collections.abc import Sequence

import numpy as np

from configs.mission import Work
from geometry.geodesy import Datum
from geometry.polyline import polyline
from messages.errors import FieldError
from planning.field.formats.contents import LonLat, RecordedLine
from planning.guidance.line import Circle, Curve, Straight, a_plus, ab
from planning.guidance.offset_lines import check_simple

A_PLUS_LENGTH_M = 100.0
SHOWN = 8
Line = Straight | Circle | Curve


def choose_line(lines: Sequence[RecordedLine], wanted: str) -> RecordedLine:
    """The guidance line with this name or, from 1, number; raises FieldError that lists the lines."""
    text = wanted.strip()
    named = [line for line in lines if line.name == text]
    if not named and text.isascii() and text.isdecimal() and 1 <= int(text[:9]) <= len(lines):
        return lines[int(text[:9]) - 1]
    if len(named) == 1:
        return named[0]
    why = f"{len(named)} guidance lines are named" if named else "no guidance line"
    raise FieldError(f"{why} {wanted[:60]!r}; the field has: {listed(lines) or 'none'}")


def listed(lines: Sequence[RecordedLine]) -> str:
    """Numbers, names and kinds of lines."""
    shown = [f"{k + 1} {line.name!r} ({line.kind})" for k, line in enumerate(lines[:SHOWN])]
    return ", ".join(shown) + (f" and {len(lines) - SHOWN} more" if len(lines) > SHOWN else "")


def line_in_map(recorded: RecordedLine, datum: Datum) -> Line:
    """The line about a datum; raises FieldError where its points do not make one."""
    points = [_to_map(p, datum) for p in recorded.points]
    try:
        if recorded.kind == "ab":
            return ab(points[0], points[-1])
        if recorded.kind == "a_plus":
            return a_plus(points[0], math.radians(90.0 - (recorded.heading_deg or 0.0)), A_PLUS_LENGTH_M)
        if recorded.kind == "pivot":
            return Circle(points[0], recorded.radius_m or 0.0, recorded.is_clockwise)
        return Curve(polyline(np.array(points)))
    except (FieldError, ValueError) as error:
        raise FieldError(f"guidance line {recorded.name!r}: {error}") from error


def work_along(work: Work, recorded: RecordedLine, datum: Datum) -> Work:
    """Field work whose swaths are parallel to a line of a field file; raises FieldError for a line that is none."""
    line = line_in_map(recorded, datum)
    free = {"swath_direction_deg": None, "swath_through_m": None, "swath_curve_m": (), "swath_circle_m": None}
    if isinstance(line, Straight):
        found = {"swath_direction_deg": math.degrees(line.heading_rad), "swath_through_m": line.a_m}
    elif isinstance(line, Circle):
        found = {"swath_circle_m": (*line.center_m, line.radius_m)}
    else:
        try:
            check_simple(line)
        except FieldError as error:
            raise FieldError(f"guidance line {recorded.name!r}: {error}") from error
        found = {"swath_curve_m": tuple((float(x), float(y)) for x, y in line.points_m)}
    return work.model_copy(update=free | found)


def _to_map(point: LonLat, datum: Datum) -> tuple[float, float]:
    x, y, _ = datum.to_map(math.radians(point[1]), math.radians(point[0]), 0.0)
    return x, y
