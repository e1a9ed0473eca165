"""Draws docs/protective-field.svg from the configured machine, implement and safety values."""

import sys
from pathlib import Path

import numpy as np

from configs.strict import CONFIGS, find, load
from configs.vehicle import ImplementFile, Vehicle, kmh
from geometry.arrays import Float64
from runtime.run_folder import ROOT
from runtime.stack import load_stack
from safety.stopping_distance import required_range, stopping_distance

TARGET = ROOT / "docs/protective-field.svg"
SPEED_KMH, RADIUS_M = 10.0, 30.0
BLUE, RED, GREEN, BROWN, GREY = "#1f6fb2", "#c62828", "#2f7d32", "#8d6e4a", "#607d8b"


def band(length_m: float, start_m: float, half_width_m: float, radius_m: float) -> Float64:
    """Outline (N, 2) in `base` of a strip along an arc to the left that begins `start_m` ahead of the rear axle."""
    s = np.linspace(start_m, start_m + length_m, 40)
    left, right = (
        np.column_stack([r * np.sin(s / radius_m), radius_m - r * np.cos(s / radius_m)])
        for r in (radius_m - half_width_m, radius_m + half_width_m)
    )
    return np.vstack([left, right[::-1]])


def draw(target: Path) -> None:
    """Top view: machine and implement, area within S and within the required range, heights as text."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "headland"
    from matplotlib import pyplot

    vehicle = load(Vehicle, CONFIGS / "machines/tractor_e.yaml")
    implement = load(ImplementFile, find("implements", "harrow_6m")).implement
    safety = load_stack().safety
    field, braking = safety.field, safety.braking.flat
    v = kmh(SPEED_KMH)
    s_m = stopping_distance(v, braking)
    required_m = required_range(v, braking, field.margin_m)
    half = 0.5 * implement.width_m + field.lateral_margin_far_m
    body, ends = vehicle.body, sorted(implement.ends_m)

    figure, ax = pyplot.subplots(figsize=(9.0, 4.6), layout="constrained")
    ax.fill(*band(required_m, body.front_m, half, RADIUS_M).T, color=BLUE, alpha=0.18, lw=0)
    ax.fill(*band(s_m, body.front_m, half, RADIUS_M).T, color=RED, alpha=0.22, lw=0)
    ax.fill(*_box((-body.rear_m, body.front_m), 0.5 * body.width_m), color=GREEN, alpha=0.8)
    ax.fill(*_box((ends[0], ends[1]), 0.5 * implement.width_m), color=BROWN, alpha=0.8)
    t = np.linspace(0.0, body.front_m + required_m + 4.0, 60)
    ax.plot(RADIUS_M * np.sin(t / RADIUS_M), RADIUS_M * (1.0 - np.cos(t / RADIUS_M)), "--", color=GREY, lw=1.0)
    end = float(RADIUS_M * (1.0 - np.cos(t[-1] / RADIUS_M)))
    ax.text(t[-1] - 0.6, end, "planned path", color=GREY, ha="right", va="bottom")
    ax.text(body.front_m + 0.3, -half - 0.2, f"S = {s_m:.1f} m at {SPEED_KMH:.0f} km/h: stop", color=RED, va="top")
    ax.text(body.front_m + 0.3, -half - 0.9, f"required range = S + margin = {required_m:.1f} m: speed limit",
            color=BLUE, va="top")  # fmt: skip
    middle = 0.5 * (body.front_m - body.rear_m)
    ax.text(middle, -0.5, "machine", color="white", ha="center", va="center")
    label = f"implement, {implement.width_m:.1f} m"
    ax.text(0.5 * sum(ends), 0.0, label, color="white", ha="center", va="center", rotation=90)
    heights = (
        f"width: swept by machine and implement, plus {field.lateral_margin_near_m:.1f} to "
        f"{field.lateral_margin_far_m:.1f} m\n"
        f"height: {field.min_height_m:.2f} m + {100 * field.min_height_slope:.0f} % of the distance, up to "
        f"{body.height_m + field.overhead_margin_m:.1f} m\n"
        f"τ = {braking.reaction_s} s, t_b = {braking.build_up_s} s, a = {braking.deceleration_mps2} m/s²"
    )  # fmt: skip
    ax.text(0.99, 0.02, heights, transform=ax.transAxes, ha="right", va="bottom", fontsize=9)
    ax.set_aspect("equal")
    ax.set_xlim(ends[0] - 1.5, body.front_m + required_m + 9.0)
    ax.set_axis_off()
    figure.savefig(target, metadata={"Date": None})
    pyplot.close(figure)


def _box(x_m: tuple[float, float], half_width_m: float) -> tuple[list[float], list[float]]:
    return [x_m[0], x_m[1], x_m[1], x_m[0]], [-half_width_m, -half_width_m, half_width_m, half_width_m]


if __name__ == "__main__":
    draw(TARGET)
    sys.exit(0)
