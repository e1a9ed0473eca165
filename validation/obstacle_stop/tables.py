"""Results of `headland validate` as Parquet tables and as text."""

import sys
from pathlib import Path
from typing import Any


def write_table(path: Path, name: str, rows: list[dict[str, Any]]) -> None:
    """Writes rows as Parquet, with the same columns for an empty table."""
    import pyarrow as pa
    from pyarrow import parquet

    schema = pa.schema([(key, getattr(pa, kind)()) for key, kind in COLUMNS[name].items()])
    flat = [{k: _flat(row.get(k)) for k in COLUMNS[name]} for row in rows]
    parquet.write_table(pa.Table.from_pylist(flat, schema=schema), path)


def _flat(value: Any) -> Any:
    return ",".join(map(str, value)) if isinstance(value, list) else value


_NUMBERS = dict.fromkeys(
    ("entry_s", "decision_s", "clearance_m", "stopping_distance_m", "required_range_m", "margin_m",
     "entry_clearance_m", "entry_speed_mps", "entry_stopping_distance_m", "least_margin_m", "relative_speed_mps",
     "first_range_m", "confirmed_range_m", "stop_requested_s", "request_delay_s"), "float64")  # fmt: skip
COLUMNS: dict[str, dict[str, str]] = {
    "encounters": {"log": "string", "id": "int64", "class": "string", "role": "string", "outcome": "string"}
    | _NUMBERS | {"is_stop_requested": "bool_"},
    "stops": {"log": "string", "t_s": "float64", "until_s": "float64", "reason": "string", "class": "string",
              "clearance_m": "float64", "objects": "string", "is_stop": "bool_", "is_false": "bool_"},
    "recall": {"class": "string", "from_m": "float64", "to_m": "float64", "n": "int64", "found": "int64",
               "recall": "float64", "low": "float64", "high": "float64"},
}  # fmt: skip


def summary_line(values: dict[str, Any]) -> str:
    """One line on the result of a log."""
    if "failed" in values:
        return f"failed to read: {values['failed'].splitlines()[0]}"
    outcomes = [e["outcome"] for e in values["encounters"]]
    counted_outcomes = ", ".join(f"{outcomes.count(o)} {o}" for o in dict.fromkeys(outcomes)) or "no encounter"
    return f"{counted_outcomes}; {len(values['stops'])} stop requests"


def print_table(result: dict[str, Any]) -> None:
    """Prints encounters and totals."""
    from validation.obstacle_stop.report import counted

    out = sys.stdout
    head = ("log", "object", "outcome", "entry", "clearance", "S", "required", "margin", "first range")
    out.write(f"{head[0]:<24}{head[1]:<16}{head[2]:<11}" + "".join(f"{h:>12}" for h in head[3:]) + "\n")
    for e in result["encounters"]:
        numbers = [
            e[k]
            for k in (
                "entry_s",
                "clearance_m",
                "stopping_distance_m",
                "required_range_m",
                "margin_m",
                "first_range_m",
            )
        ]
        text = "".join(f"{'—' if n is None else format(n, '.2f'):>12}" for n in numbers)
        out.write(f"{e['log'][:23]:<24}{e['role'][:15]:<16}{e['outcome']:<11}{text}\n")
    for failed in result["failed_to_read"]:
        out.write(f"failed to read: {failed['reason']}\n")
    for damaged in result["damaged"]:
        out.write(f"damaged: {damaged['log']}: {damaged['reason']}\n")
    out.write(f"missed: {counted(result['missed_share'], 100.0, '%')}\n")
    out.write(f"false stops: {counted(result['false_stops_per_hour'], 1.0, '/h')}\n")
    safe = ", ".join(
        f"{k}: {'not shown' if v is None else format(v, '.1f')} km/h" for k, v in result["safe_speed_kmh"].items()
    )
    out.write(
        f"highest safe speed {safe}\n{result['state'].replace('_', ' ')}; report: {result['run_dir']}/report.html\n"
    )
