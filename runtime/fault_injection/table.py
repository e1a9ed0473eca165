"""Result table of the fault injection campaign, as HTML and Parquet."""

from pathlib import Path
from typing import Any

from validation.html import render_page

COLUMNS = {
    "situation": "string", "topic": "string", "fault": "string", "speed_mps": "float64", "travel_m": "float64",
    "allowed_m": "float64", "stopping_distance_m": "float64", "stopped_s": "float64", "path_error_m": "float64",
    "contacts": "int64", "zone_exits": "int64", "reason": "string", "alarms": "string",
    "is_fault_identified": "bool_", "is_misattributed": "bool_", "passed": "bool_", "failure": "string",
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
    stopped = [row for row in rows if row["travel_m"] is not None]
    late_stops = [row for row in stopped if row["allowed_m"] is not None and row["travel_m"] > row["allowed_m"]]
    required = [row for row in stopped if row["allowed_m"] is not None]
    within = sum(row["travel_m"] <= row["stopping_distance_m"] for row in required)
    identified = sum(bool(row["is_fault_identified"]) for row in required)
    return (
        f"{sum(bool(row['passed']) for row in rows)} of {len(rows)} cells passed; {len(late_stops)} stopped late; "
        f"{sum(row['contacts'] for row in rows)} contacts, {sum(row['zone_exits'] for row in rows)} zone exits; "
        f"{within} of {len(required)} required stops within the stopping distance alone; "
        f"device identified in {identified} of {len(required)} required stops; "
        f"attributed to another device in {sum(bool(row['is_misattributed']) for row in rows)}"
    )
