"""One log judged: its encounters, stops, recall and hours as plain values."""

from collections import Counter
from typing import Any

from validation.obstacle_stop.conditions import Conditions, named
from validation.obstacle_stop.encounters import Encounter, find_encounters, perceived
from validation.obstacle_stop.observation import Observation, Sighting
from validation.obstacle_stop.ranges import confirmed
from validation.obstacle_stop.stops import Stop, find_stops
from validation.obstacle_stop.visibility import ahead


def judge_log(log: str, seen: Observation, has_truth: bool, conditions: Conditions) -> dict[str, Any]:
    """What one log shows; kept as it is until all logs are put together."""
    has_truth = has_truth and seen.judged_scans > 0
    encounters = find_encounters(log, seen, conditions) if has_truth else perceived(log, seen, conditions)
    stops = find_stops(log, seen, has_truth)
    return {
        "log": log,
        "has_truth": has_truth,
        "encounters": [e.as_dict for e in encounters],
        "stops": [s.as_dict for s in stops],
        "recall": recall_rows(seen, conditions) if has_truth else [],
        "confirmation": confirmation(seen),
        "reach": reach(seen, conditions),
        "hours": (seen.last_ns - seen.first_ns) * 1e-9 / 3600.0,
        "driven_m": round(seen.driven_m, 2),
        "scans": len(seen.scans),
        "judged_scans": seen.judged_scans,
        "scan_period_s": round(seen.period_s, 4),
        "broken": broken(log, encounters, stops, conditions),
    }


def recall_rows(seen: Observation, conditions: Conditions) -> list[dict[str, Any]]:
    """Found of all by class and range, by the strict rule; objects with enough returns."""
    edges = conditions.recall.edges_m
    total: Counter[tuple[str, int]] = Counter()
    hit: Counter[tuple[str, int]] = Counter()
    for sighting in countable(seen, conditions):
        k = sum(sighting.edge_m >= edge for edge in edges) - 1
        if 0 <= k < len(edges) - 1:
            total[(sighting.label, k)] += 1
            hit[(sighting.label, k)] += sighting.is_strict
    return [
        {"class": label, "from_m": edges[k], "to_m": edges[k + 1], "n": n, "found": hit[(label, k)]}
        for (label, k), n in sorted(total.items())
    ]


def confirmation(seen: Observation) -> list[dict[str, Any]]:
    """By object: seconds from the first scan with enough returns until a confirmed track was told, null when never."""
    told = seen.confirmed_ns
    return [
        {"id": i, "after_s": round((told[i] - first_ns) * 1e-9, 4) if i in told else None}
        for i, first_ns in sorted(seen.countable_ns.items())
    ]


def countable(seen: Observation, conditions: Conditions) -> list[Sighting]:
    """Sightings with enough returns."""
    return [s for rows in seen.sightings.values() for s in rows if s.returns >= conditions.recall.least_returns]


def reach(seen: Observation, conditions: Conditions) -> dict[str, float | None]:
    """The nearest range at which an object ahead was not held for three scans, and the farthest at which one was."""
    flags = []
    for rows in seen.sightings.values():
        mine = sorted(ahead(rows, conditions.recall.least_returns), key=lambda s: s.stamp_ns)
        flags += confirmed([(s.edge_m, s.is_seen) for s in mine])
    lost = [r for r, is_found in flags if not is_found]
    held = [r for r, is_found in flags if is_found]
    return {"lost_m": min(lost, default=None), "found_m": max(held, default=None)}


def broken(log: str, encounters: list[Encounter], stops: list[Stop], conditions: Conditions) -> list[str]:
    """Which of the conditions' must-stop and must-not-stop were not kept."""
    stopped = {i for stop in stops if stop.is_stop for i in stop.objects} | {
        e.id for e in encounters if e.is_stop_asked
    }
    out = [f"no stop for object {i}: {why}" for i, why in named(conditions.must_stop, log).items() if i not in stopped]
    return out + [
        f"stop for object {i}: {why}" for i, why in named(conditions.must_not_stop, log).items() if i in stopped
    ]
