"""True objects in odom over time: boxes between, before and after their labels."""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.pose2 import to_frame
from messages.truth import Occlusion
from validation.obstacle_stop.boxes import Box

VELOCITY_NS = 500_000_000
STANDING_MPS = 0.3  # slower motion is noise of the labels


@dataclass(eq=False)
class TrueTrack:
    """One true object: boxes in base at their stamps, and poses (3,) in odom there."""

    id: int
    label: str
    role: str
    stamps_ns: list[int] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)
    occlusions: list[Occlusion] = field(default_factory=list)
    poses: list[Float64] = field(default_factory=list)

    def add(self, stamp_ns: int, box: Box, occlusion: Occlusion, base_odom: Float64) -> None:
        """Appends a label; base is at `base_odom` (3,) in odom."""
        if self.stamps_ns and stamp_ns <= self.stamps_ns[-1]:
            return
        xy = to_frame(base_odom, box.center_m[None, :2])[0]
        yaw = box.yaw_rad + float(base_odom[2])
        if self.poses:
            yaw = self.poses[-1][2] + math.remainder(yaw - self.poses[-1][2], 2.0 * math.pi)
        self.stamps_ns.append(stamp_ns)
        self.boxes.append(box)
        self.occlusions.append(occlusion)
        self.poses.append(np.array([*xy, yaw]))

    @property
    def half_m(self) -> Float64:
        """Half size (2,) of its base: the greatest that was labelled."""
        return np.asarray(0.5 * np.max([box.size_m[:2] for box in self.boxes], axis=0))

    def index(self, stamp_ns: int) -> int:
        """Index of the last label not after a time (the first one before all)."""
        return max(0, bisect_right(self.stamps_ns, stamp_ns) - 1)

    def velocity_mps(self, k: int) -> Float64:
        """Velocity (2,) over the half second up to label `k`; 0 for a standing object or a single label."""
        first = bisect_left(self.stamps_ns, self.stamps_ns[k] - VELOCITY_NS)
        if first >= k:
            return np.zeros(2)
        v = (self.poses[k][:2] - self.poses[first][:2]) / ((self.stamps_ns[k] - self.stamps_ns[first]) * 1e-9)
        return np.asarray(v if float(np.hypot(*v)) >= STANDING_MPS else np.zeros(2))

    def poses_at(self, stamps_ns: Int64) -> Float64:
        """Poses (N, 3) in odom at times: linear between labels, at constant velocity after the last one."""
        known = np.array(self.stamps_ns, np.int64)
        out = np.column_stack([np.interp(stamps_ns, known, column) for column in np.array(self.poses).T])
        after_s = np.maximum(stamps_ns - known[-1], 0) * 1e-9
        out[:, :2] += after_s[:, None] * self.velocity_mps(len(known) - 1)
        return out
