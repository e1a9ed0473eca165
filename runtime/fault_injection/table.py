"""Result table of the fault injection campaign, as HTML and Parquet."""

from pathlib import Path
from statistics import median
from typing import Any

from simulation.faults.config import Demand
from validation.html import render_page

COLUMNS = {
    "situation": "string", "topic": "string", "fault": "string", "demand": "string", "speed_mps": "float64",
    "travel_m": "float64", "allowed_m": "float64", "stopped_s": "float64", "named_s": "float64",
    "is_naming_demanded": "bool_", "path_error_m": "float64", "contacts": "int64", "zone_exits": "int64",
    "reason": "string", "alarms": "string", "is_misattributed": "bool_", "passed": "bool_", "failure": "string",
    "why": "string",
}  # fmt: skip


def write_tables(folder: Path, rows: list[dict[str, Any]]) -> None:
    """`table.html` and `table.parquet`."""
    import pyarrow as pa
    from pyarrow import parquet

    schema = pa.schema([(name, getattr(pa, kind)()) for name, kind in COLUMNS.items()])
    parquet.write_table(pa.Table.from_pylist(rows, schema=schema), folder / "table.parquet")
    (folder / "table.html").write_text(page(rows), encoding="utf-8")


def page(rows: list[dict[str, Any]]) -> str:
    """HTML page with totals and table; failed cells come first and are marked."""
    ordered = sorted(rows, key=lambda row: bool(row["passed"]))
    failures = [k for k, row in enumerate(ordered) if not row["passed"]]
    return render_page(
        "table.html", title="Fault injection", totals=totals(rows), keys=tuple(COLUMNS), rows=ordered, number="%.2f",
        failures=failures,
    )  # fmt: skip


def totals(rows: list[dict[str, Any]]) -> str:
    """Totals of the campaign in one line."""
    values = summary(rows)
    return (
        f"{values['passed']} of {values['cells']} cells passed; {values['stops_within']} of {values['stops_demanded']} "
        f"demanded stops within the stopping distance; {values['named']} of {values['naming_demanded']} named where "
        f"that is demanded, after {_seconds(values['named_median_s'])} (median), at most "
        f"{_seconds(values['named_worst_s'])}; {values['contacts']} contacts, {values['zone_exits']} zone exits; "
        "attributed to another device in "
        f"{values['misattributed']}; never named: {', '.join(values['never_named']) or 'none'}"
    )


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts of the campaign, and by target and fault what was never named where that is demanded."""
    stops = [row for row in rows if row["demand"] == Demand.STOP.value]
    naming = [row for row in rows if row["is_naming_demanded"]]
    times = [row["named_s"] for row in naming if row["named_s"] is not None]
    never = {f"{row['topic']} {row['fault']}" for row in naming if row["named_s"] is None}
    return {
        "cells": len(rows), "passed": sum(bool(row["passed"]) for row in rows), "stops_demanded": len(stops),
        "stops_within": sum(row["travel_m"] is not None and row["travel_m"] <= row["allowed_m"] for row in stops),
        "naming_demanded": len(naming), "named": len(times), "named_median_s": median(times) if times else None,
        "named_worst_s": max(times, default=None), "never_named": sorted(never),
        "contacts": sum(row["contacts"] for row in rows), "zone_exits": sum(row["zone_exits"] for row in rows),
        "misattributed": sum(bool(row["is_misattributed"]) for row in rows),
    }  # fmt: skip


def _seconds(value: float | None) -> str:
    return "—" if value is None else f"{value:.2f} s"
