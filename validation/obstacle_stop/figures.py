"""Figures of the report as PNG bytes: encounters seen from above, and recall over range."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from validation.obstacle_stop.observation import LogObservation, Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OWN, CORRIDOR, POINT, BOX, THIS, SPEED = "#1b2a1e", "#2f7d32", "#90a4ae", "#5c6bc0", "#c62828", "#ef6c00"


def draw(plot: Callable[[Sequence[Axes]], None], columns: int, size: tuple[float, float]) -> bytes:
    """PNG of a row of axes filled by `plot`."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, columns, figsize=size, squeeze=False, layout="constrained")
    plot(list(axes[0]))
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100, metadata={"Software": None})
    pyplot.close(figure)
    return out.getvalue()


def encounter_figure(encounter: dict[str, Any], observed: LogObservation, front_m: float, width_m: float) -> bytes:
    """Scenes at entry and at the smallest clearance, and clearance and S over time."""
    scenes = [
        observed.scenes[key]
        for key in ((encounter["id"], "entry"), (encounter["id"], "least"))
        if key in observed.scenes
    ]

    def plot(axes: Sequence[Axes]) -> None:
        for ax, scene, title in zip(axes, scenes, ("entry", "smallest clearance"), strict=False):
            _from_above(ax, scene, encounter["role"], front_m, width_m)
            ax.set_title(f"{title}, {scene.t_s:.1f} s", fontsize=9)
        _over_time(axes[-1], encounter, observed)

    return draw(plot, len(scenes) + 1, (3.7 * (len(scenes) + 1), 4.2))


def _from_above(ax: Axes, scene: Scene, role: str, front_m: float, width_m: float) -> None:
    ax.plot(-scene.points_m[:, 1], scene.points_m[:, 0], ".", color=POINT, ms=1.2, mew=0)
    ax.fill(-scene.corridor_m[:, 1], scene.corridor_m[:, 0], color=CORRIDOR, alpha=0.15, lw=0)
    half = 0.5 * width_m
    ax.fill([-half, half, half, -half], [-1.0, -1.0, front_m, front_m], color=OWN)
    for name, corners in scene.boxes:
        ring = np.vstack([corners, corners[:1]])
        color = THIS if name == role else BOX
        ax.plot(-ring[:, 1], ring[:, 0], color=color, lw=1.4 if name == role else 0.8)
        if abs(corners[:, 1].mean()) < 14.0 and -4.0 < corners[:, 0].mean() < 40.0:
            ax.text(-corners[:, 1].mean(), corners[:, 0].max() + 0.4, name, fontsize=6, color=color, ha="center")
    ax.set(xlim=(-14, 14), ylim=(-4, 36), aspect="equal", xlabel="right (m)", ylabel="ahead (m)")


def _over_time(ax: Axes, encounter: dict[str, Any], observed: LogObservation) -> None:
    t, gaps, needed = zip(*encounter["gaps"], strict=True)
    ax.plot(t, gaps, ".-", color=THIS, label="clearance")
    ax.plot(t, needed, "-", color=SPEED, lw=1, label="S")
    requested = [observed.time_s(r.receive_ns) for r in observed.requests if encounter["id"] in r.touched]
    ax.plot(requested, np.zeros(len(requested)), "|", color=OWN, label="braking requested")
    ax.set(xlim=(t[0] - 1.0, t[-1] + 0.5), ylim=(-0.5, None), xlabel="s", ylabel="m")
    margin = "—" if encounter["margin_m"] is None else f"{encounter['margin_m']:.1f} m"
    ax.set_title(f"{encounter['outcome']}: margin {margin}", fontsize=9)
    ax.legend(fontsize=7)


def recall_figure(rows: list[dict[str, Any]]) -> bytes:
    """Recall over range with 95 % bounds, by class."""

    def plot(axes: Sequence[Axes]) -> None:
        for label in dict.fromkeys(row["class"] for row in rows):
            mine = [row for row in rows if row["class"] == label]
            x = [0.5 * (row["from_m"] + row["to_m"]) for row in mine]
            y = np.array([row["recall"] for row in mine])
            spread = np.array([[r["recall"] - r["low"] for r in mine], [r["high"] - r["recall"] for r in mine]])
            axes[0].errorbar(x, y, yerr=np.maximum(spread, 0.0), marker="o", capsize=3, lw=1, label=label)
        axes[0].set(xlabel="range from the front (m)", ylabel="recall (strict rule)", ylim=(0, 1.05))
        axes[0].legend(fontsize=8)

    return draw(plot, 1, (8.0, 3.5))
