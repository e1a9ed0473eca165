"""What lies ahead: both obstacle channels, proven range, geofence and surveyed walls; looked at when something came."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from configs.vehicle import Sensors
from geometry.arrays import Float64
from geometry.pose2 import from_frame, to_frame
from geometry.transforms import yaw_of
from messages.command import ControlCommand
from messages.motion import MapPose, Odometry
from messages.perception import ObstacleClass, SensorHealth, Tracks
from messages.plan import Path, PathSectionType
from safety.config import SafetyConfig
from safety.monitors.vehicle import position_sigma_m
from safety.obstacle_sources import ObstacleSources, SourceData
from safety.pose_history import PoseHistory, planar_pose
from safety.sources.lidar import LidarSource
from safety.stopping_distance import Braking, stopping_distance, stopping_time
from safety.zones.footprint import Footprint, FootprintSet
from safety.zones.geofence import Geofence, distance_inside_m
from safety.zones.known_structure import KnownStructure
from safety.zones.protective_field import (
    Clearance,
    PathPosition,
    SweptField,
    arc_length_m,
    box_of,
    look_ahead_m,
    position_on_path,
    section_type_at,
    sweep_field,
)
from safety.zones.swept_area import outline_points
from safety.zones.tracked_obstacles import (
    NO_CRITICAL_OBJECT,
    CriticalObject,
    KnownStructureFilter,
    nearest_critical_object,
)

FENCE_SPACING_M = 0.1
REACH_TO_TRACK_M = 1.0  # a hit this near to a track's box belongs to it


@dataclass(frozen=True)
class MonitorInputs:
    """What came in; None is missing or stale. `health` goes by names like `lidar_front`."""

    odom: Odometry | None
    map_pose: MapPose | None
    control_command: ControlCommand | None
    path: Path | None
    tracks: Tracks | None
    fold: float | None
    source_data: SourceData
    health: Mapping[str, SensorHealth | None]


class CollisionMonitor:
    """Keeps the swept field of the present way and the gaps on it; between looks the gaps shrink by the way driven.

    `is_arc_checked` False looks along the planned way alone, where there is one.
    """

    def __init__(
        self, footprints: FootprintSet, sensors: Sensors, geofence: Geofence | None,
        known_structure: KnownStructure | None, config: SafetyConfig,
        is_arc_checked: bool = True,
    ) -> None:  # fmt: skip
        self.sources = ObstacleSources(sensors, footprints.working, config)
        self.swept_field: SweptField | None = None
        self.pose_history = PoseHistory()
        self.is_docking, self.is_under_roof = False, False
        self._footprints, self._footprint, self._geofence, self._known_structure = (
            footprints,
            footprints.working,
            geofence,
            known_structure,
        )
        self._open, self._docked, self._config = config, config.docked, config
        self._is_arc_checked = is_arc_checked
        self._key: tuple[int, int, bool] = (-1, 0, False)
        self._clearance: Clearance | None = None
        self._critical_object = NO_CRITICAL_OBJECT
        self._geofence_distance_m: float | None = None
        self._wall_distance_m = math.inf
        self._updated_at_m = 0.0
        self._stamps: tuple[int, ...] = ()

    @property
    def config(self) -> SafetyConfig:
        """The values that count at this place: those of the open field or of docking."""
        return self._config

    def update(
        self, inputs: MonitorInputs, direction: int, speed_mps: float, braking: Braking, allowance_m: float
    ) -> None:
        """Take what came; without odometry what was seen stays as it was."""
        if inputs.odom is None:
            return
        self.pose_history.add(inputs.odom)
        is_new_footprint = self._set_footprint(inputs.fold)
        is_relevant = self.sources.update(inputs.source_data, self.pose_history, inputs.odom)
        stamps, fresh = stamps_of(inputs), self.sources.fresh(inputs.source_data)
        if stamps == self._stamps and not fresh and not is_relevant and not is_new_footprint:
            return
        self._stamps = stamps
        pose_map = pose_in_map(inputs.map_pose, inputs.odom)
        position = position_on_path(inputs.path, inputs.control_command)
        self._select_field(position, pose_map)
        self.swept_field = self._sweep_field(
            inputs.odom, position, pose_map, direction, speed_mps, braking, allowance_m
        )
        self._scan(inputs, inputs.odom, self.swept_field, fresh, is_new_footprint)
        self._measure(inputs, inputs.odom, self.swept_field, pose_map, speed_mps, braking)

    def clearance(self) -> Clearance | None:
        """The gaps as they are now; None before any lidar has looked."""
        if self._clearance is None:
            return None
        driven_m = self._driven_m
        return Clearance(
            max(0.0, self._clearance.main_m - driven_m),
            max(0.0, self._clearance.arc_m - driven_m),
            self._clearance.triggering_points_base_m,
        )

    def critical_object(self) -> CriticalObject:
        """The nearest tracked threat as it is now."""
        return CriticalObject(
            max(0.0, self._critical_object.clearance_m - self._driven_m),
            self._critical_object.label,
            self._critical_object.id,
        )

    def geofence_distance_m(self) -> float | None:
        """The way that stays inside the geofence; None when the place is not known, below 0 when it is outside."""
        if self._geofence is None:
            return math.inf
        if self._geofence_distance_m is None or self._geofence_distance_m < 0.0:
            return self._geofence_distance_m
        return max(0.0, self._geofence_distance_m - self._driven_m)

    def wall_distance_m(self) -> float:
        """The way that stays clear of surveyed walls and posts; infinite where they are far."""
        return max(0.0, self._wall_distance_m - self._driven_m)

    def obstacle_class(self, odom: Odometry | None, tracks: Tracks | None) -> ObstacleClass:
        """The class of whatever is nearest in the way."""
        if (
            self._clearance is not None
            and len(self._clearance.triggering_points_base_m)
            and odom is not None
            and tracks is not None
        ):
            hits = to_frame(planar_pose(odom.T_odom_base), self._clearance.triggering_points_base_m[:, :2])
            found = class_at(hits, tracks)
            if found is not ObstacleClass.UNKNOWN:
                return found
        return self._critical_object.label

    @property
    def _driven_m(self) -> float:
        return self.pose_history.driven_m - self._updated_at_m

    def _set_footprint(self, fold: float | None) -> bool:
        """The outline at this fold; whether it is another than before."""
        footprint: Footprint = self._footprints.at(fold)
        if footprint is self._footprint:
            return False
        self._footprint = footprint
        self.sources.set_footprint(footprint)
        return True

    def _select_field(self, position: PathPosition | None, pose_map: Float64 | None) -> None:
        """That of docking: on a stretch to or from a bay, at the shed, in transport width."""
        is_narrow = self._footprint is self._footprints.transport
        is_dock_section = position is not None and section_type_at(position) is PathSectionType.DOCK
        near_m = self._open.docking.near_m
        is_there = (
            self._known_structure is not None
            and pose_map is not None
            and self._known_structure.is_near(pose_map, near_m)
        )
        self.is_docking = is_narrow and is_dock_section and is_there
        self._config = self._docked if self.is_docking else self._open

    def _sweep_field(
        self, odom: Odometry, position: PathPosition | None, pose_map: Float64 | None, direction: int, speed_mps: float,
        braking: Braking, allowance_m: float,
    ) -> SweptField:  # fmt: skip
        config = self._config.field
        is_along = position is not None and position.path.direction == direction
        swept_field = sweep_field(
            position if is_along else None,
            pose_map,
            odom.curvature_radpm,
            direction,
            look_ahead_m(speed_mps, braking, config, allowance_m),
            arc_length_m(speed_mps, braking, config),
            self._footprint,
            config,
        )
        return (
            swept_field
            if self._is_arc_checked or not swept_field.is_planned
            else SweptField(swept_field.main, None, True)
        )

    def _scan(
        self,
        inputs: MonitorInputs,
        odom: Odometry,
        swept_field: SweptField,
        fresh: list[LidarSource],
        is_new_footprint: bool,
    ) -> None:
        key = (
            inputs.path.path_id if inputs.path is not None else -1,
            swept_field.main.direction,
            swept_field.is_planned,
        )
        is_new_field, self._key = key != self._key or is_new_footprint, key
        box = box_of(swept_field, self._config.field.ground_patch_m)
        self.sources.scan(inputs.source_data, fresh, self.pose_history, odom, box, is_new_field)

    def _measure(
        self,
        inputs: MonitorInputs,
        odom: Odometry,
        swept_field: SweptField,
        pose_map: Float64 | None,
        speed_mps: float,
        braking: Braking,
    ) -> None:
        pose_odom = planar_pose(odom.T_odom_base)
        self._updated_at_m = self.pose_history.driven_m
        sigma_m = self._config.docking.sigmas * position_sigma_m(inputs.map_pose)
        is_known = self._known_structure_filter(pose_odom, pose_map, sigma_m)
        self._clearance = self.sources.clearance(swept_field, pose_odom, speed_mps, is_known, inputs.tracks)
        stop_s = stopping_time(speed_mps, braking)
        self._critical_object = nearest_critical_object(
            swept_field.main, self._footprint, inputs.tracks, pose_odom, odom.curvature_radpm, stop_s,
            self._config.tracked,
            is_known,
        )  # fmt: skip
        self._geofence_distance_m = self._distance_inside_m(pose_map, swept_field, speed_mps, braking)
        self._measure_walls(pose_map, swept_field, sigma_m)

    def _known_structure_filter(
        self, pose_odom: Float64, pose_map: Float64 | None, sigma_m: float
    ) -> KnownStructureFilter | None:
        """Says of places in odom which are surveyed walls; None where the docking field does not count."""
        known_structure = self._known_structure
        if not self.is_docking or known_structure is None or pose_map is None:
            return None
        tolerance_m = self._config.docking.known_structure_tolerance_m + sigma_m

        def is_known(points_odom: Float64) -> np.ndarray:
            return np.asarray(
                known_structure.distance_m(to_frame(pose_map, from_frame(pose_odom, points_odom))) <= tolerance_m
            )

        return is_known

    def _measure_walls(self, pose_map: Float64 | None, swept_field: SweptField, sigma_m: float) -> None:
        self._wall_distance_m, self.is_under_roof = math.inf, False
        if (
            self._known_structure is None
            or pose_map is None
            or not self._known_structure.is_near(pose_map, self._open.docking.near_m)
        ):
            return
        self.is_under_roof = self._known_structure.is_under_roof(swept_field.main, pose_map)
        if self.is_docking:
            clearance_m = self._config.docking.clearance_m + sigma_m
            sweeps = [sweep for sweep in (swept_field.main, swept_field.arc) if sweep is not None]
            self._wall_distance_m = min(
                self._known_structure.clear_distance_m(sweep, pose_map, clearance_m) for sweep in sweeps
            )

    def _distance_inside_m(
        self, pose_map: Float64 | None, swept_field: SweptField, speed_mps: float, braking: Braking
    ) -> float | None:
        if self._geofence is None or pose_map is None:
            return None
        reach_m = min(60.0, stopping_distance(speed_mps, braking)) + self._config.limits.geofence_margin_m + 1.0
        inside_m = math.inf
        for sweep in (swept_field.main,) if swept_field.arc is None else (swept_field.main, swept_field.arc):
            near = sweep.up_to(reach_m)
            if self._geofence.contains_box(near.box.in_parent(pose_map)):
                continue
            points, ways = outline_points(near, FENCE_SPACING_M)
            spacing_m = max(FENCE_SPACING_M, sweep.step_m)
            inside_m = min(inside_m, distance_inside_m(self._geofence, to_frame(pose_map, points), ways, spacing_m))
        return inside_m


def pose_in_map(map_pose: MapPose | None, odom: Odometry) -> Float64 | None:
    """Place and heading in map now, from the slow link and the fast odometry."""
    if map_pose is None or not map_pose.is_initialized:
        return None
    T = map_pose.T_map_odom @ odom.T_odom_base
    return np.array([T[0, 3], T[1, 3], yaw_of(T)])


def stamps_of(inputs: MonitorInputs) -> tuple[int, ...]:
    """What a look depends on besides the scans."""
    parts = (inputs.map_pose, inputs.path, inputs.tracks)
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
