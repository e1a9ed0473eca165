"""Worked area from the true path of the implement, compared with the planned area."""

from dataclasses import dataclass

import numpy as np
from shapely import Polygon, unary_union
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from messages.plan import UncoveredArea
from messages.truth import TrueMachine

MIN_AREA_M2 = 0.5  # smaller slivers come from the sampling of the true path


@dataclass(frozen=True)
class Uncovered:
    """A part of the planned area that was not worked; `x_m`, `y_m` its centroid in map."""

    reason: str
    area_m2: float
    x_m: float
    y_m: float


@dataclass(frozen=True)
class Coverage:
    """Areas in m²; `share` is worked over planned area without the areas listed as uncovered."""

    planned_m2: float
    worked_m2: float
    share: float
    uncovered: tuple[Uncovered, ...]


def worked_area(truth: list[TrueMachine], width_m: float) -> BaseGeometry:
    """Area that the implement passed over while working."""
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
    """Compares planned and worked area; lists every uncovered part with reason and position."""
    listed = unary_union([Polygon(np.asarray(piece.outline_map_m)).buffer(0) for piece in uncovered_areas])
    missing = planned.difference(worked.buffer(0.02))
    pieces = [piece for piece in getattr(missing, "geoms", [missing]) if piece.area >= MIN_AREA_M2]
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
