"""Followers: who moves behind the machine as it does, also through a turn, and would reach it while it brakes.

At its present speed the machine is not reached, so nothing else stops it: it is reached when it slows in a turn, or
stops for something else. It has to stand before they arrive.
"""

from collections.abc import Callable, Iterable

import numpy as np

from geometry.pose2 import from_frame
from messages.perception import ObstacleClass, Track
from safety.config import BystanderConfig, TrackedConfig
from safety.stopping_distance import braking_travel_m, stopping_time
from safety.zones.machine_motion import MachineMotion
from safety.zones.tracked_obstacles import length_m, speed_mps, velocity_sigma_mps

SLOPE, NOISE_MPS = 2.0, 0.5  # relative velocity along the machine over that across it, less its noise
FLAT = 0.3  # height over length: a gull that glides behind the implement, its span 1.0 m, was a person
NEAR_M = 5.0  # farther away nobody follows
CLOSING_MPS = 0.7  # of one that does not keep its distance
VEHICLE_M, BESIDE_M = 2.0, 0.4  # length of a small vehicle, whose parts are tracks; half the width of a person
BREAK_NS = 300_000_000  # in which the velocity of one that follows may be measured too low
MARGIN_S = 0.5  # for which the machine stands before they arrive


class Followers:
    """Those that follow for some time: a cloud of dust behind the implement has a class for a moment."""

    def __init__(self, config: BystanderConfig, tracked: TrackedConfig) -> None:
        self._config, self._tracked = config, tracked
        self._spans_ns: dict[int, tuple[int, int]] = {}  # first and last time

    def update(
        self, moving: Iterable[Track], gap_m: Callable[[Track], float], machine: MachineMotion, stamp_ns: int
    ) -> list[Track]:
        """Followers among moving tracks; `gap_m` gives the distance of one from machine and implement."""
        near = [(track, gap_m(track)) for track in moving if follows(track, machine)]
        found = [
            track for track, gap in near
            if self._is_reached(track, gap, machine) and not is_behind_another(track, gap, near, machine)
        ]  # fmt: skip
        recent = {number: span for number, span in self._spans_ns.items() if stamp_ns - span[1] <= BREAK_NS}
        self._spans_ns = recent | {track.id: (recent.get(track.id, (stamp_ns,))[0], stamp_ns) for track in found}
        least_ns = self._config.min_following_s * 1e9
        return [track for track in found if stamp_ns - self._spans_ns[track.id][0] >= least_ns]

    def _is_reached(self, track: Track, gap_m: float, machine: MachineMotion) -> bool:
        """Whether a track reaches the machine while it brakes, or soon after; who keeps a distance brakes too."""
        own_mps, follower_mps, braking = machine.speed_mps, speed_mps(track), machine.braking
        keeps_distance = gap_m > self._config.away_m and follower_mps < own_mps + CLOSING_MPS
        if gap_m > NEAR_M or keeps_distance:
            return False
        last_s = min(self._tracked.max_horizon_s, stopping_time(own_mps, braking) + MARGIN_S)
        times_s = np.linspace(0.0, last_s, self._tracked.steps)
        fastest_mps = follower_mps + velocity_sigma_mps(track)
        gaps_m = gap_m + braking_travel_m(own_mps, braking, times_s) - fastest_mps * times_s
        return float(gaps_m.min()) <= self._tracked.lateral_m


def is_behind_another(
    track: Track, gap_m: float, followers: Iterable[tuple[Track, float]], machine: MachineMotion
) -> bool:
    """Whether a follower would reach another one first: it is shortly behind it, or a part of the same vehicle."""

    def aside_m(other: Track) -> float:
        return float(from_frame(machine.pose_odom, other.p_odom_m[None, :2])[0, 1])

    return any(
        gap_m - VEHICLE_M < other_m < gap_m and abs(aside_m(other) - aside_m(track)) < BESIDE_M
        for other, other_m in followers
    )


def follows(track: Track, machine: MachineMotion) -> bool:
    """Whether a track keeps its place behind a machine that moves and turns, or comes straight on; no dust, no bird."""
    is_flat = float(track.size_m[2]) < FLAT * length_m(track)
    if track.label is ObstacleClass.UNKNOWN or is_flat:
        return False
    side, turned = machine.area.direction, np.array([0.0, 0.0, machine.pose_odom[2]])
    x, y = from_frame(machine.pose_odom, track.p_odom_m[None, :2])[0]
    ends = (poses[0, 0] + (body.rear_m if side > 0 else body.front_m) for body, poses in machine.area.bodies)
    along, across = from_frame(turned, track.velocity_mps[None, :2])[0]
    along += machine.yaw_rate_radps * y - side * machine.speed_mps
    across -= machine.yaw_rate_radps * x
    is_behind = all(side * x < side * end for end in ends)
    return bool(is_behind and side * along >= SLOPE * (abs(across) - NOISE_MPS))
