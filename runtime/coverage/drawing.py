"""Picture of the coverage: one map for each state and body height."""

from pathlib import Path
from typing import Any

import numpy as np

from configs.vehicle import Implement, Vehicle, outlines
from runtime.coverage.evaluation import Coverage

COLOURS = {"not reached": "#ffffff", "covered": "#a6d8a8", "enclosed": "#f3d27a", "uncovered": "#c0392b"}
SEEN = "#e8f3e8"  # covered, but not reached


def draw(found: list[Coverage], vehicle: Vehicle, implement: Implement | None, file: Path) -> None:
    """Writes a PNG: rows are states, columns body heights; x of base points up."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    heights = sorted({one.height_m for one in found})
    states = list(dict.fromkeys(one.state.name for one in found))
    figure = Figure(figsize=(3.2 * len(heights) + 0.6, 3.6 * len(states) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(len(states), len(heights), squeeze=False, sharex=True, sharey=True)
    colours = ListedColormap(["#ffffff", SEEN, COLOURS["covered"], COLOURS["enclosed"], COLOURS["uncovered"]])
    for one in found:
        ax = axes[states.index(one.state.name)][heights.index(one.height_m)]
        kind = np.where(one.is_covered, 1, 0)
        kind[one.is_reached & one.is_covered] = 2
        kind[one.is_reached & ~one.is_covered & one.is_enclosed] = 3
        kind[one.is_uncovered] = 4
        x, y = one.places.x_m, one.places.y_m
        ax.imshow(
            kind, origin="lower", extent=(y[0], y[-1], x[0], x[-1]), cmap=colours, vmin=0, vmax=4,
            interpolation="nearest", aspect="equal",
        )  # fmt: skip
        shape = implement and (implement.folded if one.state.is_folded else implement)
        for body in outlines(vehicle.body, shape):
            corners = np.vstack([body.corners_m, body.corners_m[:1]])
            ax.plot(corners[:, 1], corners[:, 0], color="black", linewidth=0.8)
        ax.set_title(f"{one.state.name}, {one.height_m:g} m", fontsize=9)
    axes[0][0].invert_xaxis()  # y of base points left
    for ax in axes[-1]:
        ax.set_xlabel("y in m", fontsize=8)
    for ax in axes[:, 0]:
        ax.set_ylabel("x in m", fontsize=8)
    handles = [Patch(color=colour, label=name) for name, colour in list(COLOURS.items())[1:]]
    figure.legend(
        handles=[*handles, Patch(color=SEEN, label="covered, not reached")], loc="outside lower center", ncols=4
    )
    figure.savefig(file, format="png", dpi=80)
