"""True objects in odom over time: boxes between, before and after their labels."""

import math
from array import array
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.pose2 import to_frame
from messages.truth import Occlusion
from validation.obstacle_stop.boxes import Box

VELOCITY_NS = 500_000_000
COLUMNS = 10
STANDING_MPS = 0.3  # slower motion is noise of the labels


@dataclass(eq=False)
class TrueTrack:
    """One true object: boxes in base at their stamps, and poses (3,) in odom there.

    `rows` has x, y and yaw in odom, then centre, size and yaw in base, of each label.
    """

    id: int
    label: str
    role: str
    stamps_ns: "array[int]" = field(default_factory=lambda: array("q"))
    rows: "array[float]" = field(default_factory=lambda: array("d"))
    occlusions: "array[int]" = field(default_factory=lambda: array("b"))
    half_m: Float64 = field(default_factory=lambda: np.zeros(2))  # of its base: the greatest that was labelled

    def add(self, stamp_ns: int, box: Box, occlusion: Occlusion, base_odom: Float64) -> None:
        """Appends a label; base is at `base_odom` (3,) in odom."""
        if self.stamps_ns and stamp_ns <= self.stamps_ns[-1]:
            return
        xy = to_frame(base_odom, box.center_m[None, :2])[0]
        yaw = box.yaw_rad + float(base_odom[2])
        if self.stamps_ns:
            before = self.rows[2 - COLUMNS]
            yaw = before + math.remainder(yaw - before, 2.0 * math.pi)
        self.stamps_ns.append(stamp_ns)
        self.occlusions.append(occlusion)
        self.rows.extend((*xy, yaw, *box.center_m, *box.size_m, box.yaw_rad))
        self.half_m = np.maximum(self.half_m, 0.5 * box.size_m[:2])

    def pose(self, k: int) -> Float64:
        """Pose (3,) in odom at label `k`."""
        return np.array(self.rows[COLUMNS * k : COLUMNS * k + 3])

    def poses(self) -> Float64:
        """Poses (N, 3) in odom at all labels."""
        return np.array(self.rows).reshape(-1, COLUMNS)[:, :3]

    def box(self, k: int) -> Box:
        """Box in base at label `k`."""
        row = np.array(self.rows[COLUMNS * k + 3 : COLUMNS * (k + 1)])
        return Box(self.id, self.label, self.role, row[:3], row[3:6], float(row[6]))

    def index(self, stamp_ns: int) -> int:
        """Index of the last label not after a time (the first one before all)."""
        return max(0, bisect_right(self.stamps_ns, stamp_ns) - 1)

    def velocity_mps(self, k: int) -> Float64:
        """Velocity (2,) over the half second up to label `k`; 0 for a standing object or a single label."""
        first = bisect_left(self.stamps_ns, self.stamps_ns[k] - VELOCITY_NS)
        if first >= k:
            return np.zeros(2)
        v = (self.pose(k) - self.pose(first))[:2] / ((self.stamps_ns[k] - self.stamps_ns[first]) * 1e-9)
        return np.asarray(v if float(np.hypot(*v)) >= STANDING_MPS else np.zeros(2))

    def poses_at(self, stamps_ns: Int64) -> Float64:
        """Poses (N, 3) in odom at times: linear between labels, at constant velocity after the last one."""
        known = np.array(self.stamps_ns, np.int64)
        out = np.column_stack([np.interp(stamps_ns, known, column) for column in self.poses().T])
        after_s = np.maximum(stamps_ns - known[-1], 0) * 1e-9
        out[:, :2] += after_s[:, None] * self.velocity_mps(len(known) - 1)
        return out
