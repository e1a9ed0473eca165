"""Departure of what blocked the path: seen leaving the swept area, or lost from view inside of it.

A person who stops the machine and walks away is followed from scan to scan by returns alone. One who is no longer seen
without having left may lie before the machine, or have entered a zone that no sensor covers. Returns that vanish within
less than `seen_s`, right before the machine `seen_near_s`, are no body: dust, a bird, single plants. What stood beside
all the time is not who left. Who was lost stays where they were while another path does not lead there.
"""

from collections import deque

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import from_frame
from safety.config import DepartureConfig
from safety.zones.swept_area import SweptArea, distance_to_contact_m

NOWHERE = np.empty((0, 2))
STILL_M = 0.15  # within which a return in the next scans is of the same thing
BESIDE_NS, AGO_NS = 1_000_000_000, 300_000_000


class Departure:
    """Follows the returns (N, 2) in odom that last blocked the swept area."""

    def __init__(self, config: DepartureConfig) -> None:
        self._config = config
        self._last_seen_odom_m: Float64 = NOWHERE
        self._beside: deque[tuple[int, Float64]] = deque()  # what was beside the area while it was blocked
        self._span_ns, self._is_near, self._is_ahead = (0, 0), False, False
        self._is_out_of_sight = False

    @property
    def is_unresolved(self) -> bool:
        """Whether what blocked the swept area, seen for long enough, has not been seen leaving it."""
        return self.is_kept and self._is_ahead

    @property
    def is_lost(self) -> bool:
        """The same, and it is not seen in the area now."""
        return self.is_unresolved and self._is_out_of_sight

    @property
    def is_kept(self) -> bool:
        """The same, though another path may not lead there."""
        first_ns, last_ns = self._span_ns
        return len(self._last_seen_odom_m) > 0 and last_ns - first_ns >= self._seen_ns

    @property
    def _seen_ns(self) -> int:
        return round((self._config.seen_near_s if self._is_near else self._config.seen_s) * 1e9)

    def forget(self) -> None:
        """An operator has confirmed that nobody is near the machine."""
        self._last_seen_odom_m = NOWHERE

    def update(self, hits_odom_m: Float64, area: SweptArea, pose_odom: Float64, now_ns: int) -> None:
        """Takes the present hits (N, 2), for base at `pose_odom` (3,)."""
        distance_m = self._distance_m(hits_odom_m, area, pose_odom, 0.0)
        blocking = hits_odom_m[distance_m <= self._config.ahead_m]
        if len(blocking):
            first_ns, last_ns = self._span_ns
            is_new = not self.is_kept and now_ns - last_ns > self._seen_ns
            beside = hits_odom_m[distance_m > self._config.ahead_m]
            self._note_beside(beside[is_in_box(beside, blocking, 2.0 * self._config.follow_m)], now_ns)
            self._last_seen_odom_m, self._span_ns = blocking, (now_ns if is_new else first_ns, now_ns)
            self._is_ahead, self._is_out_of_sight = True, False
            self._is_near = bool(distance_m.min() <= self._config.near_m) or (self._is_near and not is_new)
        elif self.is_kept:
            followed = hits_odom_m[is_near(hits_odom_m, self._last_seen_odom_m, self._config.follow_m)]
            beside = self._stood_beside()
            if len(followed) and len(beside):
                followed = followed[~is_near(followed, beside, STILL_M)]
            if len(followed):
                self._last_seen_odom_m = followed
            gap_m = self._distance_m(self._last_seen_odom_m, area, pose_odom, self._config.away_m)
            self._is_ahead = bool((gap_m <= self._config.ahead_m).any())
            self._is_out_of_sight = now_ns - self._span_ns[1] >= self._config.seen_s * 1e9
            is_far = np.hypot(*(self._last_seen_odom_m - pose_odom[:2]).T).min() > self._config.kept_m
            if is_far or (len(followed) and not self._is_ahead):
                self._last_seen_odom_m = NOWHERE

    def _note_beside(self, points_odom_m: Float64, now_ns: int) -> None:
        self._beside.append((now_ns, points_odom_m))
        while not 0 <= now_ns - self._beside[0][0] <= BESIDE_NS:
            self._beside.popleft()

    def _stood_beside(self) -> Float64:
        """What was beside the area some time before it was last blocked: who leaves was not there yet."""
        before_ns = self._span_ns[1] - AGO_NS
        return np.concatenate([NOWHERE, *(points for seen_ns, points in self._beside if seen_ns <= before_ns)])

    @staticmethod
    def _distance_m(points_odom_m: Float64, area: SweptArea, pose_odom: Float64, aside_m: float) -> Float64:
        """Distance to each point (N, 2) along the area widened by `aside_m` on each side, (N,), infinite beside it."""
        return distance_to_contact_m(from_frame(pose_odom, points_odom_m), area, 0.0, aside_m)


def is_in_box(points_m: Float64, others_m: Float64, within_m: float) -> np.ndarray:
    """Whether each point (N, 2) lies within the box about others (M, 2; at least one) and a distance, (N,) bool."""
    low, high = others_m.min(axis=0) - within_m, others_m.max(axis=0) + within_m
    return np.asarray(((points_m >= low) & (points_m <= high)).all(axis=1))


def is_near(points_m: Float64, others_m: Float64, within_m: float) -> np.ndarray:
    """Whether each point (N, 2) lies within a distance of one of the others (M, 2; at least one), (N,) bool."""
    near = is_in_box(points_m, others_m, within_m)  # a hedge has thousands of returns
    apart = points_m[near][:, None] - others_m[None]
    near[near] = (np.einsum("nmk,nmk->nm", apart, apart) <= within_m**2).any(axis=1)
    return np.asarray(near)
