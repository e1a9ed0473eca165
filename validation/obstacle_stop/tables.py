"""Results of `headland validate` as Parquet tables and as text."""

import io
import sys
from typing import Any


def table(name: str, rows: list[dict[str, Any]]) -> bytes:
    """Rows as a Parquet file, with the same columns for an empty table."""
    import pyarrow as pa
    from pyarrow import parquet

    schema = pa.schema([(key, getattr(pa, kind)()) for key, kind in COLUMNS[name].items()])
    flat = [{k: _flat(row.get(k)) for k in COLUMNS[name]} for row in rows]
    out = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist(flat, schema=schema), out)
    return out.getvalue()


def _flat(value: Any) -> Any:
    return ",".join(map(str, value)) if isinstance(value, list) else value


_NUMBERS = dict.fromkeys(
    ("entry_s", "decision_s", "clearance_m", "stopping_distance_m", "due_s", "margin_m",
     "entry_clearance_m", "entry_speed_mps", "entry_stopping_distance_m", "least_margin_m", "relative_speed_mps",
     "first_range_m", "confirmed_range_m", "stop_requested_s", "request_delay_s", "exit_s", "standstill_s",
     "impact_speed_mps", "visible_s", "visible_range_m"), "float64")  # fmt: skip
COLUMNS: dict[str, dict[str, str]] = {
    "encounters": {"log": "string", "id": "int64", "class": "string", "role": "string", "outcome": "string"}
    | _NUMBERS | {"is_stop_requested": "bool_", "has_contact": "bool_", "direction": "int64"},
    "stops": {"log": "string", "t_s": "float64", "until_s": "float64", "reason": "string", "class": "string",
              "clearance_m": "float64", "objects": "string", "is_stop": "bool_", "is_false": "bool_"},
    "recall": {"class": "string", "from_m": "float64", "to_m": "float64", "n": "int64", "found": "int64",
               "recall": "float64", "low": "float64", "high": "float64"},
}  # fmt: skip


PRINTED = ("entry_s", "clearance_m", "stopping_distance_m", "margin_m", "first_range_m")


def summary_line(values: dict[str, Any]) -> str:
    """One line on the result of a log."""
    if "failed" in values:
        return f"failed to read: {values['failed'].splitlines()[0]}"
    outcomes = [e["outcome"] for e in values["encounters"]]
    counted_outcomes = ", ".join(f"{outcomes.count(o)} {o}" for o in dict.fromkeys(outcomes)) or "no encounter"
    return f"{counted_outcomes}; {len(values['stops'])} stop requests"


def print_table(result: dict[str, Any]) -> None:
    """Prints the headline, the encounters and the range of safe speeds."""
    out = sys.stdout
    print_headline(result)
    head = ("log", "object", "outcome", "entry", "clearance", "S", "margin", "first range")
    out.write(f"{head[0]:<24}{head[1]:<16}{head[2]:<20}" + "".join(f"{h:>12}" for h in head[3:]) + "\n")
    for e in result["encounters"]:
        numbers = [e[k] for k in PRINTED]
        text = "".join(f"{'—' if n is None else format(n, '.2f'):>12}" for n in numbers)
        out.write(f"{e['log'][:23]:<24}{e['role'][:15]:<16}{e['outcome']:<20}{text}\n")
    for damaged in result["damaged"]:
        out.write(f"damaged: {damaged['log']}: {damaged['reason']}\n")
    safe = ", ".join(
        f"{k}: {'not shown' if v is None else format(v, '.1f')} km/h" for k, v in result["safe_speed_kmh"].items()
    )
    out.write(f"highest safe speed {safe}\nreport: {result['run_dir']}/report.html\n")


def print_headline(result: dict[str, Any]) -> None:
    """Prints the headline, all reasons for *not shown* and the findings."""
    out = sys.stdout
    out.write(f"{result['headline']}\n")
    for finding in result["findings"]:
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in finding["numbers"].items())
        out.write(f"  finding: {finding['log']}: {finding['text']}{f' ({numbers})' if numbers else ''}\n")
    texts = {finding["text"] for finding in result["findings"]}
    for one in (one for one in result["not_shown"] if one["reason"] not in texts):
        out.write(f"  not shown: {one['log'] + ': ' if one['log'] else ''}{one['reason']}\n")
