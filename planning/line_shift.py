"""Sideways shift of the driven line by the operator (row joining): it compensates the drift of a position."""

import math

from messages.plan import Path, PathSectionType

LEAD_M = 6.0  # before a swath the shift is in force, so that control has reached it where work begins


class LineShift:
    """Sum of the nudges as a vector in `map`, the same for all swaths: the distance between them does not change."""

    def __init__(self, max_m: float) -> None:
        self._max_m = max_m
        self._x_m = self._y_m = 0.0

    def nudge(self, left_m: float, path: Path, s_m: float) -> None:
        """Adds a step to the left of the machine; no effect off a swath, and where the sum were above the limit."""
        yaw = _heading(path, s_m)
        x_m, y_m = self._x_m - left_m * math.sin(yaw), self._y_m + left_m * math.cos(yaw)
        is_on_swath = path.section_at(s_m).section_type is PathSectionType.SWATH
        if is_on_swath and math.hypot(x_m, y_m) <= self._max_m + 1e-6:
            self._x_m, self._y_m = x_m, y_m

    def reset(self) -> None:
        """Ends the shift."""
        self._x_m = self._y_m = 0.0

    def at(self, path: Path, s_m: float) -> tuple[float, float, float]:
        """Shift at a position (m): x and y in `map`, and the part to the left of the machine; 0 off the swaths."""
        near = path.section_at(s_m), path.section_at(s_m + LEAD_M)
        if not any(section.section_type is PathSectionType.SWATH for section in near):
            return 0.0, 0.0, 0.0
        yaw = _heading(path, s_m)
        return self._x_m, self._y_m, self._y_m * math.cos(yaw) - self._x_m * math.sin(yaw)


def _heading(path: Path, s_m: float) -> float:
    return float(path.heading_rad[path.index_at(s_m)])
