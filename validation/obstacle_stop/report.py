"""Report on the evaluated logs: one self-contained HTML page, readable on a phone."""

import shlex
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from validation.html import render_page
from validation.obstacle_stop.figures import recall_figure
from validation.obstacle_stop.headline import bounds

BAD = ("missed", "late")
MAIN = (
    ("in the path from", "entry_s", "s"), ("clearance", "clearance_m", "m"), ("S", "stopping_distance_m", "m"),
    ("margin", "margin_m", "m"), ("stop requested", "stop_requested_s", "s"),
)  # fmt: skip
NOT_LISTED = ("log", "id", "role", "class", "outcome", "picture", "gaps", *(key for _, key, _ in MAIN))
UNITS = {"s": "s", "m": "m", "mps": "m/s", "radps": "rad/s"}
STOP = ("log", "t_s", "until_s", "reason", "class", "clearance_m", "objects", "is_stop", "is_false")
TOPIC = ("topic", "needed_for", "found", "count", "rate_hz", "longest_gap_s")
STREAM = ("source", "source_type", "topic", "read", "skipped", "reasons")
RECALL = ("class", "from_m", "to_m", "n", "found", "recall", "low", "high")
BEFORE_S, AFTER_S = 3.0, 4.0  # excerpt around an encounter


def render(result: Mapping[str, Any], logs: Sequence[Mapping[str, Any]], figures: Mapping[str, bytes]) -> str:
    """The page; `result` is the object of `--json`, `logs` the results by log, `figures` PNG by file name."""
    read = {log["log"]: log for log in logs if "failed" not in log}
    encounters = sorted(result["encounters"], key=lambda e: e["outcome"] not in BAD)
    return render_page(
        "obstacle_stop.html",
        result=result,
        blocking=[finding for finding in result["findings"] if finding["is_blocking"]],
        remarks=[finding for finding in result["findings"] if not finding["is_blocking"]],
        reasons=_reasons(result),
        facts=_facts(result),
        encounters=[_card(one, read[one["log"]], result["run_dir"], figures) for one in encounters],
        recall_png=recall_figure(result["recall"]) if result["recall"] else b"",
        proposals=[
            (log["log"], sum("picture" in line for line in log["proposal"]))
            for log in read.values()
            if "proposal" in log
        ],
        inspections=[log["inspection"] | {"streams": _streams(log["inspection"])} for log in read.values()],
        stop_keys=STOP,
        topic_keys=TOPIC,
        stream_keys=STREAM,
        recall_keys=RECALL,
    )


def _reasons(result: Mapping[str, Any]) -> list[dict[str, str]]:
    """Reasons for *not shown* that no finding states."""
    texts = {finding["text"] for finding in result["findings"]}
    return [one for one in result["not_shown"] if one["reason"] not in texts]


def _streams(inspection: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of all streams with their reasons as text."""
    return [
        row | {"reasons": ", ".join(f"{count or '?'} × {reason}" for reason, count in row["reasons"].items())}
        for row in inspection["streams"]
    ]


def _facts(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Totals as (name, value)."""
    safe = ", ".join(f"{v:.1f} km/h ({k})" for k, v in result["safe_speed_kmh"].items() if v is not None)
    missed, false_stops = bounds(result)
    scans, causes = result.get("false_stop_scans"), result.get("false_stop_causes") or {}
    return [
        ("missed", missed),
        ("false stops", false_stops),
        *([("scans with a false stop", f"{scans['count']} of {scans['of']}")] if scans else []),
        *([("causes of false stops", ", ".join(f"{n} × {cause}" for cause, n in causes.items()))] if causes else []),
        ("outcomes", ", ".join(f"{n} {name}" for name, n in result["outcomes"].items()) or "none"),
        ("highest safe speed", safe or "not shown"),
        *(("violated", text) for text in result["violations"]),
    ]


def _card(one: Mapping[str, Any], log: Mapping[str, Any], run_dir: str, figures: Mapping[str, bytes]) -> dict[str, Any]:
    """One encounter: outcome, main values, other values, time in the log, commands and picture."""
    entry_s = one["entry_s"] or 0.0
    clock = datetime.fromtimestamp(0, UTC) + timedelta(microseconds=round(log.get("first_ns", 0) / 1e3 + entry_s * 1e6))
    replay = shlex.quote(f"{run_dir}/logs/{one['log']}/replay.mcap")
    window = f"--from {max(0.0, entry_s - BEFORE_S):.1f} --to {entry_s + AFTER_S:.1f}"
    rest = [(key, value) for key, value in one.items() if key not in NOT_LISTED and not isinstance(value, list)]
    return {
        "name": one["role"] or f"{one['class']} {one['id']}",
        "log": one["log"],
        "outcome": one["outcome"],
        "is_bad": one["outcome"] in BAD,
        "main": [(name, _number(one.get(key), unit)) for name, key, unit in MAIN],
        "rest": [_named(key, value) for key, value in rest],
        "clock": f"{clock:%Y-%m-%d %H:%M:%S}.{clock.microsecond // 1000:03d} UTC",
        "command": f"./headland import {replay} {window} --out encounter.mcap",
        "png": figures.get(one.get("picture") or ""),
    }


def _number(value: Any, unit: str) -> str:
    return "—" if value is None else f"{value:.2f} {unit}"


def _named(key: str, value: Any) -> tuple[str, str]:
    """Name and value with the unit that its key ends with."""
    name, _, ending = key.rpartition("_")
    if ending in UNITS and name and not isinstance(value, bool):
        return name.replace("_", " "), _number(value, UNITS[ending])
    text = {True: "yes", False: "no", None: "—"}.get(value) if isinstance(value, bool | None) else str(value)
    return key.replace("_", " "), str(text)
