"""What lies ahead: both obstacle channels, proven range and geofence, looked at anew when something came."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from configs.vehicle import Lidar
from geometry.transforms import yaw_of
from messages.command import Wish
from messages.message import Float64
from messages.motion import MapPose, Odometry
from messages.perception import ObstacleClass, SensorHealth, Tracks
from messages.plan import Path
from messages.sensors import LidarScan
from messages.topics import KINDS
from safety.bodies import Shape
from safety.cells import thinned
from safety.config import SafetyConfig
from safety.eye import Eye
from safety.fence import Fence, way_inside_m
from safety.field import NOTHING, Gap, Way, arc_length_m, box_of, gap_in, look_ahead_m, place_on, way_ahead
from safety.motion import Trail, planar_of, to_frame
from safety.proven import shrink
from safety.returns import Motion
from safety.stopping import Braking, stopping_distance, stopping_time
from safety.sweep import corners_along
from safety.tracked import NO_THREAT, Threat, threat_in

FENCE_SPACING_M = 0.1
THIN_M = 0.05  # what a gap may be too long by
REACH_TO_TRACK_M = 1.0  # a hit this near to a track's box belongs to it


@dataclass(frozen=True)
class Seen:
    """What came in; None is missing or stale."""

    odom: Odometry | None
    map_pose: MapPose | None
    wish: Wish | None
    path: Path | None
    tracks: Tracks | None
    scans: Mapping[str, LidarScan | None]
    health: Mapping[str, SensorHealth | None]


class Lookout:
    """Keeps the swept field of the present way and the gaps on it; between looks the gaps shrink by the way driven."""

    def __init__(self, shape: Shape, lidars: Mapping[str, Lidar], fence: Fence | None, config: SafetyConfig) -> None:
        self.eyes = tuple(Eye(name, lidar, shape, config) for name, lidar in lidars.items())
        self.way: Way | None = None
        self.trail = Trail()
        self._shape, self._fence, self._config = shape, fence, config
        self._key: tuple[int, int, bool] = (-1, 0, False)
        self._gap: Gap | None = None
        self._threat = NO_THREAT
        self._fence_m: float | None = None
        self._looked_at_m = 0.0
        self._stamps: tuple[int, ...] = ()

    def look(self, seen: Seen, direction: int, speed_mps: float, braking: Braking, allowance_m: float) -> None:
        """Take what came; without odometry what was seen stays as it was."""
        if seen.odom is None:
            return
        self.trail.add(seen.odom)
        stamps = stamps_of(seen)
        fresh = [eye for eye in self.eyes if is_new(eye, seen.scans.get(eye.name))]
        if stamps == self._stamps and not fresh:
            return
        self._stamps = stamps
        self.way = self._lay_way(seen, seen.odom, direction, speed_mps, braking, allowance_m)
        self._scan(seen, seen.odom, self.way, fresh)
        self._measure(seen, seen.odom, self.way, speed_mps, braking)

    def gap(self) -> Gap | None:
        """The gaps as they are now; None before any lidar has looked."""
        if self._gap is None:
            return None
        driven_m = self.trail.driven_m - self._looked_at_m
        return Gap(max(0.0, self._gap.main_m - driven_m), max(0.0, self._gap.arc_m - driven_m), self._gap.hits_base_m)

    def threat(self) -> Threat:
        """The nearest tracked threat as it is now."""
        driven_m = self.trail.driven_m - self._looked_at_m
        return Threat(max(0.0, self._threat.gap_m - driven_m), self._threat.label, self._threat.id)

    def fence_m(self) -> float | None:
        """The way that stays inside the geofence; None when the place is not known, below 0 when it is outside."""
        if self._fence is None:
            return math.inf
        if self._fence_m is None or self._fence_m < 0.0:
            return self._fence_m
        return max(0.0, self._fence_m - (self.trail.driven_m - self._looked_at_m))

    def proven_m(self, now_ns: int, direction: int, health: Mapping[str, SensorHealth | None]) -> float:
        """The proven range in a direction: of the lidar that sees farthest there, each shrunk by its own health."""
        half_rad = math.radians(self._config.proven.look_deg)
        oldest_ns = now_ns - round(KINDS["lidar"].max_age_s * 1e9)
        ranges = [
            shrink(eye.proven_m(direction), health.get(eye.name), direction, half_rad)
            for eye in self.eyes
            if eye.stamp_ns is not None and eye.stamp_ns >= oldest_ns
        ]
        return max(ranges, default=0.0)

    def cause(self, odom: Odometry | None, tracks: Tracks | None) -> ObstacleClass:
        """The class of whatever is nearest in the way."""
        if self._gap is not None and len(self._gap.hits_base_m) and odom is not None and tracks is not None:
            hits = to_frame(planar_of(odom.T_odom_base), self._gap.hits_base_m[:, :2])
            found = class_at(hits, tracks)
            if found is not ObstacleClass.UNKNOWN:
                return found
        return self._threat.label

    def _lay_way(
        self, seen: Seen, odom: Odometry, direction: int, speed_mps: float, braking: Braking, allowance_m: float
    ) -> Way:
        config = self._config.field
        place = place_on(seen.path, seen.wish)
        is_along = place is not None and place.path.direction == direction
        return way_ahead(
            place if is_along else None,
            pose_in_map(seen.map_pose, odom),
            odom.curvature_radpm,
            direction,
            look_ahead_m(speed_mps, braking, config, allowance_m),
            arc_length_m(speed_mps, braking, config),
            self._shape,
            config,
        )

    def _scan(self, seen: Seen, odom: Odometry, way: Way, fresh: list[Eye]) -> None:
        key = (seen.path.path_id if seen.path is not None else -1, way.main.direction, way.is_planned)
        is_other_way, self._key = key != self._key, key
        box = box_of(way, self._config.field.ground_patch_m)
        motion = Motion(odom.speed_mps, odom.yaw_rate_radps)
        for eye in self.eyes:
            scan = seen.scans[eye.name] if eye in fresh else eye.scan if is_other_way else None
            if scan is not None:
                eye.take(scan, self.trail.pose_at(scan.stamp_ns), motion, odom.curvature_radpm, box)

    def _measure(self, seen: Seen, odom: Odometry, way: Way, speed_mps: float, braking: Braking) -> None:
        pose_odom = planar_of(odom.T_odom_base)
        self._looked_at_m = self.trail.driven_m
        if any(eye.stamp_ns is not None for eye in self.eyes):
            hits = [eye.hits_odom_m for eye in self.eyes]
            self._gap = gap_in(way, thinned(np.concatenate([NOTHING, *hits]), THIN_M), pose_odom)
        stop_s = stopping_time(speed_mps, braking)
        self._threat = threat_in(
            way.main, self._shape, seen.tracks, pose_odom, odom.curvature_radpm, stop_s, self._config.tracked
        )
        self._fence_m = self._inside_m(pose_in_map(seen.map_pose, odom), way, speed_mps, braking)

    def _inside_m(self, pose_map: Float64 | None, way: Way, speed_mps: float, braking: Braking) -> float | None:
        if self._fence is None or pose_map is None:
            return None
        reach_m = min(60.0, stopping_distance(speed_mps, braking)) + self._config.limits.fence_margin_m + 1.0
        inside_m = math.inf
        for sweep in (way.main,) if way.arc is None else (way.main, way.arc):
            points, ways = corners_along(sweep, FENCE_SPACING_M)
            near = ways <= reach_m
            spacing_m = max(FENCE_SPACING_M, sweep.step_m)
            inside_m = min(inside_m, way_inside_m(self._fence, to_frame(pose_map, points[near]), ways[near], spacing_m))
        return inside_m


def pose_in_map(map_pose: MapPose | None, odom: Odometry) -> Float64 | None:
    """Place and heading in map now, from the slow link and the fast odometry."""
    if map_pose is None or not map_pose.is_initialized:
        return None
    T = map_pose.T_map_odom @ odom.T_odom_base
    return np.array([T[0, 3], T[1, 3], yaw_of(T)])


def stamps_of(seen: Seen) -> tuple[int, ...]:
    """What a look depends on besides the scans."""
    parts = (seen.map_pose, seen.path, seen.tracks)
    return tuple(-1 if part is None else part.stamp_ns for part in parts)


def is_new(eye: Eye, scan: LidarScan | None) -> bool:
    """Whether a scan has not been taken yet; one from before the last is not taken."""
    return scan is not None and (eye.stamp_ns is None or scan.stamp_ns > eye.stamp_ns)


def class_at(points_odom: Float64, tracks: Tracks) -> ObstacleClass:
    """The class of the confirmed track whose box lies nearest to the points (N, 2), if near enough."""
    best, label = REACH_TO_TRACK_M, ObstacleClass.UNKNOWN
    for track in tracks.tracks:
        if not track.is_confirmed:
            continue
        away = np.hypot(*(points_odom - track.p_odom_m[:2]).T) - 0.5 * math.hypot(*track.size_m[:2])
        if float(away.min()) < best:
            best, label = float(away.min()), track.label
    return label
