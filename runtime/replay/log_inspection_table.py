"""Table of the topics of a log: required, present and missing."""

from typing import Any

from runtime.replay.log_inspection import LogInspection


def rows_of(inspection: LogInspection, needed: dict[str, str]) -> list[dict[str, Any]]:
    """One row per required or present topic; `needed_for` is its purpose, "" for an unused topic."""
    rows = []
    for topic in sorted({*needed, *inspection.streams}):
        stream = inspection.streams.get(topic)
        rows.append({
            "topic": topic,
            "needed_for": needed.get(topic, ""),
            "found": stream is not None,
            "count": 0 if stream is None else stream.count,
            "rate_hz": None if stream is None or stream.rate_hz is None else round(stream.rate_hz, 2),
            "longest_gap_s": None if stream is None else round(stream.longest_gap_s, 3),
        })  # fmt: skip
    return rows


def render(values: dict[str, Any]) -> str:
    """Inspection table as text."""
    lines = [f"{values['log']}: {values['format']}, {values['span_s']:.1f} s"]
    lines.append(f"  {'topic':<30}{'needed for':<26}{'count':>8}{'Hz':>9}{'gap s':>9}")
    for row in values["topics"]:
        rate = "—" if row["rate_hz"] is None else f"{row['rate_hz']:.2f}"
        gap = "—" if row["longest_gap_s"] is None else f"{row['longest_gap_s']:.2f}"
        count = str(row["count"]) if row["found"] else "missing"
        lines.append(f"  {row['topic']:<30}{row['needed_for']:<26}{count:>8}{rate:>9}{gap:>9}")
    skipped = [row for row in values["streams"] if row["reasons"]]
    lines += [f"  not read: {row['source']}: {reason} ({count or '?'} messages)"
              for row in skipped for reason, count in row["reasons"].items()]  # fmt: skip
    lines += [f"  {note}" for note in values["notes"]]
    lines.append(f"  can be evaluated: {', '.join(values['evaluable']) or 'nothing'}")
    lines += [f"  not shown: {text}" for text in values["not_shown"]]
    return "\n".join(lines) + "\n"
