"""Static occupancy: cells of `odom` that have been occupied without interruption for some time.

The centre of the visible part of a wall moves along the wall, so a track alone would show a speed; the occupied cells
do not move. Of a body of length L at speed v only a share of 1 - v T / L of the cells is occupied for longer than T,
which bounds the speed. A compact body may have set off since: of such T is the age of the oldest of its other cells.
"""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Bool, Float32, Float64, Int32, Int64
from geometry.jit import kernel

WIDTH = 640  # cells; the grid is a torus, so that it need not be shifted


class StaticOccupancyConfig(Config):
    """Cell size and times; `settle_s` and `gap_s` must span two scans of the slowest lidar."""

    cell_m: float = Field(ge=0.05, le=1.0)
    settle_s: float = Field(gt=0.0, le=5.0)
    gap_s: float = Field(gt=0.0, le=5.0)
    body_length_m: float = Field(gt=0.0, le=50.0, description="greatest length of a moving body in the speed bound")
    structure_length_m: float = Field(gt=0.0, le=100.0, description="longer objects are walls, hedges or fences")
    compact_length_m: float = Field(ge=0.0, le=10.0, description="greatest length of a body that may have set off")
    set_off_s: float = Field(gt=0.0, le=5.0, description="least time since a compact body set off")
    speed_margin_mps: float = Field(ge=0.0, le=2.0)
    trail_s: float = Field(gt=0.0, le=5.0, description="the path of this time behind a moving body must be empty")
    trail_share: float = Field(gt=0.0, le=1.0, description="occupied share of that path which contradicts motion")
    ahead_m: float = Field(gt=0.0, le=5.0, description="before a low line of returns, looked at for a fence to go on")
    ahead_s: float = Field(gt=0.0, le=60.0, description="since a cell there was occupied")
    ahead_share: float = Field(gt=0.0, le=1.0, description="occupied share that shows the fence")


class StaticOccupancy:
    """Start of the occupancy of each cell around the machine."""

    def __init__(self, config: StaticOccupancyConfig) -> None:
        self._config = config
        self._key = np.full(WIDTH * WIDTH, -1, np.int64)
        self._since_ns = np.zeros(WIDTH * WIDTH, np.int64)
        self._last_ns = np.zeros(WIDTH * WIDTH, np.int64)
        self._mark = np.full(WIDTH * WIDTH, -1, np.int64)
        self._marks = 0

    def observe(self, points_odom_m: Float32, offsets: Int32, length_m: Float64, stamp_ns: int) -> Float64:
        """Upper bound of speed (K,) of clusters of a length (K,), infinite when most cells are new; stores the scan."""
        n, c = len(offsets) - 1, self._config
        share, new_s = np.zeros(n), np.zeros(n)
        self._marks += n
        _observe(
            points_odom_m, offsets, stamp_ns, c.cell_m, round(c.settle_s * 1e9), round(c.gap_s * 1e9), self._marks,
            self._key, self._since_ns, self._last_ns, self._mark, share, new_s,
        )  # fmt: skip
        time_s = np.where(length_m <= c.compact_length_m, np.maximum(new_s, c.set_off_s), c.settle_s)
        bound = (1.0 - share) * np.minimum(length_m, c.body_length_m) / time_s + c.speed_margin_mps
        bound = np.where(length_m > c.structure_length_m, 0.0, bound)
        return np.where(share >= 0.5, bound, np.inf)

    def contradicts_motion(self, p_m: Float64, velocity_mps: Float64, size_m: Float64, stamp_ns: int) -> Bool:
        """Whether the path behind bodies (T,) is still occupied, which contradicts their velocity.

        Of `p_m` (T, ..) only the first two columns are used.
        """
        contradicts = np.zeros(len(p_m), np.bool_)
        c = self._config
        _check_trail(
            p_m,
            velocity_mps,
            size_m,
            stamp_ns,
            c.cell_m,
            c.trail_s,
            c.trail_share,
            self._key,
            self._last_ns,
            contradicts,
        )
        return contradicts

    def continues_ahead(self, p_m: Float64, velocity_mps: Float64, size_m: Float64, stamp_ns: int) -> Bool:
        """Whether what bodies (T,) move towards was occupied before: they are pieces of a fence that lies there.

        Of `p_m` (T, ..) only the first two columns are used.
        """
        continues = np.zeros(len(p_m), np.bool_)
        c = self._config
        _check_ahead(
            p_m, velocity_mps, size_m, stamp_ns - round(c.ahead_s * 1e9), c.cell_m, c.ahead_m, c.ahead_share,
            self._key, self._last_ns, continues,
        )  # fmt: skip
        return continues


@kernel
def _cell(x: float, y: float, cell_m: float) -> tuple[int, int]:
    """Index of a position on the torus, and key of its cell."""
    u, v = int(np.floor(x / cell_m)), int(np.floor(y / cell_m))
    return (u % WIDTH) * WIDTH + v % WIDTH, u * 4294967296 + v


@kernel
def _observe(
    points: Float32, offsets: Int32, stamp_ns: int, cell_m: float, settle_ns: int, gap_ns: int, mark: int,
    key: Int64, since: Int64, last: Int64, marked: Int64, share: Float64, new_s: Float64,
) -> None:  # fmt: skip
    """Share (K,) of the cells occupied for longer than `settle_ns`, and age (K,) of the oldest of the others."""
    for k in range(share.shape[0]):
        cells = old = 0
        for i in range(offsets[k], offsets[k + 1]):
            c, cell_key = _cell(points[i, 0], points[i, 1], cell_m)
            if marked[c] == mark + k:
                continue
            marked[c] = mark + k
            if key[c] != cell_key or stamp_ns - last[c] > gap_ns or stamp_ns < since[c]:
                key[c], since[c] = cell_key, stamp_ns
            last[c] = stamp_ns
            cells += 1
            if stamp_ns - since[c] >= settle_ns:
                old += 1
            else:
                new_s[k] = max(new_s[k], (stamp_ns - since[c]) * 1e-9)
        if cells > 0:
            share[k] = old / cells


@kernel
def _check_trail(
    p: Float64, velocity: Float64, size: Float64, stamp_ns: int, cell_m: float, trail_s: float, max_share: float,
    key: Int64, last: Int64, contradicts: Bool,
) -> None:  # fmt: skip
    for k in range(p.shape[0]):
        speed = math.hypot(velocity[k, 0], velocity[k, 1])
        if speed == 0.0:
            continue
        # margin of two cells: the nearer end of a cell was left later, and limbs extend beyond the box
        tail = math.hypot(size[k, 0], size[k, 1]) / 2.0 + 2.0 * cell_m
        checked = occupied = 0
        for i in range(int(speed * trail_s / (0.5 * cell_m))):
            behind = tail + 0.5 * cell_m * i
            x, y = p[k, 0] - velocity[k, 0] / speed * behind, p[k, 1] - velocity[k, 1] / speed * behind
            c, cell_key = _cell(x, y, cell_m)
            checked += 1
            occupied += key[c] == cell_key and (stamp_ns - last[c]) * 1e-9 * speed < behind - tail
        contradicts[k] = checked > 0 and occupied >= max_share * checked


@kernel
def _check_ahead(
    p: Float64, velocity: Float64, size: Float64, oldest_ns: int, cell_m: float, length_m: float, min_share: float,
    key: Int64, last: Int64, continues: Bool,
) -> None:  # fmt: skip
    for k in range(p.shape[0]):
        speed = math.hypot(velocity[k, 0], velocity[k, 1])
        if speed == 0.0:
            continue
        nose = math.hypot(size[k, 0], size[k, 1]) / 2.0 + cell_m  # not its own cells
        checked = occupied = 0
        for i in range(int(length_m / (0.5 * cell_m))):
            ahead = nose + 0.5 * cell_m * i
            x, y = p[k, 0] + velocity[k, 0] / speed * ahead, p[k, 1] + velocity[k, 1] / speed * ahead
            c, cell_key = _cell(x, y, cell_m)
            checked += 1
            occupied += key[c] == cell_key and last[c] >= oldest_ns
        continues[k] = checked > 0 and occupied >= min_share * checked
