"""The one table of topics: type, period, greatest age and whether it is logged.

A topic is its kind, or its kind, a slash and the name of an instance: `lidar/front` is of kind `lidar`.
"""

import math
from dataclasses import dataclass

from messages import command, faults, motion, perception, plan, sensors, truth
from messages.errors import WiringError
from messages.message import Message

NEVER_STALE_S = math.inf


@dataclass(frozen=True)
class Kind:
    """What holds for all topics of a kind; `period_s` 0 means on event; ages count from the message's stamp."""

    type: type[Message]
    period_s: float
    max_age_s: float
    is_logged: bool = True


KINDS: dict[str, Kind] = {
    "lidar": Kind(sensors.LidarScan, 0.1, 0.35),
    "camera": Kind(sensors.CameraImage, 0.5, 1.5),
    "radar": Kind(sensors.RadarScan, 0.05, 0.25),
    "ultrasonic": Kind(sensors.UltrasonicRange, 0.1, 0.35),
    "imu": Kind(sensors.ImuSample, 0.01, 0.1),
    "gnss": Kind(sensors.GnssFix, 0.1, 0.5),
    "wheel": Kind(sensors.WheelSample, 0.02, 0.1),
    "uwb": Kind(sensors.UwbRanges, 0.1, 0.5),
    "can": Kind(command.CanFrames, 0.0, NEVER_STALE_S),
    "machine": Kind(command.MachineState, 0.02, 0.15),
    "odom": Kind(motion.Odometry, 0.02, 0.1),
    "map_pose": Kind(motion.MapPose, 0.1, 0.4),
    "lidar_motion": Kind(motion.LidarMotion, 0.1, 0.5),
    "lidar_pose": Kind(motion.LidarPose, 0.2, 0.5),
    "ground": Kind(perception.LidarGround, 0.1, 0.4, is_logged=False),
    "obstacles": Kind(perception.Obstacles, 0.1, 0.4),
    "tracks": Kind(perception.Tracks, 0.1, 0.4),
    "health": Kind(perception.SensorHealth, 0.1, 0.4),
    "path": Kind(plan.Path, 0.0, NEVER_STALE_S),
    "mission": Kind(plan.MissionStatus, 0.2, 0.4),
    "wish": Kind(command.Wish, 0.02, 0.1),
    "safe_command": Kind(command.SafeCommand, 0.02, 0.1),
    "supervisor": Kind(command.SupervisorState, 0.1, 0.3),
    "order": Kind(command.OperatorOrder, 0.0, NEVER_STALE_S),
    "fault": Kind(faults.Fault, 0.0, NEVER_STALE_S),
    "truth_machine": Kind(truth.TrueMachine, 0.05, NEVER_STALE_S),
    "truth_objects": Kind(truth.TrueObjects, 0.1, NEVER_STALE_S),
}


def kind_of(topic: str) -> Kind:
    """The table's row for a topic; raises WiringError for a topic that has none."""
    row = KINDS.get(topic.partition("/")[0])
    if row is None:
        raise WiringError(f"topic {topic!r}: its kind is not in messages/topics.py (known: {', '.join(KINDS)})")
    return row
