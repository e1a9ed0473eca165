"""Approaches: the intervals in which a true object is in the swept path, with gap, S and speed at each label."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.pose2 import from_frame
from messages.truth import Occlusion
from validation.obstacle_stop.avoidability import Approach
from validation.obstacle_stop.boxes import Box
from validation.obstacle_stop.by_stamp import nearest
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.observation import LogObservation
from validation.obstacle_stop.recorded_motion import RecordedMotion, Section
from validation.obstacle_stop.stopping import stopping_distance_m
from validation.obstacle_stop.structure import StaticCells
from validation.obstacle_stop.true_tracks import TrueTrack
from validation.obstacle_stop.visibility import Solid, SolidBox, is_visible

PAUSE_NS = 5_000_000_000  # an object longer out of the path is a new encounter
FRONT_M = 1.0  # what comes into the path further behind the front comes from the side: braking avoids nothing
BEFORE_NS = 10_000_000_000
HORIZON_S = np.arange(0.5, 4.01, 0.5)  # of the constant-velocity prediction


@dataclass(frozen=True, eq=False)
class Course:
    """One true object along the drive: gaps (M,) at the evaluated labels `k` (M,) of its track."""

    track: TrueTrack
    k: list[int]
    stamps_ns: list[int]
    gaps_m: Float64
    sections: list[Section]

    def gap_at(self, stamp_ns: int) -> float:
        """Gap at the nearest label, infinite without one."""
        i = nearest(self.stamps_ns, stamp_ns, 300_000_000)
        return math.inf if i is None else float(self.gaps_m[i])

    def gaps_between(self, stamps_ns: Int64) -> Float64:
        """Gaps (N,) at times, linear between two labels in the path; infinite elsewhere."""
        after = np.searchsorted(self.stamps_ns, stamps_ns).clip(1, max(1, len(self.stamps_ns) - 1))
        gaps = np.interp(stamps_ns, self.stamps_ns, np.nan_to_num(self.gaps_m, posinf=0.0))
        is_in_path = np.isfinite(self.gaps_m)
        is_between = is_in_path[after - 1] & is_in_path[np.minimum(after, len(is_in_path) - 1)]
        return np.where(is_between, gaps, math.inf)

    def intervals(self) -> list[tuple[int, int]]:
        """First and last index of each time in the path, in one section of the drive."""
        out: list[tuple[int, int]] = []
        for i in np.flatnonzero(np.isfinite(self.gaps_m)).tolist():
            is_same = bool(out) and self.sections[i] is self.sections[out[-1][1]]
            if is_same and self.stamps_ns[i] - self.stamps_ns[out[-1][1]] <= PAUSE_NS:
                out[-1] = (out[-1][0], i)
            else:
                out.append((i, i))
        return out


@dataclass(frozen=True)
class Predicted:
    """An object at a moment without its label: gap, S and speed of the machine, and whether a sensor would see it."""

    gap_m: float
    stopping_distance_m: float
    speed_mps: float
    _is_seen: Callable[[], bool]

    @property
    def is_visible(self) -> bool:
        """Computed at each call, from all objects and structure around: by far the most expensive value."""
        return self._is_seen()


class Approaches:
    """Courses of the true objects that are in the swept path at some time."""

    def __init__(self, observed: LogObservation, recorded: RecordedMotion, conditions: Conditions) -> None:
        self._observed, self._recorded, self._conditions = observed, recorded, conditions
        self._setting = observed.setting
        self._cells: StaticCells | None = None
        courses = {id: self._course(track) for id, track in observed.true_tracks.items()}
        self.courses = {id: course for id, course in courses.items() if course is not None}

    def _course(self, track: TrueTrack) -> Course | None:
        """Course of an object; None for one that is never in the path."""
        observed, conditions, recorded = self._observed, self._conditions, self._recorded
        kept = [k for k, t in enumerate(track.stamps_ns)
                if conditions.is_evaluated(self._setting.log, observed.time_s(t))]  # fmt: skip
        stamps = [track.stamps_ns[k] for k in kept]
        sections = [recorded.section_at(t) for t in stamps]
        reach, s = conditions.corridor.length_m, recorded.at(np.array(stamps, np.int64))[0]
        gaps: list[float] = []
        for k, at, section in zip(kept, s.tolist(), sections, strict=True):
            pose = track.pose(k)
            gap = section.path.gap_m(at, pose, track.half_m, reach)
            if gap == 0.0 and not (gaps and math.isfinite(gaps[-1])):
                gap = 0.0 if section.path.gap_m(at - FRONT_M, pose, track.half_m) > 0.0 else math.inf
            gaps.append(gap)
        if not any(map(math.isfinite, gaps)):
            return None
        return Course(track, kept, stamps, np.array(gaps), sections)

    def ids_before(self, object_id: int, stamp_ns: int) -> set[int]:
        """Objects in the path that are not further than this one, at a time."""
        own = self.courses[object_id].gap_at(stamp_ns)
        gaps = {i: course.gap_at(stamp_ns) for i, course in self.courses.items() if i != object_id}
        return {i for i, gap in gaps.items() if gap <= own and math.isfinite(gap)}

    def approach(self, course: Course, first: int, last: int) -> tuple[Approach, range]:
        """Numbers of one interval, from `BEFORE_NS` before it, and the indices of its moments in the course."""
        start = first
        while start > 0 and course.stamps_ns[first] - course.stamps_ns[start - 1] <= BEFORE_NS \
                and course.sections[start - 1] is course.sections[first]:  # fmt: skip
            start -= 1
        rows = range(start, last + 1)
        stamps = np.array([course.stamps_ns[i] for i in rows], np.int64)
        speeds = self._recorded.at(stamps)[1]
        braking = self._conditions.braking
        needed = np.array([stopping_distance_m(v, braking.reaction_s, braking) for v in speeds.tolist()])
        gaps = course.gaps_m[start : last + 1]
        is_open = course.stamps_ns[last] >= int(self._recorded.stamps_ns[-1]) - 2 * round(self._period_ns)
        t_s = np.array([self._observed.time_s(int(t)) for t in stamps])
        is_due = (gaps < needed) & np.isfinite(gaps)
        until = int(np.argmax(is_due)) if is_due.any() else -1
        predicted = np.array([self._predicted_gap_m(course, i) if n <= until and not math.isfinite(gaps[n]) else -1.0
                              for n, i in enumerate(rows)])  # fmt: skip
        seen = np.array([self.is_visible(course, i) if is_due.any() else True for i in rows])
        return Approach(t_s, gaps, needed, speeds, predicted, seen, is_open), rows

    @property
    def _period_ns(self) -> float:
        return self._observed.period_s * 1e9

    def _predicted_gap_m(self, course: Course, i: int) -> float:
        """Greatest gap at which the constant-velocity prediction from label `i` on meets the path; −1: never."""
        track, k = course.track, course.k[i]
        velocity = track.velocity_mps(k)
        if not velocity.any():
            return -1.0
        s = float(self._recorded.at(course.stamps_ns[i])[0])
        pose = track.pose(k)
        poses = [pose + np.array([*(velocity * t), 0.0]) for t in HORIZON_S]
        path, reach = course.sections[i].path, self._conditions.corridor.length_m
        gaps = [path.gap_m(s, pose, track.half_m, reach) for pose in poses]
        return max((gap for gap in gaps if math.isfinite(gap)), default=-1.0)

    def is_visible(self, course: Course, i: int, occlusion: Occlusion | None = None) -> bool:
        """Whether a sensor sees the object at label `i`; `occlusion` in place of that of the label."""
        k = course.k[i]
        of_label = Occlusion(course.track.occlusions[k]) if occlusion is None else occlusion
        return self._is_seen(course.track, course.track.box(k), course.stamps_ns[i], of_label)

    def predicted(self, track: TrueTrack, k: int, stamp_ns: int, velocity_mps: Float64) -> Predicted:
        """An object at any time, by its label `k` and a velocity (2,) in odom."""
        s, v = (float(one) for one in self._recorded.at(stamp_ns))
        dt_s = (stamp_ns - track.stamps_ns[k]) * 1e-9
        pose = track.pose(k) + np.array([*(velocity_mps * dt_s), 0.0])
        section, braking = self._recorded.section_at(stamp_ns), self._conditions.braking
        gap = section.path.gap_m(s, pose, track.half_m, self._conditions.corridor.length_m)
        needed = stopping_distance_m(v, braking.reaction_s, braking)
        return Predicted(gap, needed, v, lambda: self._is_seen_at(track, k, pose, stamp_ns))

    def _is_seen_at(self, track: TrueTrack, k: int, pose_odom: Float64, stamp_ns: int) -> bool:
        """Whether a sensor would see the object of label `k` at another pose (3,)."""
        base = self._observed.motion.pose_at(stamp_ns)
        if base is None:
            return False
        box = track.box(k)
        center = np.array([*from_frame(base, pose_odom[None, :2])[0], box.center_m[2]])
        there = replace(box, center_m=center, yaw_rad=float(pose_odom[2] - base[2]))
        return self._is_labelled(center) and self._is_seen(track, there, stamp_ns, Occlusion.UNKNOWN)

    def _is_labelled(self, center_m: Float64) -> bool:
        """Whether a place in base is in the labelled sector."""
        T = self._setting.T_base_lidar.get(self._setting.truth_frame or "", np.eye(4))
        d = T[:3, :3].T @ (center_m - T[:3, 3])
        return abs(math.atan2(d[1], d[0])) <= self._setting.view_rad

    def _is_seen(self, track: TrueTrack, box: Box, stamp_ns: int, occlusion: Occlusion) -> bool:
        base = self._observed.motion.pose_at(stamp_ns)
        assert base is not None, "tracks have only labels with odometry"
        if self._cells is None:
            self._cells = self._observed.structure.cells(self._recorded.sections)
        solids: list[Solid] = [solid_of(other) for other in self._others(track.id, stamp_ns)]
        solids.append(self._cells.around(base, box.center_m[:2], float(np.hypot(*track.half_m))))
        return is_visible(solid_of(box), occlusion, self._setting.views, solids)

    def _others(self, object_id: int, stamp_ns: int) -> list[Box]:
        out = []
        for id, track in self._observed.true_tracks.items():
            k = nearest(track.stamps_ns, stamp_ns, 1_000_000) if id != object_id else None
            if k is not None:
                out.append(track.box(k))
        return out


def solid_of(box: Box) -> SolidBox:
    """The box as something that hides and is hidden."""
    return SolidBox(box.center_m, box.size_m, box.yaw_rad)
