"""Bystanders: tracked bodies that come towards machine or implement from any side, and have not been seen leaving.

The swept area begins at the leading edges. Somebody who walks into a wing from the side or from behind is touched by a
machine that drives on, and by one that sets off beside them. A bystander stops the machine before the contact, and it
stays at standstill until they were seen at a distance, or an operator has confirmed that nobody is there. A person or
animal who came from ahead, where the swept area stops the machine, keeps it standing too: it may drive off in the other
direction. A machine at rest also waits for who came nearer by place, though no velocity shows it, as of a body that
enters a blind zone or comes in changing parts, and for what is right at machine or implement. Any body that moves near
the machine stops the PTO, which runs down more slowly than the machine stops.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import Float64
from geometry.near_points import is_near
from geometry.pose2 import from_frame
from messages.perception import ObstacleClass, Track, Tracks
from safety.config import BystanderConfig, TrackedConfig
from safety.monitors.memory import DebounceTimer
from safety.zones.departure import STILL_M
from safety.zones.followers import Followers
from safety.zones.machine_motion import MachineMotion
from safety.zones.swept_area import SweptArea
from safety.zones.tracked_obstacles import (
    MAY_WALK,
    CriticalObject,
    box_points,
    covers,
    length_m,
    predicted,
    speed_mps,
)


@dataclass(frozen=True)
class Place:
    """Last box of a bystander, points (9, 2) in odom, when it was seen, whether it is seen now and may walk."""

    box_odom_m: Float64
    seen_ns: int
    is_seen: bool
    may_walk: bool

    @property
    def center_odom_m(self) -> Float64:
        """Centre (2,) in odom."""
        return np.asarray(self.box_odom_m.mean(axis=0))


class Bystanders:
    """Follows by track number those who came; `coming` is one that reaches the machine within the prediction.

    `pto_off_m`: distance from machine and implement within which a moving body stops the PTO. One that comes faster
    than at a walk stops it earlier, so that it stands when they arrive. `is_in_reach`: something is where the folded
    implement would unfold to.
    """

    def __init__(self, config: BystanderConfig, tracked: TrackedConfig, pto_stop_s: float) -> None:
        self._config, self._tracked = config, tracked
        self.pto_off_m = config.pto_walk_mps * pto_stop_s + config.pto_margin_m
        self._pto_stop_s = pto_stop_s
        self._places: dict[int, Place] = {}
        self._coming_since_ns: dict[int, int] = {}
        self._airborne_ns: dict[int, int] = {}  # when a track last was
        self._followers = Followers(config, tracked)
        self._first: dict[int, tuple[float, Float64]] = {}  # gap and place of tracks near the standing machine
        self._at_machine_ns: tuple[int, int] | None = None  # first and last time
        self.is_in_reach, self._reached = False, DebounceTimer()
        self._at_machine_odom_m = self._confirmed_odom_m = np.empty((0, 2))
        self.coming: CriticalObject | None = None
        self._close_ns: int | None = None

    @property
    def is_near(self) -> bool:
        """Whether a bystander has not been seen leaving, or something is right at the standing machine."""
        return bool(self._places) or self._is_at_machine

    @property
    def _is_at_machine(self) -> bool:
        span_ns = self._at_machine_ns
        return span_ns is not None and span_ns[1] - span_ns[0] >= self._config.at_machine_s * 1e9

    def note_close(self, moving: Iterable[Track], machine: MachineMotion, now_ns: int) -> None:
        """Takes all moving tracks, ahead too; one near a body, or that reaches it while the PTO runs down, stops it:
        also who follows the machine and would reach it if it stopped."""
        times_s = np.linspace(0.0, self._pto_stop_s, self._tracked.steps)
        for track in moving:
            is_close = self._is_settled(track) and _gap_m(place_of(track), machine) <= self.pto_off_m
            if is_close or any(self._is_coming(track, one, times_s) for one in (machine, machine.at_speed(0.0))):
                self._close_ns = now_ns

    def note_returns(
        self, hits_odom_m: Float64, is_inside: Callable[[Float64], np.ndarray] | None, machine: MachineMotion,
        unfolded: SweptArea | None, now_ns: int,
    ) -> None:  # fmt: skip
        """Takes the confirmed returns (N, 2) about a machine at rest, none while it moves: some right at machine or
        implement, for a time, keep it standing and its PTO off.

        `is_inside` tests points (N, 2) in odom for the geofence, beside which fence and hedge stand; None: not known.
        `unfolded`: area of the bodies when a folded implement will have unfolded.
        """
        if is_inside is not None and len(hits_odom_m):
            hits_odom_m = hits_odom_m[is_inside(hits_odom_m)]
        near, last = hits_odom_m[self._is_at(hits_odom_m, machine.area, machine.pose_odom)], self._at_machine_ns
        is_reached = unfolded is not None and bool(self._is_at(hits_odom_m, unfolded, machine.pose_odom).any())
        self.is_in_reach = self._reached.update(now_ns, is_reached) >= self._config.at_machine_s
        self._at_machine_odom_m = near
        if len(near) and len(self._confirmed_odom_m):
            near = near[~is_near(near, self._confirmed_odom_m, STILL_M)]
        if len(near):
            self._at_machine_ns = (now_ns if last is None else last[0], now_ns)
        elif last is not None and now_ns - last[1] > self._config.at_machine_s * 1e9:
            self._at_machine_ns = None
        if self._is_at_machine:
            self._close_ns = now_ns

    def _is_at(self, hits_odom_m: Float64, area: SweptArea, pose_odom: Float64) -> np.ndarray:
        """Whether each return (N, 2) is right at the bodies of an area, (N,) bool."""
        hits = from_frame(pose_odom, hits_odom_m)
        return distance_to_bodies_m(hits, area, np.zeros(len(hits))) <= self._config.at_machine_m

    def bars_pto(self, now_ns: int) -> bool:
        """Whether a body moves near machine or implement, or did a moment ago."""
        return self._close_ns is not None and now_ns - self._close_ns <= self._config.pto_hold_s * 1e9

    def forget_unseen(self) -> None:
        """An operator has confirmed that nobody is near the machine: only a person or animal that is seen remains.

        Returns right at machine or implement now are not of a body, as long as they stay where they are.
        """
        self._confirmed_odom_m, self._at_machine_ns = self._at_machine_odom_m, None
        self._places = {n: place for n, place in self._places.items() if place.is_seen and place.may_walk}

    def update(
        self, beside: Sequence[Track], ahead: Iterable[Track], near: Iterable[Track], tracks: Tracks | None,
        machine: MachineMotion, predicted_s: float,
    ) -> None:  # fmt: skip
        """Takes the moving tracks beside and ahead, those `near` a machine at rest, and all.

        Who comes from ahead is no reason to stop here, the path is checked for them, but one to stay.
        """
        times_s = np.linspace(0.0, predicted_s, self._tracked.steps)
        stamp_ns = 0 if tracks is None else tracks.stamp_ns
        self._note_airborne(() if tracks is None else tracks.tracks)
        found = [track for track in beside if self._is_coming(track, machine, times_s)]
        sides = {track.id for track in found}
        found += [
            track for track in ahead
            if track.label in MAY_WALK and self._is_coming(track, machine.at_speed(0.0), times_s)
        ]  # fmt: skip
        lasting = self._lasting(found, stamp_ns)
        followers = self._followers.update(beside, lambda one: _gap_m(place_of(one), machine), machine, stamp_ns)
        coming = [track for track in lasting if track.id in sides] + followers
        self.coming = CriticalObject(0.0, coming[0].label, coming[0].id) if coming else None
        seen = {} if tracks is None else {track.id: track for track in tracks.tracks if track.is_confirmed}
        followed = dict(self._followed(seen))
        self._places = {
            number: place
            for number, place in followed.items()
            if _gap_m(place, machine) <= (self._config.away_m if place.is_seen else self._config.lost_m)
        } | {track.id: place_of(track) for track in (*lasting, *followers, *self._arrived(near, machine))}

    def _note_airborne(self, tracks: Sequence[Track]) -> None:
        """Keeps when each of all tracks was last called airborne."""
        before = {track.id: self._airborne_ns[track.id] for track in tracks if track.id in self._airborne_ns}
        now = {track.id: track.last_seen_ns for track in tracks if track.label is ObstacleClass.AIRBORNE}
        self._airborne_ns = before | now

    def _arrived(self, near: Iterable[Track], machine: MachineMotion) -> list[Track]:
        """Those that have come nearer to the machine at rest since they were first seen there, and have left that
        place: the box of goods that stand side by side grows and shrinks."""
        config = self._config
        bodies = [track for track in near if length_m(track) <= self._tracked.max_unclassified_length_m]
        now = {track.id: (_gap_m(place_of(track), machine), track.p_odom_m[:2]) for track in bodies}
        self._first = {number: self._first.get(number, one) for number, one in now.items()}
        return [
            track for track in bodies
            if now[track.id][0] <= min(config.away_m, self._first[track.id][0] - config.arrived_m)
            and not covers(track, self._first[track.id][1])
        ]  # fmt: skip

    def _is_coming(self, track: Track, machine: MachineMotion, times_s: Float64) -> bool:
        """Whether a moving track gets nearer to the bodies, as they move on, and can meet one of them.

        It comes nearer at its velocity; to meet them it may also change that.
        """
        if not self._is_settled(track):
            return False
        centers, reach_m = predicted(track, times_s, self._tracked)
        centers, travel_m = from_frame(machine.pose_odom, centers), machine.speed_mps * times_s
        gaps_m = distance_to_bodies_m(centers, machine.area, travel_m) - reach_m
        is_own = gaps_m[0] + reach_m[0] <= self._tracked.self_filter_m
        nearest = int(np.argmin(gaps_m))
        is_closing = float(gaps_m[nearest]) < gaps_m[0] - self._config.closing_m
        change_mps2 = np.full(len(times_s), self._config.manoeuvre_mps2)
        change_mps2[: nearest + 1] = self._manoeuvre_mps2(track)  # who has passed does not turn back
        reachable_m = gaps_m - 0.5 * change_mps2 * times_s**2
        return not is_own and is_closing and float(reachable_m.min()) <= self._tracked.lateral_m

    def _manoeuvre_mps2(self, track: Track) -> float:
        """Change of its velocity that a body may make: who runs turns faster."""
        config = self._config
        if track.label not in MAY_WALK:
            return config.manoeuvre_mps2
        return max(config.manoeuvre_mps2, min(config.turn_radps * speed_mps(track), config.max_manoeuvre_mps2))

    def _lasting(self, coming: list[Track], stamp_ns: int) -> list[Track]:
        """Those that come in two messages and for some distance: edges of walls, parts of fences, stored goods that
        come into view and dust appear to for a moment."""
        since_ns = {track.id: self._coming_since_ns.get(track.id, stamp_ns) for track in coming}
        self._coming_since_ns = since_ns
        return [track for track in coming if (stamp_ns - since_ns[track.id]) * 1e-9 >= self._needed_s(track)]

    def _needed_s(self, track: Track) -> float:
        at_least_mps = max(speed_mps(track), self._tracked.moving_mps)
        return max(self._config.min_coming_s, self._config.min_coming_m / at_least_mps)

    def _is_settled(self, track: Track) -> bool:
        """Whether the motion of a moving track counts: it has a class, or has had none for long enough, not that of
        dust, and is not high and narrow, as the edge of a wall or a post is."""
        if track.label is not ObstacleClass.UNKNOWN:
            return True
        is_edge = float(track.size_m[2]) > self._config.max_unclassified_height_m
        is_edge = is_edge and length_m(track) < self._tracked.max_unclassified_length_m
        since_ns = self._airborne_ns.get(track.id, track.first_seen_ns)
        age_s = (track.last_seen_ns - since_ns) * 1e-9
        return age_s >= self._config.min_unclassified_age_s and not is_edge

    def _followed(self, seen: dict[int, Track]) -> Iterable[tuple[int, Place]]:
        """Each bystander at its new place, under the number of the track that continues it.

        A track continues one bystander, and one that was seen beside it before only where it now is itself.
        """
        free = {number: track for number, track in seen.items() if number not in self._places}
        for number, place in self._places.items():
            track = seen.get(number)
            if track is None:
                since_ns = place.seen_ns - round(self._config.overlap_s * 1e9)
                new = [one for one in free.values() if one.first_seen_ns >= since_ns]
                track = nearest_track(new, place, self._config.follow_m)
                track = track or nearest_track(free.values(), place, self._config.same_m)
            if track is None:
                yield number, replace(place, is_seen=False)
            else:
                free.pop(track.id, None)
                yield track.id, place_of(track)


def place_of(track: Track) -> Place:
    """The present place of a track."""
    return Place(box_points(track), track.last_seen_ns, True, track.label in MAY_WALK)


def nearest_track(tracks: Iterable[Track], place: Place, within_m: float) -> Track | None:
    """Nearest track within a distance of a place."""
    near = [(math.hypot(*(track.p_odom_m[:2] - place.center_odom_m)), track.id, track) for track in tracks]
    distance_m, _, track = min(near, key=lambda entry: entry[:2], default=(math.inf, -1, None))
    return track if distance_m <= within_m else None


def distance_to_bodies_m(points_base_m: Float64, area: SweptArea, travel_m: Float64) -> Float64:
    """Distance of each point (N, 2) in base now from the nearest body after a travel (N,) along the area, (N,)."""
    pose = np.minimum(np.searchsorted(area.s_m, travel_m), len(area.s_m) - 1)
    best = np.full(len(points_base_m), np.inf)
    for body, poses in area.bodies:
        x, y = _in_frames(points_base_m, poses[pose])
        along = np.maximum(np.maximum(body.rear_m - x, x - body.front_m), 0.0)
        best = np.minimum(best, np.hypot(along, np.maximum(np.abs(y) - body.half_width_m, 0.0)))
    return best


def _in_frames(points: Float64, poses: Float64) -> tuple[Float64, Float64]:
    """Coordinates of each point (N, 2) in the frame of its own pose (N, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy = points[:, 0] - poses[:, 0], points[:, 1] - poses[:, 1]
    return c * dx + s * dy, c * dy - s * dx


def _gap_m(place: Place, machine: MachineMotion) -> float:
    """Distance of a bystander from machine and implement now."""
    points = from_frame(machine.pose_odom, place.box_odom_m)
    return float(distance_to_bodies_m(points, machine.area, np.zeros(len(points))).min())
