"""Evaluation of one log: encounters, stops, recall, detection range and hours as plain values."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

from validation.obstacle_stop.approaches import Approaches
from validation.obstacle_stop.conditions import Conditions, listed_ids
from validation.obstacle_stop.encounters import MIN_DRIVEN_M, Encounter, find_encounters, in_forward_region
from validation.obstacle_stop.label_faults import label_faults
from validation.obstacle_stop.observation import LogObservation, ObjectObservation
from validation.obstacle_stop.ranges import confirmed
from validation.obstacle_stop.stops import Stop, false_stop_scans, find_stops
from validation.obstacle_stop.tracked_encounters import encounters_without_truth


def evaluate_log(log: str, observed: LogObservation, has_truth: bool, conditions: Conditions) -> dict[str, Any]:
    """Result of one log, input of `totals.aggregate`."""
    has_truth = has_truth and (observed.evaluated_scans > 0 or bool(observed.true_tracks))
    recorded, faults = observed.recorded, list[str]()
    if has_truth:
        approaches = None if recorded is None else Approaches(observed, recorded, conditions)
        encounters = find_encounters(log, observed, conditions, approaches)
        faults = label_faults(observed, approaches, encounters)
    else:
        encounters = encounters_without_truth(log, observed, conditions)
    stops = find_stops(log, observed, has_truth)
    return {
        "log": log,
        "has_truth": has_truth,
        "encounters": [e.as_dict for e in encounters],
        "stops": [s.as_dict for s in stops],
        "false_stop_scans": false_stop_scans(observed) if has_truth else None,
        "recall": recall_rows(observed, conditions) if has_truth else [],
        "confirmation": confirmation(observed),
        "detection_range": detection_range(observed, conditions),
        "hours": (observed.last_ns - observed.first_ns) * 1e-9 / 3600.0,
        "driven_m": round(observed.driven_m, 2),
        "scans": len(observed.scans),
        "evaluated_scans": observed.evaluated_scans,
        "scan_period_s": round(observed.period_s, 4),
        "violations": violations(log, encounters, stops, conditions),
        "not_shown": [*faults, *reasons(observed)],
    }


def reasons(observed: LogObservation) -> list[str]:
    """Why the log is no trial: the machine did not move."""
    driven_m = observed.driven_m
    return [] if driven_m >= MIN_DRIVEN_M else [f"the machine did not move ({driven_m:.1f} m driven)"]


def recall_rows(observed: LogObservation, conditions: Conditions) -> list[dict[str, Any]]:
    """Detected and total observations by class and range (strict rule, objects with enough returns)."""
    edges = conditions.recall.range_edges_m
    total: Counter[tuple[str, int]] = Counter()
    hit: Counter[tuple[str, int]] = Counter()
    for observation in countable(observed, conditions):
        k = sum(observation.front_distance_m >= edge for edge in edges) - 1
        if 0 <= k < len(edges) - 1:
            total[(observation.label, k)] += 1
            hit[(observation.label, k)] += observation.is_detected_strictly
    return [
        {"class": label, "from_m": edges[k], "to_m": edges[k + 1], "n": n, "found": hit[(label, k)]}
        for (label, k), n in sorted(total.items())
    ]


def confirmation(observed: LogObservation) -> list[dict[str, Any]]:
    """By object: seconds from the first scan with enough returns to the first confirmed track, null without one."""
    confirmed_ns = observed.confirmed_ns
    return [
        {"id": i, "after_s": round((confirmed_ns[i] - first_ns) * 1e-9, 4) if i in confirmed_ns else None}
        for i, first_ns in sorted(observed.countable_ns.items())
    ]


def countable(observed: LogObservation, conditions: Conditions) -> Iterator[ObjectObservation]:
    """Observations with enough returns."""
    return (s for rows in observed.observations.values() for s in rows if s.returns >= conditions.recall.min_returns)


def detection_range(observed: LogObservation, conditions: Conditions) -> dict[str, float | None]:
    """Nearest range (m) at which an object ahead was not detected in three scans in a row, and farthest with one."""
    flags = []
    for rows in observed.observations.values():
        mine = sorted(in_forward_region(rows, conditions.recall.min_returns), key=lambda s: s.stamp_ns)
        flags += confirmed([(s.front_distance_m, s.is_detected) for s in mine])
    lost = [r for r, is_found in flags if not is_found]
    held = [r for r, is_found in flags if is_found]
    return {"lost_m": min(lost, default=None), "found_m": max(held, default=None)}


def violations(log: str, encounters: list[Encounter], stops: list[Stop], conditions: Conditions) -> list[str]:
    """Violations of `must_stop` and `must_not_stop`."""
    stopped = {i for stop in stops if stop.is_stop for i in stop.objects} | {
        e.id for e in encounters if e.is_stop_requested
    }
    out = [
        f"no stop for object {i}: {why}" for i, why in listed_ids(conditions.must_stop, log).items() if i not in stopped
    ]
    return out + [
        f"stop for object {i}: {why}" for i, why in listed_ids(conditions.must_not_stop, log).items() if i in stopped
    ]
