"""Motion of the machine from the structure in the scans of one lidar, independent of the odometry."""

from array import array
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Bool, Float32, Float64, Int64
from validation.obstacle_stop.consistency.kernels import structure_of
from validation.obstacle_stop.consistency.registration import (
    MAX_POINTS,
    inlier_share,
    normals_of,
    register,
    sort_into_cells,
)

MIN_POINTS = 60
MIN_SECTORS = 4  # of 12: structure in a few directions may move with the traffic
MAX_STEP_S = 1.5
MIN_STEP_M, SLOW_STEP_S = 0.8, 1.0  # distance between used scans, or time where it is not reached
POINT_ERROR_M = 0.1  # of single correspondences: size of trunks, leaves, distance of returns on a wall
STARTS_MPS = (0.0, 3.0, 6.0, 10.0, 15.0, 20.0)
DISPLACED = np.array([[0.4, 0.0, 0.0], [-0.4, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, -0.4, 0.0]])
MIN_DROP = 0.15  # of the share of inliers when displaced by 0.4 m


@dataclass(frozen=True, eq=False)
class ScanSteps:
    """Steps between scans (K rows): forward, left, yaw in the mean heading; share of inliers at the step and at that
    of the odometry; standard error of the step (m); where the motion forward and left is determined."""

    from_ns: Int64
    to_ns: Int64
    motion: Float64
    share: Float64
    odometry_share: Float64
    error_m: Float64
    is_known: Bool

    def select(self, mask: Bool) -> "ScanSteps":
        """The steps of a mask (K,)."""
        return ScanSteps(*(column[mask] for column in vars(self).values()))


class ScanMotion:
    """Call `add` with the reduced points of scans at intervals of a registration."""

    def __init__(self) -> None:
        self._reference: tuple[int, Float64] | None = None
        self._velocity: Float64 | None = None
        self._times = array("q")
        self._rows = array("d")

    @property
    def reference_ns(self) -> int | None:
        """Stamp of the last used scan."""
        return None if self._reference is None else self._reference[0]

    def is_due(self, stamp_ns: int, odometry: Float64 | None, period_s: float) -> bool:
        """Whether the last used scan is old enough, and the machine has moved on or does not move.

        Errors of a registration are some centimetres at any distance, so that slow machines need longer steps.
        """
        age_s = (stamp_ns - (self.reference_ns or 0)) * 1e-9 + 0.02
        has_moved = odometry is None or float(np.hypot(*odometry[:2])) >= MIN_STEP_M
        return age_s >= period_s and (has_moved or age_s >= SLOW_STEP_S)

    def add(self, stamp_ns: int, points_m: Float32, odometry: Float64 | None) -> None:
        """Registers a scan with the last one; `odometry` is the step (3,) of the odometry since then."""
        xy = structure_of(points_m)
        xy = np.ascontiguousarray(xy[:: len(xy) // MAX_POINTS + 1])
        reference, self._reference = self._reference, (stamp_ns, xy)
        if reference is None:
            return
        dt_s = (stamp_ns - reference[0]) * 1e-9
        if not (0.0 < dt_s <= MAX_STEP_S and self._is_around(xy) and self._is_around(reference[1])):
            self._velocity = None
            return
        self._match(reference, (stamp_ns, xy), odometry, dt_s)

    @staticmethod
    def _is_around(xy: Float64) -> bool:
        sector = ((np.arctan2(xy[:, 1], xy[:, 0]) + np.pi) * (12 / (2 * np.pi))).astype(int) % 12
        return len(xy) >= MIN_POINTS and int((np.bincount(sector, minlength=12) >= 5).sum()) >= MIN_SECTORS

    def _match(
        self, before: tuple[int, Float64], now: tuple[int, Float64], odometry: Float64 | None, dt_s: float
    ) -> None:
        starts, order = sort_into_cells(before[1])
        normals = normals_of(before[1], starts, order)
        found = [register(now[1], before[1], normals, starts, order, guess) for guess in self._guesses(odometry, dt_s)]
        shares = [inlier_share(now[1], before[1], starts, order, motion) for motion in found]
        motion, share = found[int(np.argmax(shares))], max(shares)
        displaced = [inlier_share(now[1], before[1], starts, order, motion + d) for d in DISPLACED]
        at_odometry = np.nan if odometry is None else inlier_share(now[1], before[1], starts, order, _start(odometry))
        is_known = share >= 0.4 and max(displaced) <= share - MIN_DROP
        self._velocity = motion / dt_s if is_known else None
        error_m = POINT_ERROR_M / np.sqrt(share * len(now[1]))
        half = -0.5 * motion[2]
        c, s = np.cos(half), np.sin(half)
        self._times.extend((before[0], now[0]))
        self._rows.extend(
            (
                c * motion[0] - s * motion[1],
                s * motion[0] + c * motion[1],
                motion[2],
                share,
                at_odometry,
                error_m,
                is_known,
            )
        )

    def _guesses(self, odometry: Float64 | None, dt_s: float) -> list[Float64]:
        if self._velocity is None:
            out = [np.array([v * dt_s, 0.0, 0.0]) for v in STARTS_MPS]
        else:
            out = [self._velocity * dt_s]
        if odometry is not None and min(float(np.abs(odometry[:2] - o[:2]).max()) for o in out) > 0.2:
            out.append(_start(odometry))
        return out

    def steps(self) -> ScanSteps:
        """All steps so far."""
        times = np.array(self._times, np.int64).reshape(-1, 2)
        rows = np.array(self._rows, np.float64).reshape(-1, 7)
        return ScanSteps(times[:, 0], times[:, 1], rows[:, :3], rows[:, 3], rows[:, 4], rows[:, 5], rows[:, 6] > 0.0)


def _start(step: Float64) -> Float64:
    """Step in the mean heading as a motion in the frame of its start."""
    c, s = np.cos(0.5 * step[2]), np.sin(0.5 * step[2])
    return np.array([c * step[0] - s * step[1], s * step[0] + c * step[1], step[2]])
