"""A plan as a figure (PNG)."""

import warnings
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import shapely

from configs.site import Shed, Site
from geometry.footprint import footprints
from geometry.polygon import parts
from messages.plan import PathSectionType
from planning.docking.dock import Docking
from planning.plan import EDGE_MARGIN, GUIDANCE_BEND, NARROW_PART, NARROW_PASSAGE, TIGHT_CORNER, Plan

COLOURS = {
    PathSectionType.LANE: "#404040", PathSectionType.HEADLAND: "#1f5fa8", PathSectionType.SWATH: "#1a7f37",
    PathSectionType.TURN: "#d9822b", PathSectionType.DETOUR: "#8a2be2",
    PathSectionType.DOCK: "#8a2be2",
}  # fmt: skip
UNCOVERED = {
    EDGE_MARGIN: "#f4c7c3", TIGHT_CORNER: "#d62728", GUIDANCE_BEND: "#ff9896", NARROW_PART: "#e377c2",
    NARROW_PASSAGE: "#8c564b",
}  # fmt: skip


def draw_plan(plan: Plan, site: Site, file: FilePath) -> None:
    """Writes a PNG: field, lanes, gate, yard, shed, planned strips, uncovered areas, path by section type, refills."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot()
    axes.set_aspect("equal")
    for shape in parts(plan.planned_area):
        _fill(axes, shape, "#cfe8cf")
    for part in plan.uncovered:
        for shape in parts(part.outline):
            _fill(axes, shape, UNCOVERED[part.reason])
    for reason, area_m2 in plan.uncovered_m2.items():
        axes.fill([], [], color=UNCOVERED[reason], label=f"{reason}: {area_m2:.0f} m²")
    axes.fill(*zip(*site.yard.outline_m, strict=True), color="#e6e0d4")
    if site.shed is not None:
        _draw_shed(axes, site.shed, plan.docking)
    axes.plot(*zip(*site.boundary_m, site.boundary_m[0], strict=True), color="black", linewidth=1.5)
    for area in site.no_go:
        axes.fill(*zip(*area.outline_m, strict=True), color="#9cc4e4")
    for gate in site.gates:
        axes.plot(*zip(*gate.posts_m, strict=True), "s", color="#b22222", markersize=4)
    shown: set[PathSectionType] = set()
    for path in plan.paths:
        for section in path.sections:
            label = None if section.section_type in shown else str(section.section_type)
            shown.add(section.section_type)
            line = path.p_map_m[section.first : section.last + 2]
            axes.plot(line[:, 0], line[:, 1], color=COLOURS[section.section_type], linewidth=1.0, label=label)
    for (x, y), numbers in plan.refill_labels.items():
        axes.plot(x, y, "D", color="#d62728", markersize=7, zorder=3)
        axes.annotate(f"refill {numbers}", (x, y), xytext=(6, 6), textcoords="offset points", fontsize=9, zorder=3)
    worked = f", {plan.planned_share:.1%} of {plan.field_area_m2 / 1e4:.2f} ha" if plan.planned_share > 0.0 else ""
    axes.set_title(f"{site.name}: {plan.length_m:.0f} m{worked}", parse_math=False)
    axes.set_xlabel("east in m")
    axes.set_ylabel("north in m")
    axes.legend(loc="upper right", fontsize=8)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # a name in a script that no installed font has
        figure.savefig(file, format="png", dpi=110)


def _draw_shed(axes: Any, shed: Shed, docking: Docking | None) -> None:
    """Roof, walls, posts, bays, and the docked rig."""
    axes.fill(*zip(*shed.outline_m, strict=True), color="#d3cab8")
    for wall in shed.walls_m:
        axes.plot(*zip(*wall, strict=True), color="black", linewidth=2.0)
    for post in shed.posts:
        axes.plot(*post.at_m, "o", color="black", markersize=2)
    for bay in shed.bays:
        axes.annotate(bay.name, (bay.dock.x_m, bay.dock.y_m), ha="center", va="center", fontsize=6)
    if docking is not None:
        dock = docking.bay.dock
        pose = np.array([[dock.x_m, dock.y_m]]), np.radians([dock.heading_deg])
        for body in footprints(docking.rig.bodies, *pose)[0]:
            axes.plot(*body.exterior.xy, color=COLOURS[PathSectionType.DOCK], linewidth=0.8)


def _fill(axes: Any, shape: shapely.Polygon, colour: str) -> None:
    """Polygon with its holes."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    rings = [shape.exterior, *shape.interiors]
    outline = Outline.make_compound_path(*(Outline(list(ring.coords)) for ring in rings))
    axes.add_patch(PathPatch(outline, facecolor=colour, edgecolor="none"))
