"""Labels that would excuse or hide an encounter although the rest of the log contradicts them.

A verdict is as good as its truth. These faults need no second truth: things do not appear, vanish or jump in the path,
and what a label calls occluded is hidden by something. Each fault is a reason why a log is *not shown*.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from geometry.arrays import Float64
from messages.truth import Occlusion
from validation.obstacle_stop.approaches import Approaches, Course
from validation.obstacle_stop.avoidability import STANDING_MPS, Outcome
from validation.obstacle_stop.boxes import Box
from validation.obstacle_stop.encounters import Encounter

PAUSE_NS = 500_000_000  # truth without the object for so long: its labels began late, or ended
AHEAD_S = np.arange(0.0, 4.01, 0.1)  # of the constant-velocity prediction
JUMP_M, JUMP_MPS = 2.0, 3.0  # noise of labels; change of the velocity between two labels
MIN_SIDE_M = 0.05
GROUND_M, SLOPE = 1.0, 0.15  # height above or below the ground at the machine: noise, and slope of the ground


def box_fault(box: Box) -> str | None:
    """Why a labelled box cannot be an object on the ground; None for a possible one."""
    if not np.isfinite([*box.center_m, *box.size_m, box.yaw_rad]).all():
        return "place, size or yaw is not a number"
    if box.size_m.min() < MIN_SIDE_M:
        return f"size {' × '.join(f'{side:g}' for side in box.size_m)} m"
    above, below = box.center_m[2] + np.array([-0.5, 0.5]) * box.size_m[2]
    limit = GROUND_M + SLOPE * float(np.hypot(*box.center_m[:2]))
    away = above if above > 0.0 else min(below, 0.0)
    return f"{abs(away):.1f} m {'above' if away > 0 else 'below'} the ground" if abs(away) > limit else None


def label_faults(approaches: Approaches, encounters: Sequence[Encounter], truth_ns: Sequence[int]) -> list[str]:
    """All faults of the labels of a log, a line for each object; `truth_ns` are the stamps of the truth."""
    out: dict[int, str] = {}
    for id, course in approaches.courses.items():
        mine = [e.outcome for e in encounters if e.id == id]
        for fault in _faults(approaches, course, mine, truth_ns):
            out.setdefault(id, f"the labels of {course.track.label} {id} contradict the log: {fault}")
    return list(out.values())


def _faults(
    approaches: Approaches, course: Course, outcomes: list[Outcome], truth_ns: Sequence[int]
) -> Iterator[str]:
    """Faults of one object; those of excuses only where they excused it."""
    if outcomes:
        yield from _jumps(course)
    if Outcome.CENSORED in outcomes:
        yield from _late_start(approaches, course, truth_ns)
    if Outcome.OCCLUDED in outcomes:
        yield from _not_hidden(approaches, course)
    if not {Outcome.IN_TIME, Outcome.LATE, Outcome.MISSED} & set(outcomes):
        yield from _early_end(approaches, course, truth_ns)


def _jumps(course: Course) -> Iterator[str]:
    track = course.track
    for k in course.k[1:]:
        before, dt_s = course.track.poses[k - 1], (track.stamps_ns[k] - track.stamps_ns[k - 1]) * 1e-9
        velocity = track.velocity_mps(k - 1) if k > 1 else track.velocity_mps(min(k + 3, len(track.poses) - 1))
        away = float(np.hypot(*(track.poses[k][:2] - before[:2] - velocity * dt_s)))
        if away > JUMP_M + JUMP_MPS * dt_s:
            yield f"it jumps by {away:.1f} m"


def _late_start(approaches: Approaches, course: Course, truth_ns: Sequence[int]) -> Iterator[str]:
    """It was in the path, in view, when the truth did not have it yet."""
    first_ns = course.stamps_ns[0]
    before = [t for t in truth_ns if t < first_ns - PAUSE_NS]
    if course.k[0] == 0 and before and math.isfinite(course.gaps_m[0]) and approaches.is_in_view(course, 0):
        yield f"they begin {course.gaps_m[0]:.1f} m ahead in the path, with truth and free view before"


def _not_hidden(approaches: Approaches, course: Course) -> Iterator[str]:
    moments = [i for i in np.flatnonzero(np.isfinite(course.gaps_m)).tolist() if course.gaps_m[i] > 0.0]
    largely = [i for i in moments if course.track.occlusions[course.k[i]] is Occlusion.LARGELY]
    if any(approaches.is_visible(course, i, Occlusion.UNKNOWN) for i in largely):
        yield "largely occluded, but nothing in the log hides it"


def _early_end(approaches: Approaches, course: Course, truth_ns: Sequence[int]) -> Iterator[str]:
    """By its last motion it would have been due later, when the truth does not have it any more."""
    last, k = len(course.k) - 1, course.k[-1]
    after = [t for t in truth_ns if t > course.stamps_ns[last] + PAUSE_NS]
    if not after or k + 1 < len(course.track.stamps_ns) or not approaches.is_in_view(course, last):
        return
    until_s = (truth_ns[-1] - course.stamps_ns[last]) * 1e-9
    for t in AHEAD_S[until_s >= AHEAD_S].tolist():
        gap, needed, speed = approaches.predicted(course, last, t)
        if gap < needed and speed > STANDING_MPS:
            yield f"they end {t:.1f} s before it would have been in the path within the stopping distance"
            return


def gap_of(values: Float64) -> float:
    """Smallest gap."""
    return float(values.min())
