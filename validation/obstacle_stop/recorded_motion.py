"""Recorded motion: odometry by time, and the driven line as sections of one direction with their swept paths.

The last section is continued beyond its end: along the planned path if there is one, else with the mean curvature of
its last second. The others end where the machine turned back, as the paths that the stack replays. A retreat of less
than `REVERSAL_M` is noise of the odometry, not a reversal.
"""

import math
from array import array
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.transforms import yaw_of
from validation.obstacle_stop.by_stamp import nearest
from validation.obstacle_stop.swept_path import STEP_M, Outline, SweptPath, arc, joined, swept_path

MAX_AGE_NS = 200_000_000
REVERSAL_M = 0.2
CURVE_NS = 1_000_000_000
MIN_CURVE_M = 0.5


@dataclass
class OdometryHistory:
    """Odometry as columns, looked up by time; `rows` has x, y, yaw, speed and yaw rate of each sample."""

    stamps_ns: "array[int]" = field(default_factory=lambda: array("q"))
    rows: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, stamp_ns: int, T_odom_base: Float64, speed_mps: float, turn_radps: float) -> None:
        """Appends a sample; a stamp that does not increase is ignored."""
        if self.stamps_ns and stamp_ns <= self.stamps_ns[-1]:
            return
        self.stamps_ns.append(stamp_ns)
        self.rows.extend((T_odom_base[0, 3], T_odom_base[1, 3], yaw_of(T_odom_base), speed_mps, turn_radps))

    def columns(self) -> tuple[Int64, Float64]:
        """Stamps (N,) and rows (N, 5)."""
        return np.array(self.stamps_ns, np.int64), np.array(self.rows, np.float64).reshape(-1, 5)

    def pose(self, k: int) -> Float64:
        """Pose (3,) in odom of sample `k`."""
        return np.array(self.rows[5 * k : 5 * k + 3])

    def rates(self, k: int) -> tuple[float, float]:
        """Speed and yaw rate of sample `k`."""
        return self.rows[5 * k + 3], self.rows[5 * k + 4]

    def index(self, stamp_ns: int) -> int | None:
        """Index of the nearest sample within 0.2 s, or None."""
        return nearest(self.stamps_ns, stamp_ns, MAX_AGE_NS)

    def speed_at(self, stamp_ns: int) -> float:
        """Forward speed (m/s) at a time; 0 when unknown."""
        k = self.index(stamp_ns)
        return 0.0 if k is None else self.rates(k)[0]

    def pose_at(self, stamp_ns: int) -> Float64 | None:
        """Pose (3,) in odom, linear between two samples; None further than 0.2 s from any."""
        stamps = self.stamps_ns
        k = bisect_left(stamps, stamp_ns)
        if self.index(stamp_ns) is None:
            return None
        if k == 0 or k == len(stamps) or stamps[k] == stamp_ns:
            return self.pose(min(k, len(stamps) - 1))
        a, b = self.pose(k - 1), self.pose(k)
        d = b - a
        d[2] = math.remainder(d[2], 2.0 * math.pi)
        return np.asarray(a + (stamp_ns - stamps[k - 1]) / (stamps[k] - stamps[k - 1]) * d)


@dataclass(frozen=True, eq=False)
class Section:
    """Part of the drive in one direction (+1, -1) from `start_ns` up to the distance `end_m`.

    `path` is swept by the outline with the side margin, `body_path` by the outline itself.
    """

    start_ns: int
    direction: int
    end_m: float
    path: SweptPath
    body_path: SweptPath


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Distance driven `s_m` (N,) and speed (N,), not negative, at stamps (N,), and the sections in order."""

    stamps_ns: Int64
    s_m: Float64
    speeds_mps: Float64
    sections: tuple[Section, ...]

    def at(self, stamp_ns: int | Int64) -> tuple[Float64, Float64]:
        """Distance and speed at times."""
        s, v = (np.asarray(np.interp(stamp_ns, self.stamps_ns, column)) for column in (self.s_m, self.speeds_mps))
        return s, v

    def section_at(self, stamp_ns: int) -> Section:
        """The section that is driven at a time."""
        return self.sections[max(0, bisect_right([s.start_ns for s in self.sections], stamp_ns) - 1)]


def recorded_motion(
    history: OdometryHistory,
    outlines: list[tuple[int, Outline]],
    side_margin_m: float,
    length_m: float,
    planned: Float64 | None,
) -> RecordedMotion | None:
    """Motion of a log; None without two samples.

    `outlines` are valid from a time on (ns), with `side_margin_m` on either side of what is in the path; `length_m` is
    that of the continuation, `planned` (K, 3) its poses.
    """
    if len(history.stamps_ns) < 2:
        return None
    stamps, rows = history.columns()
    poses = rows[:, :3]
    ahead = forward_distance(poses)
    bounds = [*turning_points(ahead), len(ahead) - 1]
    s, sections = np.zeros(len(ahead)), []
    for number, (first, last) in enumerate(pairwise(bounds)):
        run = slice(first, last + 1)
        direction = direction_of(ahead[run])
        driven = np.maximum.accumulate(direction * (ahead[run] - ahead[first]))
        s[run] = s[first] + np.maximum(driven, 0.0)
        is_last = number == len(bounds) - 2
        start_ns = int(stamps[first])
        outline = next((o for t, o in reversed(outlines) if t <= start_ns), outlines[0][1])
        length = length_m if is_last else STEP_M
        line = _line(stamps[run], s[run], poses[run], direction, length, planned if is_last else None)
        path = swept_path(*line, outline.widened(side_margin_m), direction > 0)
        body_path = swept_path(*line, outline, direction > 0)
        sections.append(Section(start_ns, direction, float(s[last]), path, body_path))
    return RecordedMotion(stamps, s, np.abs(rows[:, 3]), tuple(sections))


def forward_distance(poses: Float64) -> Float64:
    """Signed distance (N,) driven along the mean heading of each step."""
    yaw, d = np.unwrap(poses[:, 2]), np.diff(poses[:, :2], axis=0)
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    return np.concatenate([[0.0], np.cumsum(np.cos(middle) * d[:, 0] + np.sin(middle) * d[:, 1])])


def turning_points(ahead_m: Float64) -> list[int]:
    """Indices at which sections start: 0, and each extreme from which the machine moves back by `REVERSAL_M`."""
    starts, low, high, direction = [0], 0, 0, 0
    values = ahead_m.tolist()
    for k, value in enumerate(values):
        low, high = (k if value < values[low] else low), (k if value > values[high] else high)
        if direction >= 0 and value < values[high] - REVERSAL_M:
            starts += [high] if direction > 0 else []
            direction, low = -1, k
        elif direction <= 0 and value > values[low] + REVERSAL_M:
            starts += [low] if direction < 0 else []
            direction, high = 1, k
        if direction > 0:
            low = high
        elif direction < 0:
            high = low
    return starts


def direction_of(ahead_m: Float64) -> int:
    """Direction of a section; forward at standstill."""
    return -1 if ahead_m[-1] - ahead_m[0] < -0.5 * REVERSAL_M else 1


def _line(
    stamps: Int64, s: Float64, poses: Float64, direction: int, length_m: float, planned: Float64 | None
) -> tuple[Float64, Float64]:
    """Distances (N,) and poses (N, 3) of a section with its continuation."""
    keep = np.concatenate([[0], 1 + np.flatnonzero(np.diff(np.floor(s / STEP_M)) > 0)])
    line = poses[keep]
    beyond = planned
    if beyond is None or not len(beyond):
        curvature = last_curvature(stamps, direction * (s - s[0]), np.unwrap(poses[:, 2]))
        beyond = arc(line[-1], curvature, direction * np.arange(STEP_M, length_m + 0.5 * STEP_M, STEP_M))
    along, rest = s[keep], joined(line[-1:], beyond)
    distances = np.concatenate([along, along[-1] + rest[1][1:]])
    return distances, np.vstack([line, rest[0][1:]])


def last_curvature(stamps: Int64, ahead_m: Float64, yaw: Float64) -> float:
    """Mean curvature (rad/m) of the last second; `ahead_m` falls in reverse; 0 for less than `MIN_CURVE_M`."""
    first = int(np.searchsorted(stamps, stamps[-1] - CURVE_NS))
    distance_m = float(ahead_m[-1] - ahead_m[first])
    return float(yaw[-1] - yaw[first]) / distance_m if abs(distance_m) >= MIN_CURVE_M else 0.0
