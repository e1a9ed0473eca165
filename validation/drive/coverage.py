"""Worked area from the implement's true way, against what was planned."""

from dataclasses import dataclass

import numpy as np
from shapely import Polygon, unary_union
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from messages.plan import UncoveredArea
from messages.truth import TrueMachine

SMALLEST_M2 = 0.5  # slivers below this come from the sampling of the true way


@dataclass(frozen=True)
class Uncovered:
    """A planned piece that was not worked."""

    reason: str
    area_m2: float
    x_m: float
    y_m: float


@dataclass(frozen=True)
class Coverage:
    """Areas in m²; `share` is worked over planned, what is listed as left out not counted."""

    planned_m2: float
    worked_m2: float
    share: float
    uncovered: tuple[Uncovered, ...]


def worked_area(truth: list[TrueMachine], width_m: float) -> BaseGeometry:
    """The ground that the implement went over while it worked."""
    runs: list[list[tuple[float, float]]] = [[]]
    for machine in truth:
        if machine.is_working:
            runs[-1].append((float(machine.p_implement_map_m[0]), float(machine.p_implement_map_m[1])))
        elif runs[-1]:
            runs.append([])
    lines = [LineString(run) for run in runs if len(run) > 1]
    return unary_union([line.buffer(width_m / 2.0, cap_style="flat") for line in lines])


def measure_coverage(
    planned: BaseGeometry, worked: BaseGeometry, uncovered_areas: tuple[UncoveredArea, ...]
) -> Coverage:
    """Compare; every uncovered piece is listed with its reason and place."""
    listed = unary_union([Polygon(np.asarray(piece.outline_map_m)).buffer(0) for piece in uncovered_areas])
    missing = planned.difference(worked.buffer(0.02))
    pieces = [piece for piece in getattr(missing, "geoms", [missing]) if piece.area >= SMALLEST_M2]
    uncovered = tuple(
        Uncovered(
            _reason(piece, uncovered_areas),
            round(piece.area, 2),
            round(piece.centroid.x, 2),
            round(piece.centroid.y, 2),
        )
        for piece in pieces
    )
    due = planned.difference(listed)
    share = due.intersection(worked).area / due.area if due.area else 0.0
    return Coverage(planned.area, worked.area, share, uncovered)


def _reason(piece: BaseGeometry, uncovered_areas: tuple[UncoveredArea, ...]) -> str:
    for out in uncovered_areas:
        if Polygon(np.asarray(out.outline_map_m)).buffer(0).intersects(piece):
            return out.reason
    return "not worked"
