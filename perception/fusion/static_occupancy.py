"""What stands still is known by its place: cells of `odom` that have been occupied without a break for some time.

The centre of a wall moves along the wall as its visible part does, so its track alone would give it a speed. The cells
that it occupies do not move. A body of length L at speed v leaves a share of only 1 - v T / L of its cells occupied for
longer than T, which bounds the speed.
"""

import math

import numpy as np
import numpy.typing as npt
from pydantic import Field

from configs.strict import Config
from geometry.jit import kernel
from messages.message import Float32, Float64, Int32, Int64

WIDTH = 640  # cells; the grid is a torus, so that it needs no moving


class StillnessConfig(Config):
    """Cells and times; `settle_s` and `gap_s` must span two scans of the slowest lidar."""

    cell_m: float = Field(ge=0.05, le=1.0)
    settle_s: float = Field(gt=0.0, le=5.0)
    gap_s: float = Field(gt=0.0, le=5.0)
    body_m: float = Field(gt=0.0, le=50.0, description="no more of a length than this is taken for that of a body")
    longest_m: float = Field(gt=0.0, le=100.0, description="what is longer is a wall, hedge or fence")
    slack_mps: float = Field(ge=0.0, le=2.0)
    trail_s: float = Field(gt=0.0, le=5.0, description="the way of so long behind a body must be found empty")
    trail_share: float = Field(gt=0.0, le=1.0, description="occupied, of that way, that shows that nothing moved")


class Stillness:
    """Since when each cell about the machine has been occupied."""

    def __init__(self, config: StillnessConfig) -> None:
        self._config = config
        self._key = np.full(WIDTH * WIDTH, -1, np.int64)
        self._since_ns = np.zeros(WIDTH * WIDTH, np.int64)
        self._last_ns = np.zeros(WIDTH * WIDTH, np.int64)
        self._mark = np.full(WIDTH * WIDTH, -1, np.int64)
        self._marks = 0

    def observe(self, points_odom_m: Float32, offsets: Int32, stamp_ns: int) -> Float64:
        """Share (K,) of each cluster's cells occupied for longer than `settle_s`; the scan enters the memory."""
        share = np.zeros(len(offsets) - 1)
        c = self._config
        self._marks += len(share)
        _observe(
            points_odom_m, offsets, stamp_ns, c.cell_m, round(c.settle_s * 1e9), round(c.gap_s * 1e9), self._marks,
            self._key, self._since_ns, self._last_ns, self._mark, share,
        )  # fmt: skip
        return share

    def fastest(self, share: Float64, length_m: Float64) -> Float64:
        """The greatest speed (K,) that agrees with a share of old cells; infinite when most cells are new."""
        c = self._config
        bound = (1.0 - share) * np.minimum(length_m, c.body_m) / c.settle_s + c.slack_mps
        bound = np.where(length_m > c.longest_m, 0.0, bound)
        return np.where(share >= 0.5, bound, np.inf)

    def is_refuted(self, p_m: Float64, velocity_mps: Float64, size_m: Float64, stamp_ns: int) -> npt.NDArray[np.bool_]:
        """Whether bodies (T,) cannot have come their way, since what they should have left is still occupied.

        Of `p_m` (T, ..) only the first two columns are used.
        """
        refuted = np.zeros(len(p_m), np.bool_)
        c = self._config
        _look_behind(
            p_m, velocity_mps, size_m, stamp_ns, c.cell_m, c.trail_s, c.trail_share, self._key, self._last_ns, refuted
        )
        return refuted


@kernel
def _cell(x: float, y: float, cell_m: float) -> tuple[int, int]:
    """Where on the torus a place is kept, and which of the cells kept there it is."""
    u, v = int(np.floor(x / cell_m)), int(np.floor(y / cell_m))
    return (u % WIDTH) * WIDTH + v % WIDTH, u * 4294967296 + v


@kernel
def _observe(
    points: Float32, offsets: Int32, stamp_ns: int, cell_m: float, settle_ns: int, gap_ns: int, mark: int,
    key: Int64, since: Int64, last: Int64, marked: Int64, share: Float64,
) -> None:  # fmt: skip
    for k in range(share.shape[0]):
        cells = old = 0
        for i in range(offsets[k], offsets[k + 1]):
            c, name = _cell(points[i, 0], points[i, 1], cell_m)
            if marked[c] == mark + k:
                continue
            marked[c] = mark + k
            if key[c] != name or stamp_ns - last[c] > gap_ns or stamp_ns < since[c]:
                key[c], since[c] = name, stamp_ns
            last[c] = stamp_ns
            cells += 1
            if stamp_ns - since[c] >= settle_ns:
                old += 1
        if cells > 0:
            share[k] = old / cells


@kernel
def _look_behind(
    p: Float64, velocity: Float64, size: Float64, stamp_ns: int, cell_m: float, trail_s: float, most: float,
    key: Int64, last: Int64, refuted: npt.NDArray[np.bool_],
) -> None:  # fmt: skip
    for k in range(p.shape[0]):
        speed = math.hypot(velocity[k, 0], velocity[k, 1])
        if speed == 0.0:
            continue
        # two cells of slack: the nearer end of a cell was left later, and limbs reach out of the box
        tail = math.hypot(size[k, 0], size[k, 1]) / 2.0 + 2.0 * cell_m
        looks = stays = 0
        for i in range(int(speed * trail_s / (0.5 * cell_m))):
            behind = tail + 0.5 * cell_m * i
            x, y = p[k, 0] - velocity[k, 0] / speed * behind, p[k, 1] - velocity[k, 1] / speed * behind
            c, name = _cell(x, y, cell_m)
            looks += 1
            stays += key[c] == name and (stamp_ns - last[c]) * 1e-9 * speed < behind - tail
        refuted[k] = looks > 0 and stays >= most * looks
