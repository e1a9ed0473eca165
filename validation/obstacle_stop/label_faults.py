"""Labels that would excuse or hide an encounter although the rest of the log contradicts them.

A verdict is as good as its truth, and some faults of labels need no second truth to be seen: an object has a place and
a size, does not jump, and does not appear or vanish in the path in plain view; what is called occluded is hidden by
something. Each fault is a reason why a log is *not shown*. Apart from jumps and impossible boxes only what excused an
object, or kept it from being judged, is looked at.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from messages.truth import Occlusion
from validation.obstacle_stop.approaches import Approaches, Course
from validation.obstacle_stop.avoidability import STANDING_MPS, Outcome
from validation.obstacle_stop.encounters import Encounter
from validation.obstacle_stop.observation import LogObservation
from validation.obstacle_stop.true_tracks import TrueTrack

ABSENT_NS = 500_000_000  # truth without the object for so long: its labels began late, or ended
PREDICTED_NS = 4_000_000_000  # by constant velocity
STEP_NS = 100_000_000
JUMP_M, JUMP_MPS = 2.0, 3.0  # noise of labels; change of the velocity between two labels


def label_faults(observed: LogObservation, approaches: Approaches | None, encounters: Sequence[Encounter]) -> list[str]:
    """A line for each object with a fault; `encounters` are all of the log."""
    found = dict(observed.box_faults)
    for id, track in observed.true_tracks.items():
        outcomes = {e.outcome for e in encounters if e.id == id}
        faults = () if approaches is None else _faults(observed, approaches, track, outcomes)
        for fault in faults:
            found.setdefault(id, fault)
    labels = {id: track.label for id, track in observed.true_tracks.items()}
    return [f"labels of {labels.get(id, 'object')} {id}: {fault}" for id, fault in found.items()]


def _faults(
    observed: LogObservation, approaches: Approaches, track: TrueTrack, outcomes: set[Outcome]
) -> Iterator[str]:
    course = approaches.courses.get(track.id)
    if course is not None:
        yield from _jumps(track)
        if Outcome.CENSORED in outcomes:
            yield from _late_start(observed, approaches, course)
        if Outcome.OCCLUDED in outcomes:
            yield from _not_hidden(approaches, course)
    if not {Outcome.IN_TIME, Outcome.LATE, Outcome.MISSED} & outcomes:
        yield from _early_end(observed, approaches, track)


def _jumps(track: TrueTrack) -> Iterator[str]:
    """Away from constant velocity by more than noise and acceleration explain."""
    poses, stamps = track.poses(), np.array(track.stamps_ns, np.int64)
    for k in range(2, len(stamps)):
        dt_s = float(stamps[k] - stamps[k - 1]) * 1e-9
        away = float(np.hypot(*(poses[k, :2] - poses[k - 1, :2] - track.velocity_mps(k - 1) * dt_s)))
        if away > JUMP_M + JUMP_MPS * dt_s:
            yield f"a jump by {away:.1f} m at {(stamps[k] - stamps[0]) * 1e-9:.1f} s after the first"
            return


def _late_start(observed: LogObservation, approaches: Approaches, course: Course) -> Iterator[str]:
    """In the path in plain view, at a moment whose truth does not have it."""
    first_ns, gap_m = course.stamps_ns[0], float(course.gaps_m[0])
    absent = [t for t in observed.truth_ns if first_ns - 2 * ABSENT_NS <= t <= first_ns - ABSENT_NS]
    velocity = course.track.velocity_mps(course.track.index(first_ns + ABSENT_NS))
    before = (approaches.predicted(course.track, 0, t, velocity) for t in absent)
    if math.isfinite(gap_m) and any(math.isfinite(one.gap_m) and one.is_visible for one in before):
        yield f"they begin {gap_m:.1f} m ahead in the path, where it would have been in plain view before"


def _not_hidden(approaches: Approaches, course: Course) -> Iterator[str]:
    ahead = [i for i, gap in enumerate(course.gaps_m.tolist()) if 0.0 < gap < math.inf]
    largely = [i for i in ahead if course.track.occlusions[course.k[i]] == Occlusion.LARGELY]
    if any(approaches.is_visible(course, i, Occlusion.UNKNOWN) for i in largely):
        yield "largely occluded, but nothing in the log hides it"


def _early_end(observed: LogObservation, approaches: Approaches, track: TrueTrack) -> Iterator[str]:
    """By its last motion the request would have been due later, when the truth does not have it any more."""
    last, last_ns = len(track.stamps_ns) - 1, track.stamps_ns[-1]
    truth_ns, velocity = observed.truth_ns[-1], track.velocity_mps(last)
    if truth_ns - last_ns < ABSENT_NS:
        return
    for stamp_ns in range(last_ns + STEP_NS, min(truth_ns, last_ns + PREDICTED_NS), STEP_NS):
        then = approaches.predicted(track, last, stamp_ns, velocity)
        if 0.0 < then.gap_m < then.stopping_distance_m and then.speed_mps > STANDING_MPS and then.is_visible:
            after_s = (stamp_ns - last_ns) * 1e-9
            yield f"they end {after_s:.1f} s before it would be within the stopping distance in the path"
            return
