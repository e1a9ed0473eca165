"""Obstacle sources of the raw protective field: lidars, radars and ultrasonic sensors of the machine.

lidar scan ───────► hits (confirmed returns) ─┐
radar cycle ──────► hits (confirmed echoes) ──┼─► clearance along the swept field
ultrasonic range ─► arc of the echo ──────────┘
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from configs.vehicle import Sensors, kmh
from geometry.arrays import Float64
from geometry.pose2 import from_frame
from messages.motion import Odometry
from messages.perception import SensorHealth, Tracks
from messages.sensors import LidarScan, RadarScan, UltrasonicRange
from messages.topics import TOPICS
from safety.config import SafetyConfig
from safety.monitors.lidar_agreement import LidarAgreement
from safety.monitors.sensors import SensorFailure
from safety.pose_history import PoseHistory
from safety.sources.detection_range import limit_by_health
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.sources.multiple_evaluation import thin
from safety.sources.near_field import ground_lidars
from safety.sources.radar import RadarSource
from safety.sources.ultrasonic import UltrasonicSource, is_confirmed_by_track
from safety.zones.footprint import Box, Footprint
from safety.zones.protective_field import FREE, Clearance, SweptField, box_of, clearance_to
from safety.zones.tracked_obstacles import KnownStructureFilter

THIN_M = 0.05  # grid of the thinning: greatest error of a clearance


@dataclass(frozen=True)
class SourceData:
    """Measurements by sensor name; None: missing or stale."""

    scans: Mapping[str, LidarScan | None]
    radars: Mapping[str, RadarScan | None]
    echoes: Mapping[str, UltrasonicRange | None]


class ObstacleSources:
    """One source per lidar, radar and ultrasonic sensor; `consented_m` as for lidars."""

    def __init__(self, sensors: Sensors, footprint: Footprint, config: SafetyConfig, consented_m: float = 0.0) -> None:
        field, ultrasonic = config.field, config.ultrasonic
        height = (field.min_height_m, footprint.height_m + field.overhead_margin_m)
        ground = ground_lidars(sensors.lidar, footprint)
        self.lidars = tuple(
            LidarSource(name, lidar, footprint, config, consented_m, name in ground)
            for name, lidar in sensors.lidar.items()
        )
        self.radars = tuple(RadarSource(n, one, height, field.mask_m, config.radar) for n, one in sensors.radar.items())
        self.ultrasonics = tuple(UltrasonicSource(n, one, ultrasonic) for n, one in sensors.ultrasonic.items())
        self._agreement = LidarAgreement(config.lidar_agreement)
        self._config, self._footprint = config, footprint

    def set_footprint(self, footprint: Footprint) -> None:
        """Sets the footprint of the self mask."""
        self._footprint = footprint
        for source in self.lidars:
            source.footprint = footprint

    def set_hitch(self, hitch: float) -> None:
        """Sets the hitch position, which moves the lidars on the implement."""
        for source in self.lidars:
            source.hitch = hitch

    @property
    def lidar_hits_odom_m(self) -> Float64:
        """Confirmed returns (N, 2) of all lidars."""
        return np.concatenate([np.empty((0, 2)), *(source.hits_odom_m[:, :2] for source in self.lidars)])

    @property
    def holes_odom_m(self) -> Float64:
        """Confirmed edges (H, 2) of negative obstacles of all lidars."""
        return np.concatenate([np.empty((0, 2)), *(source.holes_odom_m for source in self.lidars)])

    @property
    def vegetation_m(self) -> float:
        """Height of the plants around the machine, the greatest that any lidar measures; 0 without."""
        return max((source.vegetation_m for source in self.lidars), default=0.0)

    @property
    def cover_m(self) -> float:
        """Height up to which plants or rough ground hide who lies, the greatest that any lidar measures; 0 without."""
        rough_m = max((source.floor_m for source in self.lidars), default=0.0)
        return max(self.vegetation_m, rough_m if rough_m > self._config.field.min_height_m else 0.0)

    def forget_held(self) -> None:
        """Drops the hits that are held in blind zones, and those of sensors without new data."""
        for lidar in self.lidars:
            lidar.forget_held()
        for radar in self.radars:
            radar.forget()
        for ultrasonic in self.ultrasonics:
            ultrasonic.forget()

    def update(self, data: SourceData, pose_history: PoseHistory, odom: Odometry) -> bool:
        """Processes new radar and ultrasonic data; returns whether any of it has, or had before, a confirmed echo."""
        is_relevant = False
        for radar in self.radars:
            scan = data.radars.get(radar.name)
            if scan is not None and is_newer(scan.stamp_ns, radar.stamp_ns):
                count_before = len(radar.hits)
                radar.update(scan, pose_history.pose_at(scan.stamp_ns), odom, self._footprint)
                is_relevant |= count_before + len(radar.hits) > 0
        for source in self.ultrasonics:
            echo = data.echoes.get(source.name)
            if echo is not None and is_newer(echo.stamp_ns, source.stamp_ns):
                count_before = len(source.echo_arc_odom_m)
                source.update(echo, pose_history.pose_at(echo.stamp_ns), odom)
                is_relevant |= count_before + len(source.echo_arc_odom_m) > 0
        return is_relevant

    def with_new_scan(self, data: SourceData) -> list[LidarSource]:
        """Lidars with a scan newer than the last one processed."""
        scans = {name: scan for name, scan in data.scans.items() if scan is not None}
        return [one for one in self.lidars if one.name in scans and is_newer(scans[one.name].stamp_ns, one.stamp_ns)]

    def update_lidars(
        self, data: SourceData, new: list[LidarSource], pose_history: PoseHistory, odom: Odometry, box: Box,
        is_new_field: bool,
    ) -> None:  # fmt: skip
        """Processes the scans of the lidars in `new`; for a new swept field also the last scans of the others."""
        motion = Motion(odom.speed_mps, odom.yaw_rate_radps)
        for source in self.lidars:
            scan = data.scans[source.name] if source in new else source.scan if is_new_field else None
            if scan is not None:
                others = [one for one in self.lidars if one is not source]
                source.update(scan, pose_history.pose_at(scan.stamp_ns), motion, odom.curvature_radpm, box, others)
        if new:
            self._agreement.update(self.lidars)

    def lidar_failures(self, direction: int) -> tuple[SensorFailure, ...]:
        """Lidars that cover a direction of travel and measure wrongly."""
        return self._agreement.failures(self.lidars, direction)

    def clearance(
        self, swept_field: SweptField, pose_odom: Float64, speed_mps: float, is_known: KnownStructureFilter | None,
        tracks: Tracks | None,
    ) -> Clearance | None:  # fmt: skip
        """Clearance to all confirmed returns and echoes; None before the first lidar scan."""
        if not any(source.stamp_ns is not None for source in self.lidars):
            return None
        found = [self._points_clearance(swept_field, pose_odom, is_known)]
        in_plants = self.vegetation_m > 0.0  # which give echoes themselves: rule `vegetation` asks for a consent
        if speed_mps <= kmh(self._config.ultrasonic.max_speed_kmh) and not in_plants:
            near_m = self._config.ultrasonic.track_match_m
            arcs = [one.echo_arc_odom_m for one in self.ultrasonics if len(one.echo_arc_odom_m)]
            arcs = [arc for arc in arcs if not is_confirmed_by_track(arc, tracks, near_m)]
            found += [self._echo_clearance(arc, swept_field, pose_odom, is_known) for arc in arcs]
        hits = np.concatenate([one.triggering_points_base_m for one in found])
        return Clearance(min(one.main_m for one in found), min(one.arc_m for one in found), hits)

    def _points_clearance(
        self, swept_field: SweptField, pose_odom: Float64, is_known: KnownStructureFilter | None
    ) -> Clearance:
        """Clearance to lidar and radar hits; points out of reach are dropped first, by entire cells of the thinning."""
        near = reachable_box(swept_field)
        points = np.concatenate([np.empty((0, 3)), *(source.hits_odom_m for source in self.lidars)])
        points = thin(points.compress(near.contains(from_frame(pose_odom, points[:, :2])), axis=0), THIN_M)
        echoes = np.concatenate([np.empty((0, 4)), *(radar.hits for radar in self.radars)])
        aside = np.concatenate([np.zeros(len(points)), -self._config.radar.bearing_sigmas * echoes[:, 3]])
        hits = np.concatenate([points, echoes[:, :3]])
        if is_known is not None and len(hits):
            is_unknown = ~is_known(hits[:, :2])
            hits, aside = hits[is_unknown], aside[is_unknown]
        return clearance_to(swept_field, hits, pose_odom, aside)

    def _echo_clearance(
        self, arc_odom_m: Float64, swept_field: SweptField, pose_odom: Float64, is_known: KnownStructureFilter | None
    ) -> Clearance:
        """Clearance to an echo arc (7, 2) if enough of it lies in the swept field and none of it on known structure."""
        if not reachable_box(swept_field).contains(from_frame(pose_odom, arc_odom_m)).any():
            return FREE
        if is_known is not None and is_known(arc_odom_m).any():
            return FREE
        arc = np.column_stack([arc_odom_m, np.full(len(arc_odom_m), self._config.field.min_height_m)])
        found = clearance_to(swept_field, arc, pose_odom)
        is_enough = len(found.triggering_points_base_m) >= self._config.ultrasonic.min_arc_ratio * len(arc)
        return found if is_enough else FREE

    def detection_range_m(
        self, now_ns: int, direction: int, health: Mapping[str, SensorHealth | None]
    ) -> dict[str, float]:
        """Detection range by topic of each lidar that covers a direction and is not stale, limited by its health."""
        half_rad = math.radians(self._config.detection_range.half_cone_deg)
        oldest_ns = now_ns - round(TOPICS["lidar"].max_age_s * 1e9)
        return {
            f"lidar/{one.name}": limit_by_health(
                one.detection_range_m(direction), health.get(f"lidar_{one.name}"), direction, half_rad
            )
            for one in self.lidars
            if one.covers(direction) and one.stamp_ns is not None and one.stamp_ns >= oldest_ns
        }


def reachable_box(swept_field: SweptField) -> Box:
    """Box of base about the swept field, enlarged by one step and two cells of the thinning."""
    main, arc = swept_field.main, swept_field.arc
    step_m = main.step_m if arc is None else max(main.step_m, arc.step_m)
    return box_of(swept_field, step_m + 2.0 * THIN_M)


def is_newer(stamp_ns: int, last_ns: int | None) -> bool:
    """Whether a measurement is newer than the last one processed (None: none yet)."""
    return last_ns is None or stamp_ns > last_ns
