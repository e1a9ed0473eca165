"""Standing bodies: a person or animal that stands beside the swept area may walk into it, so the machine passes slowly.

A body that sets off is known to move only after half a second, and reaches a wing 3 m away after one and a half: at
10 km/h there is no time to stop. Before the place where it would be passed at a gap the machine is slow enough to stop
short of it, and there to stand before the body has crossed the gap. A body that is lost from view, joined with what it
stands beside, stays where it was for a time, and so does one whose class changes. Where plants or rough ground hide who
lies, one that is lost in the path may lie there, and stays until an operator confirms that nobody does. Outside of the
geofence, trunks and posts of hedge and fence have the shape of a person: who comes from there counts as soon as they
move.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import from_frame
from messages.perception import ObstacleClass, Track
from safety.config import StandingBodyConfig
from safety.stopping_distance import Braking
from safety.zones.bystanders import distance_to_bodies_m
from safety.zones.swept_area import SweptArea, distance_to_contact_m
from safety.zones.tracked_obstacles import MAY_WALK, NO_CRITICAL_OBJECT, CriticalObject, box_points, length_m

MAY_LIE = MAY_WALK | {ObstacleClass.UNKNOWN}


@dataclass(frozen=True)
class StandingBody:
    """Body that allows the lowest speed now, with its smallest distance from what the machine will sweep."""

    speed_mps: float
    gap_m: float
    label: ObstacleClass


@dataclass(frozen=True)
class Cover:
    """Plants or rough ground that hide who lies: height, all tracks, confirmed or not, and odom in base (4, 4)."""

    height_m: float
    tracks: Sequence[Track]
    T_base_odom: Float64

    def is_below(self, track: Track, by_m: float) -> bool:
        """Whether the cover ends so far below the top of a track, as a lidar sees it."""
        top_m = float(self.T_base_odom[2] @ np.append(track.p_odom_m, 1.0)) + 0.5 * float(track.size_m[2])
        return top_m >= self.height_m + by_m and any(name.startswith("lidar") for name in track.sensors)


NO_STANDING_BODY = StandingBody(math.inf, math.inf, ObstacleClass.UNKNOWN)


class StandingBodies:
    """Follows standing persons and animals by track number; `slowest` allows the lowest speed.

    `hidden`: the nearest in the path that is lost in cover.
    """

    def __init__(self, config: StandingBodyConfig) -> None:
        self._config = config
        self._places: dict[int, tuple[Float64, ObstacleClass, int]] = {}  # box (9, 2) in odom, class, last seen
        self._above: set[int] = set()  # those that rose above the cover
        self._glimpsed: dict[int, tuple[Float64, ObstacleClass, int]] = {}
        self._first_m: dict[int, Float64] = {}  # first places (2,) in odom of small young tracks
        self.slowest, self.hidden = NO_STANDING_BODY, NO_CRITICAL_OBJECT

    def forget_hidden(self) -> None:
        """An operator has confirmed that nobody is near the machine."""
        self._places.clear()
        self._glimpsed.clear()
        self._above.clear()
        self.hidden = NO_CRITICAL_OBJECT

    def update(
        self, near: Iterable[tuple[Track, bool]], area: SweptArea, pose_odom: Float64, braking: Braking, now_ns: int,
        is_inside: Callable[[Float64], np.ndarray] | None, cover: Cover | None,
    ) -> None:  # fmt: skip
        """Takes the tracks, each with whether it moves, for base at `pose_odom` (3,) in odom.

        `is_inside` tests points (N, 2) in odom for the geofence; None: not known, so every body counts.
        `cover`: what hides who lies, None where nothing does.
        """
        for track, moves in near:
            if moves:
                self._places.pop(track.id, None)
            elif self._may_walk(track) and (is_inside is None or is_inside(box_points(track)).all()):
                self._places[track.id] = box_points(track), track.label, track.last_seen_ns
        if cover is not None:
            self._note_above(cover, is_inside)
        oldest_ns, lost_ns = (now_ns - round(time_s * 1e9) for time_s in (self._config.hold_s, self._config.lost_s))
        self._places = {
            number: place for number, place in self._places.items()
            if place[2] >= oldest_ns or (cover is not None and self._is_within_reach(place[0], pose_odom))
        }  # fmt: skip
        self._glimpsed = {n: one for n, one in self._glimpsed.items() if self._is_within_reach(one[0], pose_odom)}
        self._above &= self._places.keys()
        may_lie = {number: place for number, place in self._places.items() if number in self._above} | self._glimpsed
        hidden = [
            CriticalObject(self._ahead_m(box, area, pose_odom), label, number)
            for number, (box, label, seen_ns) in may_lie.items() if cover is not None and seen_ns < lost_ns
        ]  # fmt: skip
        self.hidden = min(hidden, key=lambda one: one.clearance_m, default=NO_CRITICAL_OBJECT)
        recent = [(box, label) for box, label, seen_ns in self._places.values() if seen_ns >= oldest_ns]
        found = [self._passing(box, label, area, pose_odom, braking) for box, label in recent]
        self.slowest = min(found, key=lambda one: one.speed_mps, default=NO_STANDING_BODY)

    def _note_above(self, cover: Cover, is_inside: Callable[[Float64], np.ndarray] | None) -> None:
        """Bodies that rise above the cover; small young ones also when seen twice at one place."""
        self._above |= {track.id for track in cover.tracks if cover.is_below(track, 0.0)} & self._places.keys()
        known = {track.id for track in cover.tracks if track.is_confirmed and self._is_settled(track)}
        self._glimpsed = {number: one for number, one in self._glimpsed.items() if number not in known}
        small = [
            track for track in cover.tracks
            if track.label in MAY_LIE and track.id not in known
            and length_m(track) <= self._config.glimpsed_length_m
            and cover.is_below(track, self._config.glimpsed_above_m)
        ]  # fmt: skip
        self._first_m = {track.id: self._first_m.get(track.id, track.p_odom_m[:2]) for track in small}
        for track in small:
            box, moved_m = box_points(track), float(np.hypot(*(track.p_odom_m[:2] - self._first_m[track.id])))
            is_twice = track.last_seen_ns - track.first_seen_ns >= self._config.glimpsed_s * 1e9
            if is_twice and moved_m <= self._config.glimpsed_length_m and (is_inside is None or is_inside(box).all()):
                self._glimpsed[track.id] = box, track.label, track.last_seen_ns

    def _is_within_reach(self, box_odom_m: Float64, pose_odom: Float64) -> bool:
        return bool(np.hypot(*(box_odom_m - pose_odom[:2]).T).min() <= self._config.reach_m)

    @staticmethod
    def _ahead_m(box_odom_m: Float64, area: SweptArea, pose_odom: Float64) -> float:
        """Distance along the swept area to a box, infinite beside it."""
        return float(np.min(distance_to_contact_m(from_frame(pose_odom, box_odom_m), area)))

    def _may_walk(self, track: Track) -> bool:
        return track.label in MAY_WALK and self._is_settled(track)

    def _is_settled(self, track: Track) -> bool:
        return track.last_seen_ns - track.first_seen_ns >= self._config.min_age_s * 1e9

    def _passing(
        self, box_odom_m: Float64, label: ObstacleClass, area: SweptArea, pose_odom: Float64, braking: Braking
    ) -> StandingBody:
        """Speed now with which the machine stops short of each place of the sweep, or passes it slowly enough."""
        config, points = self._config, from_frame(pose_odom, box_odom_m)
        at_each, travel_m = np.tile(points, (len(area.s_m), 1)), np.repeat(area.s_m, len(points))
        gaps_m = distance_to_bodies_m(at_each, area, travel_m).reshape(-1, len(points)).min(axis=1)
        dead_s, a = config.notice_s + braking.reaction_s + 0.5 * braking.build_up_s, braking.deceleration_mps2
        passing_mps = np.maximum(config.min_mps, a * (gaps_m / config.walk_mps - dead_s))
        stopping_mps = np.sqrt((a * dead_s) ** 2 + 2.0 * a * area.s_m) - a * dead_s
        return StandingBody(float(np.maximum(passing_mps, stopping_mps).min()), float(gaps_m.min()), label)
