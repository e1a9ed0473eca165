"""What lies ahead: both obstacle channels, proven range, geofence and surveyed walls; looked at when something came."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from configs.vehicle import Sensors
from geometry.transforms import yaw_of
from messages.command import ControlCommand
from messages.message import Float64
from messages.motion import MapPose, Odometry
from messages.perception import ObstacleClass, SensorHealth, Tracks
from messages.plan import Path, PathSectionType
from safety.config import SafetyConfig
from safety.monitors.vehicle import position_sigma_m
from safety.obstacle_sources import Measurements, Senses
from safety.pose_history import Trail, from_frame, planar_of, to_frame
from safety.sources.lidar import Eye
from safety.stopping_distance import Braking, stopping_distance, stopping_time
from safety.zones.footprint import Shape
from safety.zones.footprint_by_fold import Shapes
from safety.zones.geofence import Fence, way_inside_m
from safety.zones.known_structure import Survey
from safety.zones.protective_field import (
    Gap,
    Place,
    Way,
    arc_length_m,
    box_of,
    look_ahead_m,
    place_on,
    section_type_at,
    way_ahead,
)
from safety.zones.swept_area import corners_along
from safety.zones.tracked_obstacles import NO_THREAT, Explained, Threat, threat_in

FENCE_SPACING_M = 0.1
REACH_TO_TRACK_M = 1.0  # a hit this near to a track's box belongs to it


@dataclass(frozen=True)
class Seen:
    """What came in; None is missing or stale. `health` goes by names like `lidar_front`."""

    odom: Odometry | None
    map_pose: MapPose | None
    control_command: ControlCommand | None
    path: Path | None
    tracks: Tracks | None
    fold: float | None
    measured: Measurements
    health: Mapping[str, SensorHealth | None]


class Lookout:
    """Keeps the swept field of the present way and the gaps on it; between looks the gaps shrink by the way driven.

    `is_arc_judged` False looks along the planned way alone, where there is one.
    """

    def __init__(
        self, shapes: Shapes, sensors: Sensors, fence: Fence | None, survey: Survey | None, config: SafetyConfig,
        is_arc_judged: bool = True,
    ) -> None:  # fmt: skip
        self.senses = Senses(sensors, shapes.wide, config)
        self.way: Way | None = None
        self.trail = Trail()
        self.is_docking, self.is_under_roof = False, False
        self._shapes, self._shape, self._fence, self._survey = shapes, shapes.wide, fence, survey
        self._open, self._docked, self._config = config, config.docked, config
        self._is_arc_judged = is_arc_judged
        self._key: tuple[int, int, bool] = (-1, 0, False)
        self._gap: Gap | None = None
        self._threat = NO_THREAT
        self._fence_m: float | None = None
        self._survey_m = math.inf
        self._looked_at_m = 0.0
        self._stamps: tuple[int, ...] = ()

    @property
    def config(self) -> SafetyConfig:
        """The values that count at this place: those of the open field or of docking."""
        return self._config

    def look(self, seen: Seen, direction: int, speed_mps: float, braking: Braking, allowance_m: float) -> None:
        """Take what came; without odometry what was seen stays as it was."""
        if seen.odom is None:
            return
        self.trail.add(seen.odom)
        is_other_shape = self._wear(seen.fold)
        is_heard = self.senses.hear(seen.measured, self.trail, seen.odom)
        stamps, fresh = stamps_of(seen), self.senses.fresh(seen.measured)
        if stamps == self._stamps and not fresh and not is_heard and not is_other_shape:
            return
        self._stamps = stamps
        pose_map = pose_in_map(seen.map_pose, seen.odom)
        place = place_on(seen.path, seen.control_command)
        self._choose_field(place, pose_map)
        self.way = self._lay_way(seen.odom, place, pose_map, direction, speed_mps, braking, allowance_m)
        self._scan(seen, seen.odom, self.way, fresh, is_other_shape)
        self._measure(seen, seen.odom, self.way, pose_map, speed_mps, braking)

    def gap(self) -> Gap | None:
        """The gaps as they are now; None before any lidar has looked."""
        if self._gap is None:
            return None
        driven_m = self._driven_m
        return Gap(
            max(0.0, self._gap.main_m - driven_m),
            max(0.0, self._gap.arc_m - driven_m),
            self._gap.triggering_points_base_m,
        )

    def threat(self) -> Threat:
        """The nearest tracked threat as it is now."""
        return Threat(max(0.0, self._threat.clearance_m - self._driven_m), self._threat.label, self._threat.id)

    def fence_m(self) -> float | None:
        """The way that stays inside the geofence; None when the place is not known, below 0 when it is outside."""
        if self._fence is None:
            return math.inf
        if self._fence_m is None or self._fence_m < 0.0:
            return self._fence_m
        return max(0.0, self._fence_m - self._driven_m)

    def survey_m(self) -> float:
        """The way that stays clear of surveyed walls and posts; infinite where they are far."""
        return max(0.0, self._survey_m - self._driven_m)

    def cause(self, odom: Odometry | None, tracks: Tracks | None) -> ObstacleClass:
        """The class of whatever is nearest in the way."""
        if (
            self._gap is not None
            and len(self._gap.triggering_points_base_m)
            and odom is not None
            and tracks is not None
        ):
            hits = to_frame(planar_of(odom.T_odom_base), self._gap.triggering_points_base_m[:, :2])
            found = class_at(hits, tracks)
            if found is not ObstacleClass.UNKNOWN:
                return found
        return self._threat.label

    @property
    def _driven_m(self) -> float:
        return self.trail.driven_m - self._looked_at_m

    def _wear(self, fold: float | None) -> bool:
        """The outline at this fold; whether it is another than before."""
        shape: Shape = self._shapes.at(fold)
        if shape is self._shape:
            return False
        self._shape = shape
        self.senses.wear(shape)
        return True

    def _choose_field(self, place: Place | None, pose_map: Float64 | None) -> None:
        """That of docking: on a stretch to or from a bay, at the shed, in transport width."""
        is_narrow = self._shape is self._shapes.narrow
        is_dock_section = place is not None and section_type_at(place) is PathSectionType.DOCK
        near_m = self._open.docking.near_m
        is_there = self._survey is not None and pose_map is not None and self._survey.is_near(pose_map, near_m)
        self.is_docking = is_narrow and is_dock_section and is_there
        self._config = self._docked if self.is_docking else self._open

    def _lay_way(
        self, odom: Odometry, place: Place | None, pose_map: Float64 | None, direction: int, speed_mps: float,
        braking: Braking, allowance_m: float,
    ) -> Way:  # fmt: skip
        config = self._config.field
        is_along = place is not None and place.path.direction == direction
        way = way_ahead(
            place if is_along else None,
            pose_map,
            odom.curvature_radpm,
            direction,
            look_ahead_m(speed_mps, braking, config, allowance_m),
            arc_length_m(speed_mps, braking, config),
            self._shape,
            config,
        )
        return way if self._is_arc_judged or not way.is_planned else Way(way.main, None, True)

    def _scan(self, seen: Seen, odom: Odometry, way: Way, fresh: list[Eye], is_other_shape: bool) -> None:
        key = (seen.path.path_id if seen.path is not None else -1, way.main.direction, way.is_planned)
        is_other_way, self._key = key != self._key or is_other_shape, key
        box = box_of(way, self._config.field.ground_patch_m)
        self.senses.scan(seen.measured, fresh, self.trail, odom, box, is_other_way)

    def _measure(
        self, seen: Seen, odom: Odometry, way: Way, pose_map: Float64 | None, speed_mps: float, braking: Braking
    ) -> None:
        pose_odom = planar_of(odom.T_odom_base)
        self._looked_at_m = self.trail.driven_m
        sigma_m = self._config.docking.sigmas * position_sigma_m(seen.map_pose)
        is_explained = self._explaining(pose_odom, pose_map, sigma_m)
        self._gap = self.senses.gap(way, pose_odom, speed_mps, is_explained, seen.tracks)
        stop_s = stopping_time(speed_mps, braking)
        self._threat = threat_in(
            way.main, self._shape, seen.tracks, pose_odom, odom.curvature_radpm, stop_s, self._config.tracked,
            is_explained,
        )  # fmt: skip
        self._fence_m = self._inside_m(pose_map, way, speed_mps, braking)
        self._measure_survey(pose_map, way, sigma_m)

    def _explaining(self, pose_odom: Float64, pose_map: Float64 | None, sigma_m: float) -> Explained | None:
        """Says of places in odom which are surveyed walls; None where the docking field does not count."""
        survey = self._survey
        if not self.is_docking or survey is None or pose_map is None:
            return None
        tolerance_m = self._config.docking.explained_m + sigma_m

        def is_explained(points_odom: Float64) -> np.ndarray:
            return np.asarray(survey.away_m(to_frame(pose_map, from_frame(pose_odom, points_odom))) <= tolerance_m)

        return is_explained

    def _measure_survey(self, pose_map: Float64 | None, way: Way, sigma_m: float) -> None:
        self._survey_m, self.is_under_roof = math.inf, False
        if self._survey is None or pose_map is None or not self._survey.is_near(pose_map, self._open.docking.near_m):
            return
        self.is_under_roof = self._survey.is_under_roof(way.main, pose_map)
        if self.is_docking:
            clearance_m = self._config.docking.clearance_m + sigma_m
            sweeps = [sweep for sweep in (way.main, way.arc) if sweep is not None]
            self._survey_m = min(self._survey.clear_m(sweep, pose_map, clearance_m) for sweep in sweeps)

    def _inside_m(self, pose_map: Float64 | None, way: Way, speed_mps: float, braking: Braking) -> float | None:
        if self._fence is None or pose_map is None:
            return None
        reach_m = min(60.0, stopping_distance(speed_mps, braking)) + self._config.limits.fence_margin_m + 1.0
        inside_m = math.inf
        for sweep in (way.main,) if way.arc is None else (way.main, way.arc):
            near = sweep.until(reach_m)
            if self._fence.holds_box(near.box.seen_from(pose_map)):
                continue
            points, ways = corners_along(near, FENCE_SPACING_M)
            spacing_m = max(FENCE_SPACING_M, sweep.step_m)
            inside_m = min(inside_m, way_inside_m(self._fence, to_frame(pose_map, points), ways, spacing_m))
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
