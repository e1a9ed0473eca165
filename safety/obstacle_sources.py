"""All sensors of the raw channel together: what they say stands in the way."""

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
from safety.pose_history import PoseHistory
from safety.sources.detection_range import limit_by_health
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.sources.multiple_evaluation import thin
from safety.sources.radar import RadarSource
from safety.sources.ultrasonic import UltrasonicSource, is_confirmed_by_track
from safety.zones.footprint import Box, Footprint
from safety.zones.protective_field import FREE, Clearance, SweptField, box_of, clearance_to
from safety.zones.tracked_obstacles import KnownStructureFilter

THIN_M = 0.05  # what a gap may be too long by


@dataclass(frozen=True)
class SourceData:
    """What came from each sensor by name; None is missing or stale."""

    scans: Mapping[str, LidarScan | None]
    radars: Mapping[str, RadarScan | None]
    echoes: Mapping[str, UltrasonicRange | None]


class ObstacleSources:
    """One eye a lidar or radar, one ear an ultrasonic sensor."""

    def __init__(self, sensors: Sensors, footprint: Footprint, config: SafetyConfig) -> None:
        field = config.field
        height = (field.min_height_m, footprint.height_m + field.overhead_margin_m)
        self.lidars = tuple(LidarSource(name, lidar, footprint, config) for name, lidar in sensors.lidar.items())
        self.radars = tuple(RadarSource(n, one, height, field.mask_m, config.radar) for n, one in sensors.radar.items())
        self.ultrasonics = tuple(
            UltrasonicSource(name, one, config.ultrasonic) for name, one in sensors.ultrasonic.items()
        )
        self._config, self._footprint = config, footprint

    def set_footprint(self, footprint: Footprint) -> None:
        """The outline that masks the machine itself from now on."""
        self._footprint = footprint
        for source in self.lidars:
            source.footprint = footprint

    def update(self, data: SourceData, pose_history: PoseHistory, odom: Odometry) -> bool:
        """Take what came from radars and ultrasonic sensors; whether any of it is or was in the way of something."""
        is_relevant = False
        for radar in self.radars:
            scan = data.radars.get(radar.name)
            if scan is not None and is_newer(scan.stamp_ns, radar.stamp_ns):
                had = len(radar.hits)
                radar.update(scan, pose_history.pose_at(scan.stamp_ns), odom, self._footprint)
                is_relevant |= had + len(radar.hits) > 0
        for source in self.ultrasonics:
            echo = data.echoes.get(source.name)
            if echo is not None and is_newer(echo.stamp_ns, source.stamp_ns):
                had = len(source.echo_arc_odom_m)
                source.update(echo, pose_history.pose_at(echo.stamp_ns), odom)
                is_relevant |= had + len(source.echo_arc_odom_m) > 0
        return is_relevant

    def fresh(self, data: SourceData) -> list[LidarSource]:
        """The lidars with a scan that has not been taken yet; one from before the last is not taken."""
        scans = {name: scan for name, scan in data.scans.items() if scan is not None}
        return [
            source
            for source in self.lidars
            if source.name in scans and is_newer(scans[source.name].stamp_ns, source.stamp_ns)
        ]

    def scan(
        self,
        data: SourceData,
        fresh: list[LidarSource],
        pose_history: PoseHistory,
        odom: Odometry,
        box: Box,
        is_new_field: bool,
    ) -> None:
        """Take fresh scans, and for another way the last ones once more."""
        motion = Motion(odom.speed_mps, odom.yaw_rate_radps)
        for source in self.lidars:
            scan = data.scans[source.name] if source in fresh else source.scan if is_new_field else None
            if scan is not None:
                source.update(scan, pose_history.pose_at(scan.stamp_ns), motion, odom.curvature_radpm, box)

    def clearance(
        self,
        swept_field: SweptField,
        pose_odom: Float64,
        speed_mps: float,
        is_known: KnownStructureFilter | None,
        tracks: Tracks | None,
    ) -> Clearance | None:
        """The gaps to all that any of them has confirmed; None before any lidar has looked."""
        if not any(source.stamp_ns is not None for source in self.lidars):
            return None
        clearances = [self._points_clearance(swept_field, pose_odom, is_known)]
        if speed_mps <= kmh(self._config.ultrasonic.max_speed_kmh):
            near_m = self._config.ultrasonic.track_match_m
            heard = [
                e
                for e in self.ultrasonics
                if len(e.echo_arc_odom_m) and not is_confirmed_by_track(e.echo_arc_odom_m, tracks, near_m)
            ]
            clearances += [self._echo_clearance(source, swept_field, pose_odom, is_known) for source in heard]
        hits = np.concatenate([clearance.triggering_points_base_m for clearance in clearances])
        return Clearance(
            min(clearance.main_m for clearance in clearances), min(clearance.arc_m for clearance in clearances), hits
        )

    def _points_clearance(
        self, swept_field: SweptField, pose_odom: Float64, is_known: KnownStructureFilter | None
    ) -> Clearance:
        """Lidars and radars; what cannot be touched is left out first, with whole squares of the thinning kept."""
        near = reachable_box(swept_field)
        hits = np.concatenate([np.empty((0, 3)), *(source.hits_odom_m for source in self.lidars)])
        inputs = thin(hits.compress(near.holds(from_frame(pose_odom, hits[:, :2])), axis=0), THIN_M)
        echoes = np.concatenate([np.empty((0, 4)), *(radar.hits for radar in self.radars)])
        aside = np.concatenate([np.zeros(len(inputs)), -self._config.radar.bearing_sigmas * echoes[:, 3]])
        hits = np.concatenate([inputs, echoes[:, :3]])
        if is_known is not None and len(hits):
            left = ~is_known(hits[:, :2])
            hits, aside = hits[left], aside[left]
        return clearance_to(swept_field, hits, pose_odom, aside)

    def _echo_clearance(
        self,
        source: UltrasonicSource,
        swept_field: SweptField,
        pose_odom: Float64,
        is_known: KnownStructureFilter | None,
    ) -> Clearance:
        """An arc counts when enough of it lies in the way, and no surveyed wall could have answered."""
        if not reachable_box(swept_field).holds(from_frame(pose_odom, source.echo_arc_odom_m)).any():
            return FREE
        if is_known is not None and is_known(source.echo_arc_odom_m).any():
            return FREE
        arc = np.column_stack(
            [source.echo_arc_odom_m, np.full(len(source.echo_arc_odom_m), self._config.field.min_height_m)]
        )
        clearance = clearance_to(swept_field, arc, pose_odom)
        return (
            clearance
            if len(clearance.triggering_points_base_m) >= self._config.ultrasonic.min_arc_ratio * len(arc)
            else FREE
        )

    def detection_range_m(
        self, now_ns: int, direction: int, health: Mapping[str, SensorHealth | None]
    ) -> dict[str, float]:
        """The proven range of each lidar that looks in a direction and is not silent, shrunk by its own health."""
        half_rad = math.radians(self._config.detection_range.half_cone_deg)
        oldest_ns = now_ns - round(TOPICS["lidar"].max_age_s * 1e9)
        return {
            f"lidar/{source.name}": limit_by_health(
                source.detection_range_m(direction), health.get(f"lidar_{source.name}"), direction, half_rad
            )
            for source in self.lidars
            if source.covers(direction) and source.stamp_ns is not None and source.stamp_ns >= oldest_ns
        }


def reachable_box(swept_field: SweptField) -> Box:
    """The area of base that can be touched at all, wider by more than a square of the thinning."""
    step_m = (
        swept_field.main.step_m if swept_field.arc is None else max(swept_field.main.step_m, swept_field.arc.step_m)
    )
    return box_of(swept_field, step_m + 2.0 * THIN_M)


def is_newer(stamp_ns: int, taken_ns: int | None) -> bool:
    """Whether a measurement is newer than the last that was taken."""
    return taken_ns is None or stamp_ns > taken_ns
