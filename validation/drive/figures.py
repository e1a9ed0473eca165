"""Figures of the drive report, as PNG bytes."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from shapely import Polygon

from messages.plan import PathSectionType
from validation.drive.record import DriveRecord, stamps_of, true_poses
from validation.drive.summary import Planned, Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SWATH, OTHER, STOP, SIGMA = "#2f7d32", "#90a4ae", "#c62828", "#ffb300"


def draw_all(record: DriveRecord, planned: Planned, summary: Summary) -> dict[str, bytes]:
    """Title → PNG of every figure."""
    return {
        "Track over plan": _draw(lambda axes: _track(axes[0], record, planned, summary), 1, 10.0),
        "Cross-track error": _draw(lambda axes: _cross_track(axes, record, summary), 2, 4.5),
        "Speed, stops and their causes": _draw(lambda axes: _speed(axes[0], record, summary), 1, 3.5),
        "Localization error against its stated sigma": _draw(lambda axes: _position(axes, record, summary), 2, 4.5),
    }


def _draw(plot: object, rows: int, height: float) -> bytes:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure: Figure
    figure, axes = pyplot.subplots(rows, 1, figsize=(11, height), squeeze=False, layout="constrained")
    assert callable(plot)
    plot(axes[:, 0])
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    pyplot.close(figure)
    return out.getvalue()


def _track(ax: Axes, record: DriveRecord, planned: Planned, summary: Summary) -> None:
    for polygon in getattr(planned.area, "geoms", [planned.area]):
        if isinstance(polygon, Polygon):
            ax.fill(*np.array(polygon.exterior.coords).T, color="#e8f5e9", zorder=0)
    first = next(iter(record.paths.values()), None)
    for path in record.paths.values():
        ax.plot(*path.p_map_m.T, color=OTHER, lw=2.5, label="plan" if path is first else None)
    poses = true_poses(record.truth)
    ax.plot(poses[:, 0], poses[:, 1], color=SWATH, lw=0.9, label="driven")
    for piece in summary.coverage.uncovered:
        ax.plot(piece.x_m, piece.y_m, "s", color=SIGMA, ms=7)
    stamps = stamps_of(record.truth)
    for number, stop in enumerate(summary.stops, 1):
        k = min(int(np.searchsorted(stamps, record.first_ns + round(stop.t_s * 1e9))), len(poses) - 1)
        ax.plot(poses[k, 0], poses[k, 1], "o", color=STOP, ms=7)
        label, at = f"{number} {stop.role or stop.cause}", (float(poses[k, 0]), float(poses[k, 1]))
        ax.annotate(label, at, xytext=(6, 6), textcoords="offset points", color=STOP)
    ax.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
    ax.legend(loc="upper right")


def _cross_track(axes: np.ndarray, record: DriveRecord, summary: Summary) -> None:
    track = summary.cross_track
    t = (track.stamp_ns - record.first_ns) * 1e-9
    swath = np.array([section_type is PathSectionType.SWATH for section_type in track.section_type], bool) & (
        track.is_working > 0
    )
    headland = np.array([section_type is PathSectionType.HEADLAND for section_type in track.section_type], bool) & (
        track.is_working > 0
    )
    for chosen, color, label in ((headland, OTHER, "headland passes"), (swath, SWATH, "swaths")):
        axes[0].plot(t[chosen], 100 * track.xte_m[chosen], ".", color=color, ms=2, label=label)
    axes[0].axhspan(-2.5, 2.5, color="#e8f5e9", zorder=0)
    axes[0].set(xlabel="time (s)", ylabel="error (cm)", ylim=(-10, 10))
    axes[0].legend(loc="upper right")
    axes[1].hist(100 * track.xte_m[swath], bins=60, color=SWATH)
    axes[1].set(xlabel="error on the swaths (cm)", ylabel="samples")


def _speed(ax: Axes, record: DriveRecord, summary: Summary) -> None:
    truth = record.truth
    t = (stamps_of(truth) - record.first_ns) * 1e-9
    ax.plot(t, [3.6 * m.speed_mps for m in truth], color=SWATH, lw=1)
    for number, stop in enumerate(summary.stops, 1):
        ax.axvline(stop.t_s, color=STOP, lw=1)
        ax.text(
            stop.t_s,
            ax.get_ylim()[1],
            f"{number} {stop.role or stop.cause}",
            color=STOP,
            rotation=90,
            va="top",
            fontsize=8,
        )
    ax.set(xlabel="time (s)", ylabel="speed (km/h)")


def _position(axes: np.ndarray, record: DriveRecord, summary: Summary) -> None:
    error = summary.position
    t = (error.stamp_ns - record.first_ns) * 1e-9
    axes[0].plot(t, 100 * error.across_m, color=SWATH, lw=0.7)
    axes[0].plot(t, 100 * error.along_m, color=OTHER, lw=0.7)
    for sign in (-2, 2):
        axes[0].plot(t, sign * 100 * error.sigma_across_m, color=SIGMA, lw=1)
    axes[0].set(xlabel="time (s)", ylabel="across, along (cm), ±2σ", ylim=(-10, 10))
    axes[1].plot(t, np.degrees(error.heading_rad), color=SWATH, lw=0.7)
    for sign in (-2, 2):
        axes[1].plot(t, sign * np.degrees(error.sigma_heading_rad), color=SIGMA, lw=1)
    axes[1].set(xlabel="time (s)", ylabel="heading (°), ±2σ", ylim=(-1, 1))
