"""Followers: who moves behind the machine as it does, also through a turn, and would reach it while it brakes.

At its present speed the machine is not reached, so nothing else stops it: it is reached when it slows in a turn, or
stops for something else. It has to stand before they arrive.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import from_frame
from messages.perception import ObstacleClass, Track
from safety.config import BystanderConfig, TrackedConfig
from safety.stopping_distance import Braking, braking_travel_m, stopping_time
from safety.zones.swept_area import SweptArea
from safety.zones.tracked_obstacles import velocity_sigma_mps

SLOPE, NOISE_MPS = 2.0, 0.5  # relative velocity along the machine over that across it, less its noise
NEAR_M = 5.0  # farther away nobody follows
CLOSING_MPS = 1.0  # of a vehicle that does not keep its distance
MARGIN_S = 0.5  # for which the machine stands before they arrive


class Followers:
    """Those that follow for some time: a cloud of dust behind the implement has a class for a moment."""

    def __init__(self, config: BystanderConfig, tracked: TrackedConfig) -> None:
        self._config, self._tracked = config, tracked
        self._since_ns: dict[int, int] = {}

    def update(
        self, moving: Iterable[Track], gaps_m: Mapping[int, float], area: SweptArea, pose_odom: Float64,
        motion: tuple[float, float], braking: Braking, stamp_ns: int,
    ) -> list[Track]:  # fmt: skip
        """Followers among moving tracks with their distances from machine and implement, by track number.

        `pose_odom` (3,): base in odom; `motion`: speed along the area and yaw rate.
        """
        found = [
            track for track in moving
            if follows(track, area, pose_odom, *motion)
            and self._is_reached(track, gaps_m[track.id], motion[0], braking)
        ]  # fmt: skip
        self._since_ns = {track.id: self._since_ns.get(track.id, stamp_ns) for track in found}
        least_ns = self._config.min_following_s * 1e9
        return [track for track in found if stamp_ns - self._since_ns[track.id] >= least_ns]

    def _is_reached(self, track: Track, gap_m: float, speed_mps: float, braking: Braking) -> bool:
        """Whether a track reaches the machine while it brakes, or soon after; the driver of a vehicle brakes too."""
        follower_mps = math.hypot(*track.velocity_mps[:2].tolist())
        keeps_distance = gap_m > self._config.away_m and follower_mps < speed_mps + CLOSING_MPS
        if gap_m > NEAR_M or (track.label is ObstacleClass.VEHICLE and keeps_distance):
            return False
        last_s = min(self._tracked.max_horizon_s, stopping_time(speed_mps, braking) + MARGIN_S)
        times_s = np.linspace(0.0, last_s, self._tracked.steps)
        fastest_mps = follower_mps + velocity_sigma_mps(track)
        gaps_m = gap_m + braking_travel_m(speed_mps, braking, times_s) - fastest_mps * times_s
        return float(gaps_m.min()) <= self._tracked.lateral_m


def follows(track: Track, area: SweptArea, pose_odom: Float64, speed_mps: float, yaw_rate_radps: float) -> bool:
    """Whether a track with a class keeps its place behind a machine that moves and turns, or comes straight on."""
    if track.label is ObstacleClass.UNKNOWN:
        return False
    side, no_place = area.direction, np.array([0.0, 0.0, pose_odom[2]])
    x, y = from_frame(pose_odom, track.p_odom_m[None, :2])[0]
    ends = (poses[0, 0] + (body.rear_m if side > 0 else body.front_m) for body, poses in area.bodies)
    along, across = from_frame(no_place, track.velocity_mps[None, :2])[0]
    along, across = along - side * speed_mps + yaw_rate_radps * y, across - yaw_rate_radps * x
    is_behind = all(side * x < side * end for end in ends)
    return bool(is_behind and side * along >= SLOPE * (abs(across) - NOISE_MPS))
