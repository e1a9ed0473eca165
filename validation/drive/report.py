"""Report of a drive: one self-contained HTML page."""

from collections.abc import Mapping
from typing import Any

from validation.drive.summary import Summary
from validation.html import render_page

RANGES = ("sensor", "class", "samples", "detected", "farthest_m", "always_detected_m")


def render(
    summary: Summary, result: Mapping[str, Any], figures: Mapping[str, bytes], ranges: list[dict[str, Any]]
) -> str:
    """The page; `result` is the object of `run --json`, `ranges` the rows of `detections.range_rows`."""
    return render_page(
        "drive.html",
        outcome=result["outcome"],
        seed=result["seed"],
        digest=result["digest"],
        facts=_facts(result),
        verdicts=summary.verdicts,
        stops=[
            (
                s.t_s, s.cause, s.label, s.role or "not announced",
                s.range_m, s.stopping_distance_m, s.required_range_m, s.margin_m,
            )
            for s in summary.stops
        ],
        uncovered=[(u.reason, u.area_m2, u.x_m, u.y_m) for u in summary.coverage.uncovered],
        ranges=[tuple(row[key] for key in RANGES) for row in ranges],
        figures=figures,
    )  # fmt: skip


def _facts(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    xte, dock_m = result["xte_m"] or {}, result["dock_error_m"]
    dock = "—" if dock_m is None else f"{100 * dock_m:.1f} cm, {result['dock_error_deg']:.2f}°"
    return [
        ("simulated time", f"{result['simulated_s']:.0f} s in {result['wall_s']:.0f} s"),
        ("distance", f"{result['distance_m']:.0f} m"),
        ("of it among plants that hide who lies, with consent", f"{result['in_plants_m']:.0f} m"),
        ("worked area", f"{result['worked_m2']:.0f} m²"),
        ("planned share of the field", f"{100 * result['planned_share']:.1f} %"),
        ("coverage of the planned area", f"{100 * result['coverage']:.2f} %"),
        ("cross-track error on the swaths (σ, mean, max)", ", ".join(f"{100 * v:.1f} cm" for v in xte.values()) or "—"),
        ("largest shift of the line by the operator", f"{100 * result['line_shift_m']:.0f} cm"),
        ("dock error", dock),
        ("contacts, zone exits, false stops", f"{result['contacts']}, {result['zone_exits']}, {result['false_stops']}"),
    ]
