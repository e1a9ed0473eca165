"""Tables of the campaign of hazards: Parquet, Markdown, and an HTML page with picture and command of each failure."""

import base64
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from validation.html import render_page

FACTORS = ("object", "placement", "phase", "environment")
COUNTS = ("contacts", "avoidable_contacts", "unpromised_contacts", "walked_into", "near_misses", "false_stops")
MEASURES = ("driven_m", "simulated_s", "wall_s", "cpu_s")
DRIVE_COLUMNS = {
    "drive": "string", **dict.fromkeys(FACTORS, "string"), "seed": "int64", "outcome": "string",
    **dict.fromkeys(COUNTS, "int64"), **dict.fromkeys(MEASURES, "float64"),
    "outside_odd": "string", "stops": "string", "failed": "string",
}  # fmt: skip
OBJECT_COLUMNS = {
    "drive": "string", **dict.fromkeys(FACTORS, "string"), "seed": "int64", "name": "string", "kind": "string",
    **dict.fromkeys(("is_static", "must_avoid", "is_promised"), "bool_"), "first_sensor": "string",
    **dict.fromkeys(("first_detection_s", "first_range_m", "margin_m", "margin_s"), "float64"),
    "nearest_part": "string", **dict.fromkeys(("is_near_miss", "is_contact", "is_walked_into"), "bool_"),
    "contact_s": "float64", "part": "string",
    **dict.fromkeys(("x_m", "y_m", "z_m", "impact_mps", "machine_mps"), "float64"), "is_unavoidable": "bool_",
    "reason": "string", "closed_form_mps": "float64", "mode": "string", "section": "string",
}  # fmt: skip
SHOWN = ("drive", *FACTORS, "outcome", *COUNTS, "first_sensor", "first_range_m", "margin_m", "impact_mps", "part",
         "stops", "wall_s", "cpu_s")  # fmt: skip


def drive_rows(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each drive."""
    return [_common(r) | {key: r.get(key) for key in ("outcome", *COUNTS, *MEASURES, "failed")}
            | {"outside_odd": ", ".join(r.get("outside_odd", ())), "stops": _stops(r)} for r in results]  # fmt: skip


def _common(result: dict[str, Any]) -> dict[str, Any]:
    return {"drive": result["name"], "seed": result.get("seed"), **result["labels"]}


def _stops(result: dict[str, Any]) -> str:
    causes = Counter(f"{stop['cause']}{' (false)' if stop['is_false'] else ''}" for stop in result.get("stop_list", ()))
    return ", ".join(f"{cause} {n}x" if n > 1 else cause for cause, n in causes.items())


def object_rows(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each object of each drive."""
    return [_common(result) | one for result in results for one in result.get("objects", ())]


def totals(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Sums over all drives."""
    done = [r for r in results if "failed" not in r]
    sums = {key: sum(int(r[key]) for r in done) for key in COUNTS}
    return {"drives": len(done), **sums, "hours": round(sum(r["simulated_s"] for r in done) / 3600.0, 4),
            "failed_drives": len(results) - len(done)}  # fmt: skip


def unavoidable(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each unavoidable contact with its reason and speeds."""
    keys = ("drive", *FACTORS, "seed", "name", "reason", "machine_mps", "closed_form_mps")
    return [{key: row.get(key) for key in keys} for row in object_rows(results) if row["is_unavoidable"]]


def write_parquet(folder: Path, results: Sequence[dict[str, Any]]) -> None:
    """`drives.parquet` and `objects.parquet`."""
    import pyarrow as pa
    from pyarrow import parquet

    for name, columns, rows in (("drives", DRIVE_COLUMNS, drive_rows(results)),
                                ("objects", OBJECT_COLUMNS, object_rows(results))):  # fmt: skip
        schema = pa.schema([(key, getattr(pa, kind)()) for key, kind in columns.items()])
        parquet.write_table(pa.Table.from_pylist(rows, schema=schema), folder / f"{name}.parquet")


def page(results: Sequence[dict[str, Any]]) -> str:
    """HTML page: totals, failures with picture and command, all drives."""
    ordered = sorted(results, key=lambda r: (-_rank(r), r["name"]))
    failures = [
        {"name": r["name"], "text": failure_text(r), "command": r["command"],
         "picture": base64.b64decode(r["picture"]) if r.get("picture") else None}
        for r in ordered if _rank(r) > 0
    ]  # fmt: skip
    rows = [row | _nearest(r) for row, r in zip(drive_rows(ordered), ordered, strict=True)]
    return render_page(
        "hazards.html", totals=totals(results), keys=SHOWN, rows=rows, failures=failures,
        marked=[k for k, r in enumerate(ordered) if _rank(r) > 0],
    )  # fmt: skip


def markdown(results: Sequence[dict[str, Any]]) -> str:
    """Markdown: totals, counts for each level of each factor, and every contact."""
    counted = ("drives", *COUNTS)
    lines = [", ".join(f"{key.replace('_', ' ')} {value}" for key, value in totals(results).items())]
    for factor in FACTORS:
        lines += ["", f"| {factor} | {' | '.join(key.replace('_', ' ') for key in counted)} |"]
        lines += ["| --- " * (len(counted) + 1) + "|"]
        for level in dict.fromkeys(r["labels"][factor] for r in results):
            sums = totals([r for r in results if r["labels"][factor] == level])
            lines += [f"| {level or '—'} | {' | '.join(str(sums[key]) for key in counted)} |"]
    lines += ["", "Contacts:", ""]
    lines += [f"- {r['name']}: {failure_text(r)}" for r in results if "failed" in r or r["contacts"]]
    return "\n".join(lines) + "\n"


def _rank(result: dict[str, Any]) -> int:
    if "failed" in result:
        return 4
    return 3 if result["avoidable_contacts"] else 2 if result["contacts"] else 1 if result["false_stops"] else 0


def _nearest(result: dict[str, Any]) -> dict[str, Any]:
    rows = [one for one in result.get("objects", ()) if one["must_avoid"]]
    if not rows:
        return {}
    one = min(rows, key=lambda row: (not row["is_contact"], row["margin_m"]))
    return {key: one[key] for key in ("first_sensor", "first_range_m", "margin_m", "impact_mps", "part")}


def failure_text(result: dict[str, Any]) -> str:
    """Failures of a drive in one line."""
    if "failed" in result:
        return f"the drive failed: {result['failed']}"
    found = [
        f"{one['name']} ({one['kind']}) by {one['part']} at {one['impact_mps']:.2f} m/s, "
        f"{'unavoidable' if one['is_unavoidable'] else 'avoidable'} ({one['reason']})"
        f"{'' if one['is_promised'] else ', not promised'}"
        for one in result["objects"] if one["is_contact"]
    ]  # fmt: skip
    found += [f"false stop: {stop['cause']}" for stop in result["stop_list"] if stop["is_false"]]
    levels = ", ".join(value for value in result["labels"].values() if value)
    return f"{levels}: {'; '.join(found)}"
