"""Totals of all logs: counts with exact bounds, recall, safe speeds, state."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.encounters import Outcome
from validation.obstacle_stop.ranges import rate_bounds, share_bounds
from validation.obstacle_stop.stopping import safe_speed_mps
from validation.verdict import State

FACTORS = {"simple": 2.0, "complex": 1.5}  # BD-5.2.4
EVALUATED = (
    Outcome.IN_TIME.value,
    Outcome.LATE.value,
    Outcome.MISSED.value,
    Outcome.CUT_IN.value,
    Outcome.OCCLUDED.value,
)


def aggregate(logs: Sequence[dict[str, Any]], conditions: Conditions) -> dict[str, Any]:
    """Object of `--json` without the run folder; `logs` are results of `evaluate_log` or of unreadable logs."""
    read = [log for log in logs if "failed" not in log]
    with_truth = [log for log in read if log["has_truth"]]
    encounters = [e for log in read for e in log["encounters"]]
    stops = [s for log in read for s in log["stops"]]
    counts = Counter(e["outcome"] for e in encounters)
    hours, evaluated = sum(log["hours"] for log in read), sum(counts[o] for o in EVALUATED)
    missed = counts[Outcome.MISSED.value] if with_truth else None
    false_stops = sum(s["is_false"] is True for s in stops) if with_truth else None
    truth_hours = sum(log["hours"] for log in with_truth)
    known = [s for s in stops if s["is_false"] is not None]
    return {
        "state": state_of(read, counts, false_stops, evaluated, conditions).value,
        "encounters": encounters,
        "outcomes": dict(sorted(counts.items())),
        "missed": missed,
        "missed_share": _share(missed, evaluated),
        "false_stops": false_stops,
        "false_stops_per_hour": _rate(false_stops, truth_hours),
        "false_stop_share": _share(false_stops, len(known)),
        "stops": stops,
        "hours": hours,
        "driven_m": round(sum(log["driven_m"] for log in read), 2),
        "safe_speed_kmh": safe_speeds(read, conditions),
        "recall": recall(with_truth),
        "violations": [text for log in read for text in log["violations"]],
        "failed_to_read": [{"log": log["log"], "reason": log["failed"]} for log in logs if "failed" in log],
        "damaged": [{"log": log["log"], "reason": note} for log in read for note in damages(log)],
        "logs": len(logs),
    }


def damages(log: dict[str, Any]) -> list[str]:
    """Unreadable parts of a log."""
    return [note for note in log.get("inspection", {}).get("notes", []) if note.startswith("byte ")]


def state_of(
    read: list[dict[str, Any]], counts: Counter[str], false_stops: int | None, evaluated: int, conditions: Conditions
) -> State:
    """Failed above a limit or with a violation; passed with truth and an evaluated encounter; else not shown."""
    limits = conditions.max_counts
    is_over = counts[Outcome.MISSED.value] > limits.missed or counts[Outcome.LATE.value] > limits.late
    if is_over or (false_stops or 0) > limits.false_stops or any(log["violations"] for log in read):
        return State.FAILED
    return State.PASSED if evaluated and any(log["has_truth"] for log in read) else State.NOT_SHOWN


def _share(count: int | None, of: int) -> dict[str, Any] | None:
    if count is None or of == 0:
        return None
    low, high = share_bounds(count, of)
    return {"count": count, "of": of, "low": low, "high": high}


def _rate(count: int | None, hours: float) -> dict[str, Any] | None:
    if count is None or hours <= 0.0:
        return None
    low, high = rate_bounds(count, hours)
    return {"count": count, "hours": hours, "low": low, "high": high}


def safe_speeds(read: list[dict[str, Any]], conditions: Conditions) -> dict[str, float | None]:
    """Highest speed (km/h) at which the detection range of all logs is 2 × and 1.5 × the stopping distance."""
    lost = [log["detection_range"]["lost_m"] for log in read if log["detection_range"]["lost_m"] is not None]
    found = [log["detection_range"]["found_m"] for log in read if log["detection_range"]["found_m"] is not None]
    if not found:
        return {f"{factor:g}x": None for factor in FACTORS.values()}
    range_m = min([*lost, max(found)])
    return {
        f"{factor:g}x": round(3.6 * safe_speed_mps(range_m, factor, conditions.braking), 2)
        for factor in FACTORS.values()
    }


def recall(with_truth: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Recall by class and range over all logs, with exact bounds."""
    total: Counter[tuple[str, float, float]] = Counter()
    hit: Counter[tuple[str, float, float]] = Counter()
    for row in (row for log in with_truth for row in log["recall"]):
        for label in (row["class"], "all"):
            key = (label, row["from_m"], row["to_m"])
            total[key] += row["n"]
            hit[key] += row["found"]
    rows = []
    for (label, start, end), n in sorted(total.items()):
        k = hit[(label, start, end)]
        low, high = share_bounds(k, n)
        rows.append({"class": label, "from_m": start, "to_m": end, "n": n, "found": k, "recall": k / n, "low": low,
                     "high": high})  # fmt: skip
    return rows
