"""Collision monitor: clearances along the swept field of both obstacle channels, geofence and known structure.

raw returns ─► obstacle sources ─┐
tracks ──────────────────────────┼─► distances along the swept field ─► less the distance driven since the update
geofence, known structure ───────┘   (updated on new data)              (at every supervisor step)
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from configs.vehicle import Sensors
from geometry.arrays import Float64
from geometry.near_points import is_near
from geometry.pose2 import from_frame, to_frame
from geometry.transforms import invert
from messages.command import ControlCommand
from messages.motion import MapPose, Odometry
from messages.perception import ObstacleClass, SensorHealth, Track, Tracks
from messages.plan import Path, PathSectionType
from safety.config import SafetyConfig
from safety.hitch_angle import HitchAngle
from safety.monitors.vehicle import position_sigma_m
from safety.obstacle_sources import THIN_M, ObstacleSources, SourceData
from safety.pose_history import PoseHistory, planar_pose
from safety.sources.lidar import LidarSource
from safety.sources.multiple_evaluation import thin
from safety.stopping_distance import Braking, stopping_distance, stopping_time
from safety.zones.bystanders import Bystanders
from safety.zones.departure import NOWHERE, Departure
from safety.zones.footprint import FootprintSet
from safety.zones.geofence import Geofence, distance_inside_m
from safety.zones.known_structure import KnownStructure
from safety.zones.machine_motion import MachineMotion
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
from safety.zones.standing_bodies import Cover, StandingBodies
from safety.zones.swept_area import outline_points, sweep_along
from safety.zones.tracked_obstacles import (
    NO_CRITICAL_OBJECT,
    CriticalObject,
    KnownStructureFilter,
    horizon_s,
    is_ahead,
    is_broad_mover,
    nearest_critical_object,
    tracks_near,
    without_posts,
)

GEOFENCE_SPACING_M = 0.1
MAX_GEOFENCE_REACH_M = 60.0
HIT_TO_TRACK_M = 1.0  # a hit this near to the circle about a track's box belongs to the track


@dataclass(frozen=True)
class MonitorInputs:
    """Messages of one step; None: missing or stale. `health` by sensor label such as `lidar_front`.

    The machine drives on the path shifted by `line_shift_m` (x, y in map).
    """

    odom: Odometry | None
    map_pose: MapPose | None
    control_command: ControlCommand | None
    path: Path | None
    tracks: Tracks | None
    fold: float | None
    hitch: float
    source_data: SourceData
    health: Mapping[str, SensorHealth | None]
    line_shift_m: tuple[float, float] = (0.0, 0.0)


class CollisionMonitor:
    """Keeps the swept field and the distances along it; between updates they shrink by the distance driven."""

    def __init__(
        self, footprints: FootprintSet, sensors: Sensors, geofence: Geofence | None,
        known_structure: KnownStructure | None, config: SafetyConfig, consented_m: float = 0.0,
    ) -> None:  # fmt: skip
        self.sources = ObstacleSources(sensors, footprints.working, config, consented_m)
        self.swept_field: SweptField | None = None
        self.pose_history = PoseHistory()
        self.departure = Departure(config.departure)
        self.bystanders = Bystanders(config.bystanders, config.tracked, footprints.pto_stop_s)
        self.standing_bodies = StandingBodies(config.standing_body)
        self.is_docking, self.is_under_roof = False, False
        self._footprints, self._footprint = footprints, footprints.working
        self._unfolded = sweep_along(footprints.working, 1, np.zeros(1), np.zeros((1, 3)), 0.0, config.field, False)
        drawbar = footprints.working.drawbar
        self._hitch_angle = None if drawbar is None else HitchAngle(drawbar, footprints.max_hitch_rad)
        self._geofence, self._known_structure = geofence, known_structure
        self._open, self._docked, self._config = config, config.docked, config
        self._key: tuple[int, int, bool] = (-1, 0, False)
        self._clearance: Clearance | None = None
        self._critical_object = NO_CRITICAL_OBJECT
        self._geofence_distance_m: float | None = None
        self._wall_distance_m = math.inf
        self._updated_at_m = 0.0
        self._stamps: tuple[int, ...] = ()

    @property
    def config(self) -> SafetyConfig:
        """Configuration in force: with the open field or the docking field."""
        return self._config

    def update(
        self, inputs: MonitorInputs, direction: int, speed_mps: float, braking: Braking, allowance_m: float
    ) -> None:
        """Processes one step; without odometry the last result stays in force."""
        odom = inputs.odom
        if odom is None:
            return
        self.pose_history.add(odom)
        is_new_footprint = self._set_footprint(inputs.fold)
        self._follow_hitch(odom)
        self.sources.set_hitch(inputs.hitch)
        is_relevant = self.sources.update(inputs.source_data, self.pose_history, odom)
        stamps, new = stamps_of(inputs), self.sources.with_new_scan(inputs.source_data)
        if stamps == self._stamps and not new and not is_relevant and not is_new_footprint:
            return
        self._stamps = stamps
        pose_map = pose_in_map(inputs.map_pose, odom)
        position = position_on_path(inputs.path, inputs.control_command)
        self._select_field(position, pose_map)
        pose_on_path = None if pose_map is None else pose_map - (*inputs.line_shift_m, 0.0)
        swept_field = self.lay_field(odom, position, pose_on_path, direction, speed_mps, braking, allowance_m)
        self.swept_field = swept_field
        self._update_lidars(inputs, odom, swept_field, new, is_new_footprint)
        self._update_distances(inputs, odom, swept_field, pose_map, speed_mps, braking)

    def is_departure_unresolved(self, control_command: ControlCommand | None) -> bool:
        """Whether somebody may be where the machine or its implement moves to, also by unfolding as commanded."""
        return self.departure.is_unresolved or self.is_somebody_near(control_command)

    def is_somebody_near(self, control_command: ControlCommand | None) -> bool:
        """The same without what is seen in the path, to which the speed is limited."""
        unfolds = control_command is not None and not control_command.is_implement_folded
        is_in_reach = unfolds and self.bystanders.is_in_reach
        return self.departure.is_lost or self.bystanders.is_near or is_in_reach

    def confirm_clear(self) -> None:
        """An operator has confirmed that nobody is near the machine: what is held without being seen is dropped."""
        self.departure.forget()
        self.bystanders.forget_unseen()
        self.standing_bodies.forget_hidden()
        self.sources.forget_held()

    def clearance(self) -> Clearance | None:
        """Clearance of the raw protective field now; None before the first lidar scan."""
        found = self._clearance
        if found is None:
            return None
        driven_m = self._driven_m
        main_m, arc_m = max(0.0, found.main_m - driven_m), max(0.0, found.arc_m - driven_m)
        return Clearance(main_m, arc_m, found.triggering_points_base_m)

    def critical_object(self) -> CriticalObject:
        """Nearest critical tracked object now."""
        found = self._critical_object
        return CriticalObject(max(0.0, found.clearance_m - self._driven_m), found.label, found.id)

    def geofence_distance_m(self) -> float | None:
        """Distance along the swept field that stays inside the geofence; None: pose unknown; below 0: outside now."""
        if self._geofence is None:
            return math.inf
        if self._geofence_distance_m is None or self._geofence_distance_m < 0.0:
            return self._geofence_distance_m
        return max(0.0, self._geofence_distance_m - self._driven_m)

    def wall_distance_m(self) -> float:
        """Distance along the swept field to known walls and posts in docking; infinite elsewhere."""
        return max(0.0, self._wall_distance_m - self._driven_m)

    def obstacle_class(self, odom: Odometry | None, tracks: Tracks | None) -> ObstacleClass:
        """Class of the track at the triggering points, ditch at the edge of a negative obstacle, else the class of the
        critical object."""
        points = None if self._clearance is None else self._clearance.triggering_points_base_m
        if points is not None and len(points) and odom is not None and tracks is not None:
            points_odom = to_frame(planar_pose(odom.T_odom_base), points[:, :2])
            found = class_at(points_odom, tracks)
            if found is not ObstacleClass.UNKNOWN:
                return found
            if is_near(self.sources.holes_odom_m, points_odom, HIT_TO_TRACK_M).any():
                return ObstacleClass.DITCH
        return self._critical_object.label

    @property
    def _driven_m(self) -> float:
        return self.pose_history.driven_m - self._updated_at_m

    def _set_footprint(self, fold: float | None) -> bool:
        """Selects the footprint at this fold position; returns whether it changed."""
        footprint = self._footprints.at(fold)
        if footprint is self._footprint or self._hitch_angle is not None:
            return False
        self._footprint = footprint
        self.sources.set_footprint(footprint)
        return True

    def _follow_hitch(self, odom: Odometry) -> None:
        """Sets the bounds of the hitch angle of a trailed implement, which does not fold."""
        if self._hitch_angle is not None:
            self._hitch_angle.add(planar_pose(odom.T_odom_base))
            self._footprint = replace(self._footprints.working, hitch_rad=self._hitch_angle.bounds_rad)
            self.sources.set_footprint(self._footprint)

    def _select_field(self, position: PathPosition | None, pose_map: Float64 | None) -> None:
        """Selects the docking field: on a path section to or from a bay, at the shed, in transport width."""
        is_transport = self._footprint is self._footprints.transport
        is_dock_section = position is not None and section_type_at(position) is PathSectionType.DOCK
        structure, near_m = self._known_structure, self._open.docking.shed_distance_m
        is_at_shed = structure is not None and pose_map is not None and structure.is_near(pose_map, near_m)
        self.is_docking = is_transport and is_dock_section and is_at_shed
        self._config = self._docked if self.is_docking else self._open

    def lay_field(
        self, odom: Odometry, position: PathPosition | None, pose_map: Float64 | None, direction: int, speed_mps: float,
        braking: Braking, allowance_m: float,
    ) -> SweptField:  # fmt: skip
        config = self._config.field
        is_along = position is not None and position.path.direction == direction
        return sweep_field(
            position if is_along else None,
            pose_map,
            odom.curvature_radpm,
            direction,
            look_ahead_m(speed_mps, braking, config, allowance_m),
            arc_length_m(speed_mps, braking, config),
            self._footprint,
            config,
        )

    def _update_lidars(
        self, inputs: MonitorInputs, odom: Odometry, swept_field: SweptField, new: list[LidarSource],
        is_new_footprint: bool,
    ) -> None:  # fmt: skip
        path_id = inputs.path.path_id if inputs.path is not None else -1
        key = (path_id, swept_field.main.direction, swept_field.is_planned)
        is_new_field, self._key = key != self._key or is_new_footprint, key
        box = box_of(swept_field, self._config.field.ground_patch_m)
        self.sources.update_lidars(inputs.source_data, new, self.pose_history, odom, box, is_new_field)

    def _update_distances(
        self, inputs: MonitorInputs, odom: Odometry, swept_field: SweptField, pose_map: Float64 | None,
        speed_mps: float, braking: Braking,
    ) -> None:  # fmt: skip
        pose_odom = planar_pose(odom.T_odom_base)
        self._updated_at_m = self.pose_history.driven_m
        sigma_m = self._config.docking.sigmas * position_sigma_m(inputs.map_pose)
        is_known = self._known_structure_filter(pose_odom, pose_map, sigma_m)
        self._clearance = self.sources.clearance(swept_field, pose_odom, speed_mps, is_known, inputs.tracks)
        self._follow_departure(swept_field, pose_odom, is_known, odom.stamp_ns)
        is_standing = speed_mps <= self._config.modes.standstill_mps
        predicted_s = horizon_s(stopping_time(speed_mps, braking), self._config.tracked)
        near = tracks_near(swept_field.main, inputs.tracks, pose_odom, predicted_s, self._config.tracked, is_known)
        if self._geofence is not None and pose_map is not None:
            posts_odom_m = to_frame(pose_odom, from_frame(pose_map, self._geofence.posts))
            near = without_posts(near, posts_odom_m, self._config.tracked)
        is_inside = self._inside_filter(pose_odom, pose_map)
        hits = self.sources.lidar_hits_odom_m if is_standing and not self.is_docking else NOWHERE
        machine = MachineMotion(swept_field.main, pose_odom, speed_mps, odom.yaw_rate_radps, braking)
        unfolded = self._unfolded if self._footprint is self._footprints.transport else None
        self.bystanders.note_returns(hits, is_inside, machine, unfolded, odom.stamp_ns)
        cover = self._cover(inputs.tracks, odom)
        self.standing_bodies.update(near, swept_field.main, pose_odom, braking, odom.stamp_ns, is_inside, cover)
        self._critical_object = min(
            self._nearest_object(near, inputs.tracks, odom, machine, predicted_s, is_standing),
            self.standing_bodies.hidden, key=lambda one: one.clearance_m,
        )  # fmt: skip
        self._geofence_distance_m = self._distance_inside_m(pose_map, swept_field, speed_mps, braking)
        self._update_wall_distance(pose_map, swept_field, sigma_m)

    def _cover(self, tracks: Tracks | None, odom: Odometry) -> Cover | None:
        height_m = self.sources.cover_m
        all_tracks = () if tracks is None else tracks.tracks
        return Cover(height_m, all_tracks, invert(odom.T_odom_base)) if height_m > 0.0 else None

    def _nearest_object(
        self, near: list[tuple[Track, bool]], tracks: Tracks | None, odom: Odometry, machine: MachineMotion,
        predicted_s: float, is_standing: bool,
    ) -> CriticalObject:  # fmt: skip
        """Critical object of all tracks: a bystander who comes towards the machine, else the nearest one ahead."""
        tracked, area, pose_odom = self._config.tracked, machine.area, machine.pose_odom
        side = odom.curvature_radpm, area.direction, tracked.self_filter_m
        ahead = [one for one in near if is_ahead(one[0], self._footprint, pose_odom, *side)]
        ids = {track.id for track, _ in ahead}
        moving = [track for track, moves in near if moves]
        stamp_ns = 0 if tracks is None else tracks.stamp_ns
        broad = [track for track, moves in near if not moves and is_broad_mover(track, stamp_ns, tracked)]
        beside = [track for track in (*moving, *broad) if track.id not in ids]
        self.bystanders.note_close(moving, machine, odom.stamp_ns)
        in_front = [track for track in moving if track.id in ids]
        around = [track for track, _ in near] if is_standing else []
        self.bystanders.update(beside, in_front, around, tracks, machine, predicted_s)
        return self.bystanders.coming or nearest_critical_object(area, ahead, pose_odom, predicted_s, tracked)

    def _follow_departure(
        self, swept_field: SweptField, pose_odom: Float64, is_known: KnownStructureFilter | None, now_ns: int
    ) -> None:
        is_blocked = self._clearance is not None and math.isfinite(self._clearance.main_m)
        if not is_blocked and not self.departure.is_kept:
            return
        hits = self.sources.lidar_hits_odom_m
        if is_known is not None and len(hits):
            hits = hits[~is_known(hits)]
        self.departure.update(thin(hits, THIN_M), swept_field.main, pose_odom, now_ns)

    def _inside_filter(
        self, pose_odom: Float64, pose_map: Float64 | None
    ) -> Callable[[Float64], np.ndarray] | None:  # fmt: skip
        """Tests points in odom for the geofence; None: not known."""
        geofence = self._geofence
        if geofence is None or pose_map is None:
            return None
        return lambda points_odom: geofence.contains(to_frame(pose_map, from_frame(pose_odom, points_odom)))

    def _known_structure_filter(
        self, pose_odom: Float64, pose_map: Float64 | None, sigma_m: float
    ) -> KnownStructureFilter | None:
        """Tests points in odom for known structure; None outside docking."""
        structure = self._known_structure
        if not self.is_docking or structure is None or pose_map is None:
            return None
        tolerance_m = self._config.docking.known_structure_tolerance_m + sigma_m

        def is_known(points_odom: Float64) -> np.ndarray:
            points_map = to_frame(pose_map, from_frame(pose_odom, points_odom))
            return np.asarray(structure.distance_m(points_map) <= tolerance_m)

        return is_known

    def _update_wall_distance(self, pose_map: Float64 | None, swept_field: SweptField, sigma_m: float) -> None:
        self._wall_distance_m, self.is_under_roof = math.inf, False
        structure = self._known_structure
        if structure is None or pose_map is None or not structure.is_near(pose_map, self._open.docking.shed_distance_m):
            return
        self.is_under_roof = structure.is_under_roof(swept_field.main, pose_map)
        if self.is_docking:
            clearance_m = self._config.docking.clearance_m + sigma_m
            areas = [area for area in (swept_field.main, swept_field.arc) if area is not None]
            self._wall_distance_m = min(structure.clear_distance_m(area, pose_map, clearance_m) for area in areas)

    def _distance_inside_m(
        self, pose_map: Float64 | None, swept_field: SweptField, speed_mps: float, braking: Braking
    ) -> float | None:
        if self._geofence is None or pose_map is None:
            return None
        stopping_m = min(MAX_GEOFENCE_REACH_M, stopping_distance(speed_mps, braking))
        reach_m = stopping_m + self._config.limits.geofence_margin_m + 1.0
        inside_m = math.inf
        for area in (swept_field.main,) if swept_field.arc is None else (swept_field.main, swept_field.arc):
            near = area.up_to(reach_m)
            if self._geofence.contains_box(near.box.in_parent(pose_map)):
                continue
            points, distances = outline_points(near, GEOFENCE_SPACING_M)
            spacing_m = max(GEOFENCE_SPACING_M, area.step_m)
            found_m = distance_inside_m(self._geofence, to_frame(pose_map, points), distances, spacing_m)
            inside_m = min(inside_m, found_m)
        return inside_m


def pose_in_map(map_pose: MapPose | None, odom: Odometry) -> Float64 | None:
    """Pose (3,) of base in map now: last correction and newest odometry; None before initialization."""
    if map_pose is None or not map_pose.is_initialized:
        return None
    return planar_pose(map_pose.T_map_odom @ odom.T_odom_base)


def stamps_of(inputs: MonitorInputs) -> tuple[int, ...]:
    """Stamps of the inputs, other than sensor data, on which an update depends."""
    parts = (inputs.map_pose, inputs.path, inputs.tracks)
    return tuple(-1 if part is None else part.stamp_ns for part in parts)


def class_at(points_odom: Float64, tracks: Tracks) -> ObstacleClass:
    """Class of the confirmed track nearest to the points (N, 2), at most `HIT_TO_TRACK_M` from the circle about it."""
    best, label = HIT_TO_TRACK_M, ObstacleClass.UNKNOWN
    for track in tracks.tracks:
        if not track.is_confirmed:
            continue
        away = np.hypot(*(points_odom - track.p_odom_m[:2]).T) - 0.5 * math.hypot(*track.size_m[:2])
        if float(away.min()) < best:
            best, label = float(away.min()), track.label
    return label
