"""Inputs of the supervisor: topics of the configured sensors, message ages and failed sensors."""

import math

import numpy as np

from configs.sensor_kinds import SENSOR_KINDS
from configs.vehicle import Sensors
from messages.command import ControlCommand, MachineState
from messages.message import Message
from messages.motion import MapPose, Odometry
from messages.node import Inbox, Latest, Read
from messages.perception import Obstacles, SensorHealth, Tracks
from messages.plan import MissionStatus, Path
from messages.sensors import LidarScan, RadarScan, UltrasonicRange
from messages.topics import spec_of
from safety.collision_monitor import CollisionMonitor, MonitorInputs
from safety.config import SafetyConfig
from safety.monitors.sensors import MonitoredSensor, SensorFailure, failure_of, monitored_sensors
from safety.monitors.watchdog import TopicAge, age_of
from safety.obstacle_sources import SourceData
from safety.pose_history import valid_map_pose, valid_odometry
from safety.zones.footprint import fold_of, hitch_of


class SupervisorInputs:
    """Topics of the sensors that a machine carries; `idle` as in `Supervisor`.

    A camera's pictures are not read: they say nothing here that its health does not.
    """

    def __init__(self, sensors: Sensors, idle: frozenset[str], config: SafetyConfig) -> None:
        self._sensors, self._config = sensors, config
        self._monitored = monitored_sensors(sensors, idle)
        own = ("imu",) * (sensors.imu is not None) + ("wheel",) * (sensors.wheels is not None)
        self._health = {f"lidar_{name}": f"health/lidar_{name}" for name in sensors.segmented_lidars}
        topics = [(f"lidar/{name}", self._health.get(f"lidar_{name}")) for name in sensors.lidar]
        lidars = [topic for scan_and_health in topics for topic in scan_and_health if topic is not None]
        watched = ("machine", *own, *lidars, "odom", "map_pose", "tracks", "control_command", "mission", "order_status")
        self._watched: dict[str, type[Message]] = {topic: spec_of(topic).type for topic in watched}
        self._health |= {one.label: one.health_topic for one in self._monitored}

    @property
    def reads(self) -> dict[str, Read]:
        """All of it."""
        raw = (one.topic for one in self._monitored if SENSOR_KINDS[one.kind].is_raw_source)
        obstacles = (one.obstacles_topic for one in self._monitored)
        return {topic: Latest() for topic in (*self._watched, "path", *raw, *obstacles, *self._health.values())}

    def read(self, inbox: Inbox, machine: MachineState | None) -> MonitorInputs:
        """The newest messages; missing, stale or not finite ones are None."""
        measurements = SourceData(
            {name: inbox.latest(f"lidar/{name}", LidarScan) for name in self._sensors.lidar},
            {one.name: inbox.latest(one.topic, RadarScan) for one in self._of("radar")},
            {one.name: inbox.latest(one.topic, UltrasonicRange) for one in self._of("ultrasonic")},
        )
        mission = inbox.latest("mission", MissionStatus)
        return MonitorInputs(
            valid_odometry(inbox.latest("odom", Odometry)),
            valid_map_pose(inbox.latest("map_pose", MapPose)),
            inbox.latest("control_command", ControlCommand),
            valid_path(inbox.latest("path", Path)),
            inbox.latest("tracks", Tracks),
            fold_of(machine, self._config.limits.max_group_age_s),
            hitch_of(machine, self._config.limits.max_group_age_s),
            measurements,
            {name: inbox.latest(topic, SensorHealth) for name, topic in self._health.items()},
            (0.0, 0.0) if mission is None else (mission.shift_x_m, mission.shift_y_m),
        )

    def _of(self, kind: str) -> list[MonitoredSensor]:
        return [one for one in self._monitored if one.kind == kind]

    def ages(self, now_ns: int, inbox: Inbox, collision_monitor: CollisionMonitor, direction: int) -> list[TopicAge]:
        """Ages of all that driving in this direction cannot do without."""
        away = [source.name for source in collision_monitor.sources.lidars if not source.covers(direction)]
        idle = {topic for name in away for topic in (f"lidar/{name}", f"health/lidar_{name}")}
        ages = []
        for topic, kind in self._watched.items():
            if topic not in idle:
                last = inbox.last(topic, kind)
                ages.append(age_of(topic, None if last is None else last.stamp_ns, now_ns))
        return ages

    def sensor_failures(
        self, now_ns: int, inbox: Inbox, inputs: MonitorInputs, collision_monitor: CollisionMonitor, direction: int
    ) -> tuple[SensorFailure, ...]:
        """Radars, cameras and ultrasonic sensors that cover the direction of travel but give no usable output."""
        silent = {f"radar_{name}" for name, scan in inputs.source_data.radars.items() if scan is None}
        silent |= {f"ultrasonic_{name}" for name, echo in inputs.source_data.echoes.items() if echo is None}
        frozen = {f"radar_{radar.name}" for radar in collision_monitor.sources.radars if radar.is_frozen}
        half_rad = math.radians(self._config.detection_range.half_cone_deg)
        found = (
            failure_of(
                one, one.label not in silent, one.label in frozen, self._is_told(one, now_ns, inbox),
                inputs.health[one.label], direction, half_rad,
            )
            for one in self._monitored
        )  # fmt: skip
        return tuple(failure for failure in found if failure is not None)

    def _is_told(self, one: MonitoredSensor, now_ns: int, inbox: Inbox) -> bool:
        last = inbox.last(one.obstacles_topic, Obstacles)
        return last is not None and abs(now_ns - last.stamp_ns) <= one.max_output_age_s * 1e9


def valid_path(path: Path | None) -> Path | None:
    """The path if all its poses are finite, else None."""
    if path is None:
        return None
    is_finite = all(np.isfinite(values).all() for values in (path.s_m, path.heading_rad, path.p_map_m))
    return path if is_finite else None
