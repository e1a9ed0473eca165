"""Totals of all logs: counts with exact bounds, recall, safe speeds, state."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from validation.obstacle_stop.avoidability import Outcome
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.headline import headline
from validation.obstacle_stop.ranges import rate_bounds, share_bounds
from validation.obstacle_stop.stopping import safe_speed_mps
from validation.verdict import State

UNUSABLE = ("truth", "odometry", "no_motion", "clock")  # first words of the codes of such findings
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
    hours, evaluated = sum(log["hours"] for log in read), sum(is_trial(e) for e in encounters)
    missed = counts[Outcome.MISSED.value] if with_truth else None
    false_stops = sum(s["is_false"] is True for s in stops) if with_truth else None
    truth_hours = sum(log["hours"] for log in with_truth)
    known = [s for s in stops if s["is_false"] is not None]
    shown, share = recall(with_truth), missed_share(with_truth)
    not_shown = [*reasons_not_shown(logs, evaluated), *_below_bounds(share, shown, conditions)]
    result = {
        "state": state_of(read, counts, false_stops, not_shown, conditions).value,
        "not_shown": not_shown,
        "findings": [{"log": log["log"]} | finding for log in read for finding in log.get("findings", [])],
        "encounters": encounters,
        "outcomes": dict(sorted(counts.items())),
        "missed": missed,
        "missed_share": share,
        "false_stops": false_stops,
        "false_stops_per_hour": _rate(false_stops, truth_hours),
        "false_stop_scans": _share(*_false_scans(with_truth)),
        "false_stop_causes": false_causes(stops),
        "false_stop_share": _share(false_stops, len(known)),
        "stops": stops,
        "hours": hours,
        "driven_m": round(sum(log["driven_m"] for log in read), 2),
        "safe_speed_kmh": safe_speeds(read, conditions),
        "recall": shown,
        "violations": [text for log in read for text in log["violations"]],
        "failed_to_read": [{"log": log["log"], "reason": log["failed"]} for log in logs if "failed" in log],
        "damaged": [{"log": log["log"], "reason": note} for log in read for note in damages(log)],
        "logs": len(logs),
    }
    return result | {"headline": headline(result)}


def reasons_not_shown(logs: Sequence[dict[str, Any]], evaluated: int) -> list[dict[str, str]]:
    """Reasons why the logs cannot pass, blocking findings first; `log` is "" for a reason that concerns all."""
    read = [log for log in logs if "failed" not in log]
    blocking = [(log["log"], f["text"]) for log in read for f in log.get("findings", []) if f["is_blocking"]]
    unread = [(log["log"], log["failed"]) for log in logs if "failed" in log]
    own = [(log["log"], reason) for log in read for reason in log.get("not_shown", [])]
    if not any(log["has_truth"] for log in read):
        own.append(("", "no ground truth"))
    elif not evaluated:
        own.append(("", "no encounter"))
    return [{"log": name, "reason": reason} for name, reason in (*blocking, *unread, *own)]


def is_trial(encounter: dict[str, Any]) -> bool:
    """Whether the stack was put to the proof; an excused object without a request shows nothing."""
    outcome = encounter["outcome"]
    return outcome == Outcome.MISSED.value or (outcome in EVALUATED and encounter["stop_requested_s"] is not None)


def missed_share(with_truth: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Missed encounters among the trials; without logs whose truth lists only what was perceived."""
    complete = [log for log in with_truth if log.get("is_truth_complete", True)]
    trials = [e for log in complete for e in log["encounters"] if is_trial(e)]
    return _share(sum(e["outcome"] == Outcome.MISSED.value for e in trials), len(trials))


def _below_bounds(
    share: dict[str, Any] | None, rows: list[dict[str, Any]], conditions: Conditions
) -> list[dict[str, str]]:
    """Bounds that the conditions require and that so few trials, or so little recall, do not show."""
    required, out = conditions.required_bounds, []
    high, trials = (1.0, 0) if share is None else (share["high"], share["of"])
    if high > required.missed_share:
        out.append(f"missed share up to {high:.3g} with {trials} encounters, {required.missed_share:g} required")
    counted = [(row["found"], row["n"]) for row in rows if row["class"] == "all"]
    low = share_bounds(sum(k for k, _ in counted), sum(n for _, n in counted))[0] if counted else 0.0
    if low < required.recall:
        out.append(f"recall from {low:.3g}, {required.recall:g} required")
    return [{"log": "", "reason": reason} for reason in out]


def _false_scans(with_truth: list[dict[str, Any]]) -> tuple[int | None, int]:
    """Scans during which a stop was requested that no true object explains, and all evaluated scans."""
    scans = sum(log["evaluated_scans"] for log in with_truth)
    return (sum(log["false_stop_scans"] or 0 for log in with_truth) if with_truth else None), scans


def false_causes(stops: list[dict[str, Any]]) -> dict[str, int]:
    """Number of false stops by rule and perceived class."""
    return dict(sorted(Counter(f"{s['reason']}, {s['class']}" for s in stops if s["is_false"]).items()))


def damages(log: dict[str, Any]) -> list[str]:
    """Unreadable parts of a log."""
    return [note for note in log.get("inspection", {}).get("notes", []) if note.startswith("byte ")]


def state_of(
    read: list[dict[str, Any]], counts: Counter[str], false_stops: int | None, not_shown: Sequence[Any],
    conditions: Conditions,
) -> State:  # fmt: skip
    """Not shown with unusable truth or motion; failed above a limit or with a violation; not shown with a reason for
    it; else passed."""
    limits = conditions.max_counts
    unusable = [f for log in read for f in log.get("findings", []) if f["is_blocking"] and is_unusable(f["code"])]
    if unusable:
        return State.NOT_SHOWN
    is_over = counts[Outcome.MISSED.value] > limits.missed or counts[Outcome.LATE.value] > limits.late
    if is_over or (false_stops or 0) > limits.false_stops or any(log["violations"] for log in read):
        return State.FAILED
    return State.NOT_SHOWN if not_shown else State.PASSED


def is_unusable(code: str) -> bool:
    """Whether a finding makes the truth or the motion unusable, so that not even a failure is shown."""
    return code.startswith(UNUSABLE)


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
