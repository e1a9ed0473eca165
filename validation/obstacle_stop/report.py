"""The report on many logs: one self-contained HTML page."""

import base64
from collections.abc import Mapping
from html import escape
from typing import Any

from validation.drive.report import STYLE
from validation.obstacle_stop.figures import recall_figure

ENCOUNTER = (
    "log", "role", "class", "outcome", "entered_s", "clearance_m", "stopping_distance_m", "required_range_m",
    "margin_m", "entry_speed_mps",
    "relative_speed_mps", "first_range_m", "confirmed_range_m", "asked_after_s",
)  # fmt: skip
STOP = ("log", "t_s", "until_s", "reason", "class", "clearance_m", "objects", "is_stop", "is_false")
TOPIC = ("topic", "needed_for", "found", "count", "rate_hz", "longest_gap_s")
RECALL = ("class", "from_m", "to_m", "n", "found", "recall", "low", "high")


def render(result: Mapping[str, Any], inspections: list[dict[str, Any]], figures: Mapping[str, bytes]) -> str:
    """The page; `result` is the object of `--json`, `pictures` title → PNG of each encounter."""
    state = result["state"]
    parts = [
        f"<h1>Obstacle stops: <span class={state}>{state.replace('_', ' ')}</span></h1>",
        f"<p class=sub>{result['logs']} logs, {result['hours'] * 60.0:.1f} minutes, {result['driven_m']:.0f} m</p>",
        _facts(result),
        "<h2>Encounters</h2>" + table(ENCOUNTER, result["encounters"]),
        "<h2>Braking asked</h2>" + table(STOP, result["stops"]),
    ]
    if result["recall"]:
        parts.append("<h2>Recall by range and class</h2>" + _image("recall", recall_figure(result["recall"])))
        parts.append(table(RECALL, result["recall"]))
    if result["failed_to_read"]:
        parts.append("<h2>Failed to read</h2>" + table(("log", "reason"), result["failed_to_read"]))
    if result["damaged"]:
        parts.append("<h2>Damaged</h2>" + table(("log", "reason"), result["damaged"]))
    parts += [f"<h2>{escape(title)}</h2>{_image(title, png)}" for title, png in figures.items()]
    parts += [_inspection(values) for values in inspections]
    head = f'<meta charset="utf-8"><title>Headland: obstacle stops</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>'


def _facts(result: Mapping[str, Any]) -> str:
    safe = result["safe_speed_kmh"]
    rows = [
        {"figure": "missed", "value": counted(result["missed_share"], 100.0, "%")},
        {"figure": "false stops an hour", "value": counted(result["false_stops_per_hour"], 1.0, "/h")},
        {"figure": "outcomes", "value": ", ".join(f"{n} {name}" for name, n in result["outcomes"].items()) or "none"},
        {"figure": "highest safe speed", "value": ", ".join(f"{k}: {cell(v)} km/h" for k, v in safe.items())},
        *({"figure": "not kept", "value": text} for text in result["broken"]),
    ]
    return table(("figure", "value"), rows)


def counted(share: Mapping[str, Any] | None, factor: float, unit: str) -> str:
    """A count with its exact 95 % bounds, or that it was not shown."""
    if share is None:
        return "not shown"
    of = f" of {share['of']}" if "of" in share else f" in {share['hours']:.3f} h"
    high = "∞" if share["high"] is None else f"{factor * share['high']:.3g}"
    return f"{share['count']}{of} (95 %: {factor * share['low']:.3g} to {high} {unit})"


def table(keys: tuple[str, ...], rows: list[dict[str, Any]]) -> str:
    """Rows as an HTML table."""
    if not rows:
        return "<p>None.</p>"
    head = "".join(f"<th>{escape(key.replace('_', ' '))}</th>" for key in keys)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell(row.get(k)))}</td>" for k in keys) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def cell(value: object) -> str:
    """A value for the eye."""
    if value is None:
        return "—"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.2f}"
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _image(title: str, png: bytes) -> str:
    return f'<img alt="{escape(title)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def _inspection(values: dict[str, Any]) -> str:
    notes = "".join(f"<li>{escape(text)}</li>" for text in (*values["notes"], *values["not_shown"]))
    return f"<h2>Input: {escape(values['log'])}</h2><ul>{notes}</ul>{table(TOPIC, values['topics'])}"
