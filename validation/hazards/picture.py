"""Picture of a failed drive: machine, implement and objects from above at the moment of the failure, as PNG."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
import shapely

from geometry.prism import Solids
from validation.hazards.judge import Judgement
from validation.hazards.tracks import Drive

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MACHINE, TOOL, OBJECT, SITE, TRACK, PLACE = "#2f7d32", "#8d6e63", "#c62828", "#78909c", "#90a4ae", "#ff8f00"
HALF_VIEW_M = 9.0


def draw(drive: Drive, judgement: Judgement, title: str) -> bytes:
    """Top view at the first contact, else at the first false stop."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    contact = min(judgement.contacts, key=lambda row: row.contact_s, default=None)
    stop = judgement.false_stops[0] if judgement.false_stops else None
    t_s = contact.contact_s if contact else stop.t_s if stop else float(drive.machine.t_s[-1])
    figure, ax = pyplot.subplots(figsize=(5, 5), layout="constrained")
    _scene(ax, drive, t_s)
    if contact is not None:
        ax.plot([contact.x_m], [contact.y_m], "x", color=PLACE, markersize=12, markeredgewidth=3)
        text = f"{contact.name} ({contact.kind}) by {contact.part} at {contact.impact_mps:.2f} m/s, t {t_s:.1f} s"
    else:
        text = f"{stop.cause if stop else ''}, t {t_s:.1f} s"
    ax.set_title(f"{title}\n{text}", fontsize=9)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=80, metadata={"Software": None})
    pyplot.close(figure)
    return out.getvalue()


def _scene(ax: Axes, drive: Drive, t_s: float) -> None:
    state = drive.machine.at(t_s)
    body = drive.body_at(state).moved(*state.pose)
    ax.plot(drive.machine.pose[:, 0], drive.machine.pose[:, 1], color=TRACK, linewidth=1)
    count = len(drive.shapes.machine.names)
    for k, polygon in enumerate(body.polygons):
        _fill(ax, polygon, MACHINE if k < count else TOOL)
    for one in drive.objects:
        if one.is_present(t_s):
            for polygon in _near(one.shape_at(t_s), state.x_m, state.y_m):
                _fill(ax, polygon, SITE if one.is_static else OBJECT)
    ax.set_xlim(state.x_m - HALF_VIEW_M, state.x_m + HALF_VIEW_M)
    ax.set_ylim(state.y_m - HALF_VIEW_M, state.y_m + HALF_VIEW_M)
    ax.set_aspect("equal")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")


def _near(shape: Solids, x_m: float, y_m: float) -> list[shapely.Geometry]:
    view = shapely.box(x_m - HALF_VIEW_M, y_m - HALF_VIEW_M, x_m + HALF_VIEW_M, y_m + HALF_VIEW_M)
    return [polygon for polygon in shape.polygons if polygon.intersects(view)]


def _fill(ax: Axes, polygon: shapely.Geometry, colour: str) -> None:
    ring = np.asarray(shapely.get_coordinates(polygon))
    ax.fill(ring[:, 0], ring[:, 1], color=colour, alpha=0.35, linewidth=0.8)
