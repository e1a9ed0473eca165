"""Report on the evaluated logs: one self-contained HTML page."""

from collections.abc import Mapping
from typing import Any

from validation.html import render_page
from validation.obstacle_stop.figures import recall_figure

ENCOUNTER = (
    "log", "role", "class", "outcome", "entry_s", "clearance_m", "stopping_distance_m", "required_range_m", "margin_m",
    "entry_speed_mps", "relative_speed_mps", "first_range_m", "confirmed_range_m", "request_delay_s",
)  # fmt: skip
STOP = ("log", "t_s", "until_s", "reason", "class", "clearance_m", "objects", "is_stop", "is_false")
TOPIC = ("topic", "needed_for", "found", "count", "rate_hz", "longest_gap_s")
RECALL = ("class", "from_m", "to_m", "n", "found", "recall", "low", "high")


def render(result: Mapping[str, Any], inspections: list[dict[str, Any]], figures: Mapping[str, bytes]) -> str:
    """The page; `result` is the object of `--json`, `figures` title → PNG of each encounter."""
    return render_page(
        "obstacle_stop.html",
        result=result,
        facts=_facts(result),
        recall_png=recall_figure(result["recall"]) if result["recall"] else b"",
        figures=figures,
        inspections=inspections,
        encounter_keys=ENCOUNTER,
        stop_keys=STOP,
        topic_keys=TOPIC,
        recall_keys=RECALL,
    )


def _facts(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    safe = {k: "—" if v is None else f"{v:.2f}" for k, v in result["safe_speed_kmh"].items()}
    return [
        ("missed", counted(result["missed_share"], 100.0, "%")),
        ("false stops per hour", counted(result["false_stops_per_hour"], 1.0, "/h")),
        ("outcomes", ", ".join(f"{n} {name}" for name, n in result["outcomes"].items()) or "none"),
        ("highest safe speed", ", ".join(f"{k}: {v} km/h" for k, v in safe.items())),
        *(("violated", text) for text in result["violations"]),
    ]


def counted(share: Mapping[str, Any] | None, factor: float, unit: str) -> str:
    """A count with its exact 95 % bounds, or "not shown"."""
    if share is None:
        return "not shown"
    of = f" of {share['of']}" if "of" in share else f" in {share['hours']:.3f} h"
    high = "∞" if share["high"] is None else f"{factor * share['high']:.3g}"
    return f"{share['count']}{of} (95 %: {factor * share['low']:.3g} to {high} {unit})"
