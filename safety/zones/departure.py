"""Departure of what blocked the path: seen leaving the swept area, or lost from view inside of it.

A person who stops the machine and walks away is followed from scan to scan by returns alone. One who is no longer seen
without having left may lie before the machine, or have entered a zone that no sensor covers. Returns that vanish within
less than `seen_s`, right before the machine `seen_near_s`, are no body: dust, a bird, single plants. What stood beside
all the time is not who left, nor is who was seen elsewhere while a body was lost and then came to its place. Who was
lost stays where they were while another path does not lead there.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.near_points import groups_of, is_in_box, is_near
from geometry.pose2 import from_frame
from safety.config import DepartureConfig
from safety.zones.swept_area import SweptArea, distance_to_contact_m

NOWHERE = np.empty((0, 2))
STILL_M = 0.15  # within which a return in the next scans is of the same thing
STEP_M = 0.3  # within which one in the next scan is of the same walker
BESIDE_NS, AGO_NS = 1_000_000_000, 300_000_000
UNSEEN_NS = 500_000_000  # five scans: who walks past a post counts as part of it for three


@dataclass(eq=False)
class _Body:
    """Returns (N, 2) in odom that blocked the area last, of one body or some side by side, and when first and last.

    `seen_ns`: when it was seen last, beside the area too; `is_ahead`: not seen leaving the area; `beside`: what was
    beside the area while this blocked it.
    """

    points_odom_m: Float64
    first_ns: int
    last_ns: int
    is_near: bool
    beside: deque[tuple[int, Float64]]
    seen_ns: int
    is_ahead: bool = True
    is_out_of_sight: bool = False

    def stood_beside(self) -> Float64:
        """What was beside the area some time before it was last blocked: who leaves was not there yet."""
        before_ns = self.last_ns - AGO_NS
        return np.concatenate([NOWHERE, *(points for seen_ns, points in self.beside if seen_ns <= before_ns)])


class Departure:
    """Follows the returns (N, 2) in odom that last blocked the swept area, each body by itself."""

    def __init__(self, config: DepartureConfig) -> None:
        self._config = config
        self._bodies: list[_Body] = []
        self._hits_odom_m = NOWHERE  # of the last scan

    @property
    def is_unresolved(self) -> bool:
        """Whether what blocked the swept area, seen for long enough, has not been seen leaving it."""
        return any(body.is_ahead and self._is_kept(body) for body in self._bodies)

    @property
    def is_lost(self) -> bool:
        """The same, and it is not seen in the area now."""
        return any(body.is_out_of_sight and body.is_ahead and self._is_kept(body) for body in self._bodies)

    @property
    def is_kept(self) -> bool:
        """The same, though another path may not lead there."""
        return any(self._is_kept(body) for body in self._bodies)

    def _is_kept(self, body: _Body) -> bool:
        return body.last_ns - body.first_ns >= self._seen_ns(body)

    def _seen_ns(self, body: _Body) -> int:
        return round((self._config.seen_near_s if body.is_near else self._config.seen_s) * 1e9)

    def forget(self) -> None:
        """An operator has confirmed that nobody is near the machine."""
        self._bodies = []

    def update(self, hits_odom_m: Float64, area: SweptArea, pose_odom: Float64, now_ns: int) -> None:
        """Takes the present hits (N, 2), for base at `pose_odom` (3,)."""
        distance_m = self._distance_m(hits_odom_m, area, pose_odom, 0.0)
        is_blocking = distance_m <= self._config.ahead_m
        blocking, beside = hits_odom_m[is_blocking], hits_odom_m[~is_blocking]
        seen, others, follow_m = list[_Body](), self._bodies, self._config.follow_m
        for group in groups_of(blocking, follow_m):
            points = blocking[group]
            before = [
                one for one in self._bodies
                if is_near(self._may_be(one, points, now_ns), one.points_odom_m, follow_m).any()
            ]  # fmt: skip
            others = [one for one in others if one not in before]
            near_m = float(distance_m[is_blocking][group].min())
            seen.append(self._seen(points, near_m, before, beside, now_ns))
        self._bodies = seen + [one for one in others if not self._has_gone(one, beside, area, pose_odom, now_ns)]
        self._hits_odom_m = hits_odom_m

    def _may_be(self, body: _Body, points_odom_m: Float64, now_ns: int) -> Float64:
        """Those returns that may be of a body: of one that is not seen, those where the last scan had none."""
        if now_ns - body.seen_ns < UNSEEN_NS or not len(self._hits_odom_m):
            return points_odom_m
        return np.asarray(points_odom_m[~is_near(points_odom_m, self._hits_odom_m, STEP_M)])

    def _seen(self, points_odom_m: Float64, near_m: float, before: list[_Body], beside: Float64, now_ns: int) -> _Body:
        """A body that blocks the area now, and `before` it did, or was near there."""
        since = [one for one in before if self._is_kept(one) or now_ns - one.last_ns <= self._seen_ns(one)]
        first_ns = min((one.first_ns for one in since), default=now_ns)
        is_close = near_m <= self._config.near_m or any(one.is_near for one in since)
        stood = deque(since[0].beside if since else ())
        stood.append((now_ns, beside[is_in_box(beside, points_odom_m, 2.0 * self._config.follow_m)]))
        while not 0 <= now_ns - stood[0][0] <= BESIDE_NS:
            stood.popleft()
        return _Body(points_odom_m, first_ns, now_ns, is_close, stood, now_ns)

    def _has_gone(self, body: _Body, beside: Float64, area: SweptArea, pose_odom: Float64, now_ns: int) -> bool:
        """Whether one that is not seen in the area was seen leaving it, is far behind, or was no body."""
        if not self._is_kept(body):
            return not 0 <= now_ns - body.last_ns <= self._seen_ns(body)
        followed, stood = beside[is_near(beside, body.points_odom_m, self._config.follow_m)], body.stood_beside()
        followed = self._may_be(body, followed, now_ns)
        if len(followed) and len(stood):
            followed = followed[~is_near(followed, stood, STILL_M)]
        if len(followed):
            body.points_odom_m, body.seen_ns = followed, now_ns
        gap_m = self._distance_m(body.points_odom_m, area, pose_odom, self._config.away_m)
        body.is_ahead = bool((gap_m <= self._config.ahead_m).any())
        body.is_out_of_sight = now_ns - body.last_ns >= self._config.seen_s * 1e9
        is_far = np.hypot(*(body.points_odom_m - pose_odom[:2]).T).min() > self._config.kept_m
        return bool(is_far or (len(followed) and not body.is_ahead))

    @staticmethod
    def _distance_m(points_odom_m: Float64, area: SweptArea, pose_odom: Float64, aside_m: float) -> Float64:
        """Distance to each point (N, 2) along the area widened by `aside_m` on each side, (N,), infinite beside it."""
        return distance_to_contact_m(from_frame(pose_odom, points_odom_m), area, 0.0, aside_m)
