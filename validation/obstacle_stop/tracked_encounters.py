"""Encounters of a log without truth: confirmed tracks in the corridor of the stack; their outcome is not shown."""

from typing import Any

import numpy as np

from validation.obstacle_stop.avoidability import Outcome
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.encounters import Encounter, closing_speed
from validation.obstacle_stop.observation import LogObservation, TrackObservation
from validation.obstacle_stop.stopping import stopping_distance_m

SAME_M = 2.0  # a request with such a clearance belongs to the track


def encounters_without_truth(log: str, observed: LogObservation, conditions: Conditions) -> list[Encounter]:
    """All of a log in order of entry; margins are those of the perceived clearance over S."""
    found = [_encounter(log, rows, observed, conditions) for rows in observed.tracks.values()
             if any(r.is_confirmed for r in rows)]  # fmt: skip
    return sorted(found, key=lambda e: (e.entry_s, e.id))


def _encounter(log: str, rows: list[TrackObservation], observed: LogObservation, conditions: Conditions) -> Encounter:
    braking = conditions.braking
    t_s = np.array([observed.time_s(r.stamp_ns) for r in rows])
    gaps = np.array([r.clearance_m for r in rows])
    speeds = [abs(observed.motion.speed_at(r.stamp_ns)) for r in rows]
    needed = np.array([stopping_distance_m(v, braking.reaction_s, braking) for v in speeds])
    least, entry_s = int(np.argmin(gaps - needed)), float(t_s[0])
    stops = [
        r for r in observed.requests
        if r.is_braking and rows[0].stamp_ns <= r.stamp_ns <= rows[-1].stamp_ns
        and abs(r.clearance_m - float(np.interp(observed.time_s(r.stamp_ns), t_s, gaps))) < SAME_M
    ]  # fmt: skip
    requested_s = observed.time_s(stops[0].receive_ns) if stops else None
    confirmed_m = max(r.clearance_m for r in rows if r.is_confirmed)
    values: dict[str, Any] = {
        "margin_m": None, "standstill_s": None, "has_contact": False, "impact_speed_mps": None, "due_s": None,
        "visible_s": None, "visible_range_m": None,
    }  # fmt: skip
    return Encounter(
        log=log, id=rows[0].id, label=rows[-1].label, role=f"track {rows[0].id}", outcome=Outcome.NOT_SHOWN,
        direction=1, entry_s=entry_s, exit_s=float(t_s[-1]), decision_s=float(t_s[least]),
        clearance_m=float(gaps[least]), stopping_distance_m=float(needed[least]), entry_clearance_m=float(gaps[0]),
        entry_speed_mps=speeds[0], entry_stopping_distance_m=float(needed[0]),
        least_margin_m=float(gaps[least] - needed[least]), relative_speed_mps=closing_speed(t_s, gaps),
        first_range_m=float(gaps.max()), confirmed_range_m=confirmed_m, stop_requested_s=requested_s,
        request_delay_s=None if requested_s is None else requested_s - entry_s,
        is_stop_requested=any(r.is_stop for r in stops),
        gaps=tuple(zip(t_s.tolist(), gaps.tolist(), needed.tolist(), strict=True)), **values,
    )  # fmt: skip
