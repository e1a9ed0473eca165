"""The report of a drive: one self-contained HTML page."""

import base64
from collections.abc import Mapping
from html import escape
from typing import Any

from validation.drive.summary import Summary
from validation.verdict import State

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:72rem;margin:2rem auto;padding:0 1rem;color:#1b2a1e}
h1{font-size:1.6rem;margin-bottom:.2rem} h2{font-size:1.15rem;margin-top:2rem}
table{border-collapse:collapse;width:100%} td,th{padding:.3rem .6rem;border-bottom:1px solid #d7ded8;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums} img{width:100%;border:1px solid #d7ded8;background:#fff}
.passed{color:#2f7d32}.failed{color:#c62828;font-weight:600}.not_shown{color:#8d6e00} .sub{color:#5b6b5e}
"""


def render(
    summary: Summary, result: Mapping[str, Any], pictures: Mapping[str, bytes], ranges: list[dict[str, Any]]
) -> str:
    """The page; `result` is the object of `run --json`, `ranges` what `detections.range_rows` gives."""
    parts = [
        f"<h1>Headland: mission {escape(str(result['outcome']))}</h1>",
        f"<p class=sub>seed {result['seed']} · log digest <code>{escape(str(result['digest']))}</code></p>",
        _facts(result),
        "<h2>Verdicts</h2>" + _verdicts(summary),
        "<h2>Stops</h2>" + _stops(summary),
        "<h2>Planned but not worked</h2>" + _uncovered(summary),
        "<h2>Detections beside the truth</h2>" + _ranges(ranges),
    ]
    for title, png in pictures.items():
        data = base64.b64encode(png).decode()
        parts.append(f'<h2>{escape(title)}</h2><img alt="{escape(title)}" src="data:image/png;base64,{data}">')
    head = f'<meta charset="utf-8"><title>Headland report</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>'


def _table(header: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join("<tr>" + "".join(_cell(value) for value in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _cell(value: object) -> str:
    if isinstance(value, State):
        return f'<td class="{value.value}">{value.value.replace("_", " ")}</td>'
    if isinstance(value, float):
        return f"<td class=n>{value:.3f}</td>"
    return f"<td>{'—' if value is None else escape(str(value))}</td>"


def _facts(result: Mapping[str, Any]) -> str:
    xte = result["xte_m"] or {}
    shown = {
        "simulated time": f"{result['simulated_s']:.0f} s in {result['wall_s']:.0f} s",
        "distance": f"{result['distance_m']:.0f} m",
        "worked": f"{result['worked_m2']:.0f} m²",
        "planned share of the field": f"{100 * result['planned_share']:.1f} %",
        "coverage of what was due": f"{100 * result['coverage']:.2f} %",
        "cross-track error on the swaths (σ, mean, max)": ", ".join(f"{100 * v:.1f} cm" for v in xte.values()) or "—",
        "dock error": f"{100 * result['dock_error_m']:.1f} cm, {result['dock_error_deg']:.2f}°"
        if result["dock_error_m"] is not None
        else "—",
        "contacts, zone_exits, false stops": f"{result['contacts']}, {result['zone_exits']}, {result['false_stops']}",
    }
    return _table(("figure", "value"), list(shown.items()))


def _verdicts(summary: Summary) -> str:
    rows: list[tuple[object, ...]] = [
        (v.clause, v.state, v.measured, v.limit, v.unit, v.n, v.evidence) for v in summary.verdicts
    ]
    return _table(("clause", "state", "measured", "limit", "unit", "trials", "evidence"), rows)


def _stops(summary: Summary) -> str:
    header = ("t (s)", "cause", "class seen", "role", "first gap (m)", "S (m)", "needed (m)", "left (m)")
    rows: list[tuple[object, ...]] = [
        (
            s.t_s,
            s.cause,
            s.label,
            s.role or "not announced",
            s.range_m,
            s.stopping_distance_m,
            s.required_range_m,
            s.margin_m,
        )
        for s in summary.stops
    ]
    return _table(header, rows) if rows else "<p>None.</p>"


def _uncovered(summary: Summary) -> str:
    rows: list[tuple[object, ...]] = [(u.reason, u.area_m2, u.x_m, u.y_m) for u in summary.coverage.uncovered]
    return _table(("reason", "m²", "east (m)", "north (m)"), rows) if rows else "<p>Nothing.</p>"


def _ranges(ranges: list[dict[str, Any]]) -> str:
    header = ("sensor", "class", "looks", "told", "farthest (m)", "always told within (m)")
    keys = ("sensor", "class", "looks", "found", "farthest_m", "held_from_m")
    rows = [tuple(row[key] for key in keys) for row in ranges]
    return _table(header, rows) if rows else "<p>No object of the scenario was in view of a sensor.</p>"
