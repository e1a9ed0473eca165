"""All sensors of the raw channel together: what they say stands in the way."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from configs.vehicle import Sensors, kmh
from messages.message import Float64
from messages.motion import Odometry
from messages.perception import SensorHealth, Tracks
from messages.sensors import LidarScan, RadarScan, UltrasonicRange
from messages.topics import TOPICS
from safety.config import SafetyConfig
from safety.pose_history import Trail, from_frame
from safety.sources.detection_range import shrink
from safety.sources.ground_filter import Box, Motion
from safety.sources.lidar import Eye
from safety.sources.multiple_evaluation import thinned
from safety.sources.radar import RadarEye
from safety.sources.ultrasonic import Ear, is_answered
from safety.zones.footprint import Shape
from safety.zones.protective_field import FREE, Gap, Way, box_of, gap_in
from safety.zones.tracked_obstacles import Explained

THIN_M = 0.05  # what a gap may be too long by


@dataclass(frozen=True)
class Measurements:
    """What came from each sensor by name; None is missing or stale."""

    scans: Mapping[str, LidarScan | None]
    radars: Mapping[str, RadarScan | None]
    echoes: Mapping[str, UltrasonicRange | None]


class Senses:
    """One eye a lidar or radar, one ear an ultrasonic sensor."""

    def __init__(self, sensors: Sensors, shape: Shape, config: SafetyConfig) -> None:
        field = config.field
        height = (field.lowest_m, shape.height_m + field.over_height_m)
        self.eyes = tuple(Eye(name, lidar, shape, config) for name, lidar in sensors.lidar.items())
        self.radars = tuple(RadarEye(n, one, height, field.mask_m, config.radar) for n, one in sensors.radar.items())
        self.ears = tuple(Ear(name, one, config.ultrasonic) for name, one in sensors.ultrasonic.items())
        self._config, self._shape = config, shape

    def wear(self, shape: Shape) -> None:
        """The outline that masks the machine itself from now on."""
        self._shape = shape
        for eye in self.eyes:
            eye.shape = shape

    def hear(self, came: Measurements, trail: Trail, odom: Odometry) -> bool:
        """Take what came from radars and ultrasonic sensors; whether any of it is or was in the way of something."""
        is_news = False
        for radar in self.radars:
            scan = came.radars.get(radar.name)
            if scan is not None and is_newer(scan.stamp_ns, radar.stamp_ns):
                had = len(radar.hits)
                radar.take(scan, trail.pose_at(scan.stamp_ns), odom, self._shape)
                is_news |= had + len(radar.hits) > 0
        for ear in self.ears:
            echo = came.echoes.get(ear.name)
            if echo is not None and is_newer(echo.stamp_ns, ear.stamp_ns):
                had = len(ear.arc_odom_m)
                ear.take(echo, trail.pose_at(echo.stamp_ns), odom)
                is_news |= had + len(ear.arc_odom_m) > 0
        return is_news

    def fresh(self, came: Measurements) -> list[Eye]:
        """The lidars with a scan that has not been taken yet; one from before the last is not taken."""
        scans = {name: scan for name, scan in came.scans.items() if scan is not None}
        return [eye for eye in self.eyes if eye.name in scans and is_newer(scans[eye.name].stamp_ns, eye.stamp_ns)]

    def scan(
        self, came: Measurements, fresh: list[Eye], trail: Trail, odom: Odometry, box: Box, is_other_way: bool
    ) -> None:
        """Take fresh scans, and for another way the last ones once more."""
        motion = Motion(odom.speed_mps, odom.yaw_rate_radps)
        for eye in self.eyes:
            scan = came.scans[eye.name] if eye in fresh else eye.scan if is_other_way else None
            if scan is not None:
                eye.take(scan, trail.pose_at(scan.stamp_ns), motion, odom.curvature_radpm, box)

    def gap(
        self, way: Way, pose_odom: Float64, speed_mps: float, is_explained: Explained | None, tracks: Tracks | None
    ) -> Gap | None:
        """The gaps to all that any of them has confirmed; None before any lidar has looked."""
        if not any(eye.stamp_ns is not None for eye in self.eyes):
            return None
        gaps = [self._points_gap(way, pose_odom, is_explained)]
        if speed_mps <= kmh(self._config.ultrasonic.most_kmh):
            near_m = self._config.ultrasonic.answer_m
            heard = [e for e in self.ears if len(e.arc_odom_m) and not is_answered(e.arc_odom_m, tracks, near_m)]
            gaps += [self._arc_gap(ear, way, pose_odom, is_explained) for ear in heard]
        hits = np.concatenate([gap.triggering_points_base_m for gap in gaps])
        return Gap(min(gap.main_m for gap in gaps), min(gap.arc_m for gap in gaps), hits)

    def _points_gap(self, way: Way, pose_odom: Float64, is_explained: Explained | None) -> Gap:
        """Lidars and radars; what cannot be touched is left out first, with whole squares of the thinning kept."""
        near = touched_box(way)
        hits = np.concatenate([np.empty((0, 3)), *(eye.hits_odom_m for eye in self.eyes)])
        seen = thinned(hits.compress(near.holds(from_frame(pose_odom, hits[:, :2])), axis=0), THIN_M)
        echoes = np.concatenate([np.empty((0, 4)), *(radar.hits for radar in self.radars)])
        aside = np.concatenate([np.zeros(len(seen)), -self._config.radar.aside_sigmas * echoes[:, 3]])
        hits = np.concatenate([seen, echoes[:, :3]])
        if is_explained is not None and len(hits):
            left = ~is_explained(hits[:, :2])
            hits, aside = hits[left], aside[left]
        return gap_in(way, hits, pose_odom, aside)

    def _arc_gap(self, ear: Ear, way: Way, pose_odom: Float64, is_explained: Explained | None) -> Gap:
        """An arc counts when enough of it lies in the way, and no surveyed wall could have answered."""
        if not touched_box(way).holds(from_frame(pose_odom, ear.arc_odom_m)).any():
            return FREE
        if is_explained is not None and is_explained(ear.arc_odom_m).any():
            return FREE
        arc = np.column_stack([ear.arc_odom_m, np.full(len(ear.arc_odom_m), self._config.field.lowest_m)])
        gap = gap_in(way, arc, pose_odom)
        return gap if len(gap.triggering_points_base_m) >= self._config.ultrasonic.arc_share * len(arc) else FREE

    def proven_m(self, now_ns: int, direction: int, health: Mapping[str, SensorHealth | None]) -> dict[str, float]:
        """The proven range of each lidar that looks in a direction and is not silent, shrunk by its own health."""
        half_rad = math.radians(self._config.proven.look_deg)
        oldest_ns = now_ns - round(TOPICS["lidar"].max_age_s * 1e9)
        return {
            f"lidar/{eye.name}": shrink(eye.proven_m(direction), health.get(f"lidar_{eye.name}"), direction, half_rad)
            for eye in self.eyes
            if eye.looks(direction) and eye.stamp_ns is not None and eye.stamp_ns >= oldest_ns
        }


def touched_box(way: Way) -> Box:
    """The area of base that can be touched at all, wider by more than a square of the thinning."""
    step_m = way.main.step_m if way.arc is None else max(way.main.step_m, way.arc.step_m)
    return box_of(way, step_m + 2.0 * THIN_M)


def is_newer(stamp_ns: int, taken_ns: int | None) -> bool:
    """Whether a measurement is newer than the last that was taken."""
    return taken_ns is None or stamp_ns > taken_ns
