"""Figures of the detections by sensor and of the docking, as PNG bytes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from configs.site import Bay, Shed
from geometry.arrays import Float64
from geometry.footprint import Bodies, place
from validation.drive.detections import DetectionSample, share_rows
from validation.obstacle_stop.figures import draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN_M = 30.0
MAX_PAUSE_S = 20.0  # samples further apart belong to different approaches
LINE_BREAK_S = 1.0
LENGTH_M = 12.0
TRUE, WALL, DRIVEN, REVERSED, DOCK, LAST = "#90a4ae", "#5d4037", "#2f7d32", "#c62828", "#5c6bc0", "#1b2a1e"


def detections_figure(samples: Sequence[DetectionSample], first_ns: int) -> bytes | None:
    """Range over time of each near object: truth as a line, detections as dots; None without detections."""
    near = [sample for sample in samples if sample.range_m <= SHOWN_M]
    roles = [
        role
        for role in dict.fromkeys(sample.role for sample in near)
        if any(x.is_detected for x in near if x.role == role)
    ]
    sensors = sorted({sample.sensor for sample in near})

    def plot(axes: Sequence[Axes]) -> None:
        for ax, role in zip(axes, roles, strict=True):
            mine = nearest_approach([sample for sample in near if sample.role == role])
            _over_time(ax, mine, sensors, first_ns)
            ax.set(title=f"{role} ({mine[0].label})", xlabel="time (s)", ylabel="range from the sensor (m)")
        axes[0].legend(fontsize=7)

    return draw(plot, len(roles), (5.0 * len(roles), 4.2)) if roles else None


def nearest_approach(samples: list[DetectionSample]) -> list[DetectionSample]:
    """The samples around the nearest one, without a pause above `MAX_PAUSE_S`."""
    samples = sorted(samples, key=lambda sample: sample.stamp_ns)
    nearest = min(range(len(samples)), key=lambda k: samples[k].range_m)
    gaps = np.diff([sample.stamp_ns for sample in samples]) > MAX_PAUSE_S * 1e9
    breaks = np.concatenate([[0], np.flatnonzero(gaps) + 1, [len(samples)]])
    k = int(np.searchsorted(breaks, nearest, side="right")) - 1
    return samples[int(breaks[k]) : int(breaks[k + 1])]


def _over_time(ax: Axes, samples: list[DetectionSample], sensors: list[str], first_ns: int) -> None:
    for k, sensor in enumerate(sensors):
        mine = [sample for sample in samples if sample.sensor == sensor]
        t = np.array([(sample.stamp_ns - first_ns) * 1e-9 for sample in mine])
        pauses = np.flatnonzero(np.diff(t) > LINE_BREAK_S) + 1
        true = np.insert(np.array([sample.range_m for sample in mine]), pauses, np.nan)
        ax.plot(np.insert(t, pauses, np.nan), true, "-", color=TRUE, lw=0.8, zorder=1)
        ax.plot(t, [sample.detected_m for sample in mine], ".", color=f"C{k % 10}", ms=3, label=sensor, zorder=2)


def shares_figure(samples: Sequence[DetectionSample]) -> bytes | None:
    """Share of samples with a detection over range, by class and sensor; None without samples."""
    rows = share_rows(samples)
    labels = list(dict.fromkeys(row["class"] for row in rows))
    sensors = sorted({row["sensor"] for row in rows})

    def plot(axes: Sequence[Axes]) -> None:
        for ax, label in zip(axes, labels, strict=True):
            for k, sensor in enumerate(sensors):
                mine = [row for row in rows if (row["class"], row["sensor"]) == (label, sensor)]
                x, y = [0.5 * (r["from_m"] + r["to_m"]) for r in mine], [r["share"] for r in mine]
                ax.plot(x, y, ".-", color=f"C{k % 10}", label=sensor)
                ax.fill_between(x, [r["low"] for r in mine], [r["high"] for r in mine], color=f"C{k % 10}", alpha=0.12)
            ax.set(
                title=label, xlabel="range from the sensor (m)", ylabel="share of samples detected", ylim=(-0.03, 1.05)
            )
        axes[0].legend(fontsize=7)

    return draw(plot, len(labels), (5.0 * len(labels), 4.2)) if labels else None


def docking_figure(shed: Shed, bay: Bay, poses: Float64, speed_mps: Float64, bodies: Bodies) -> bytes:
    """Top view: walls, posts, dock pose, driven path of base (reverse in red), last outline."""

    def plot(axes: Sequence[Axes]) -> None:
        for ax, half_m in zip(axes, (16.0, 4.5), strict=True):
            _shed(ax, shed)
            _dock(ax, bay, bodies)
            _driven(ax, poses, speed_mps, bodies)
            middle = math.radians(bay.dock.heading_deg)
            x, y = bay.dock.x_m + 0.6 * half_m * math.cos(middle), bay.dock.y_m + 0.6 * half_m * math.sin(middle)
            ax.set(xlim=(x - half_m, x + half_m), ylim=(y - half_m, y + half_m), aspect="equal", xlabel="east (m)")
        axes[0].set_ylabel("north (m)")
        axes[0].legend(fontsize=7, loc="upper right")

    return draw(plot, 2, (11.0, 5.6))


def _shed(ax: Axes, shed: Shed) -> None:
    from matplotlib.patches import Circle

    roof = np.array([*shed.outline_m, shed.outline_m[0]])
    ax.plot(*roof.T, color=WALL, lw=0.8, ls=":", label="roof")
    for wall in shed.walls_m:
        ax.plot(*np.array(wall).T, color=WALL, lw=3)
    for post in shed.posts:
        ax.add_patch(Circle(post.at_m, post.radius_m, color=WALL))


def _dock(ax: Axes, bay: Bay, bodies: Bodies) -> None:
    heading = math.radians(bay.dock.heading_deg)
    at, axis = np.array([bay.dock.x_m, bay.dock.y_m]), np.array([math.cos(heading), math.sin(heading)])
    for side in (-0.5, 0.5):
        edge = at + side * bay.width_m * np.array([-axis[1], axis[0]])
        ax.plot(*np.array([edge, edge + LENGTH_M * axis]).T, color=DOCK, lw=0.8, ls="--")
    _outline(ax, np.array([*at, heading]), bodies, DOCK, "dock pose")


def _driven(ax: Axes, poses: Float64, speed_mps: Float64, bodies: Bodies) -> None:
    for is_mine, color, label in ((speed_mps >= 0.0, DRIVEN, "forward"), (speed_mps < 0.0, REVERSED, "reverse")):
        x, y = (np.where(is_mine, poses[:, k], np.nan) for k in (0, 1))
        ax.plot(x, y, color=color, lw=1.2, label=label)
    if len(poses):
        _outline(ax, poses[-1], bodies, LAST, "last")


def _outline(ax: Axes, pose: Float64, bodies: Bodies, color: str, label: str) -> None:
    for k, body in enumerate(bodies):
        ring = place(body.corners_m, pose[None, :2], pose[2:3])[0]
        ax.plot(*np.vstack([ring, ring[:1]]).T, color=color, lw=1.0, label=label if k == 0 else None)
