"""Topic table: type, period, maximum age, and whether a topic is logged.

A topic is a kind, or a kind and an instance name: `lidar/front` is of kind `lidar`.
"""

import math
from dataclasses import dataclass

from messages import command, faults, motion, perception, plan, sensors, timing, truth
from messages.errors import WiringError
from messages.message import Message

NEVER_STALE_S = math.inf


@dataclass(frozen=True)
class TopicSpec:
    """Properties of the topics of a kind; `period_s` 0: on event; ages count from the stamp of the message."""

    type: type[Message]
    period_s: float
    max_age_s: float
    is_logged: bool = True


TOPICS: dict[str, TopicSpec] = {
    "lidar": TopicSpec(sensors.LidarScan, 0.1, 0.3),
    "camera": TopicSpec(sensors.CameraImage, 0.5, 1.5),
    "radar": TopicSpec(sensors.RadarScan, 0.05, 0.25),
    "ultrasonic": TopicSpec(sensors.UltrasonicRange, 0.1, 0.35),
    "imu": TopicSpec(sensors.ImuSample, 0.01, 0.1),
    "gnss": TopicSpec(sensors.GnssFix, 0.1, 0.5),
    "wheel": TopicSpec(sensors.WheelSample, 0.02, 0.1),
    "uwb": TopicSpec(sensors.UwbRanges, 0.1, 0.5),
    "can": TopicSpec(command.CanFrames, 0.0, NEVER_STALE_S),
    "machine": TopicSpec(command.MachineState, 0.02, 0.15),
    "odom": TopicSpec(motion.Odometry, 0.02, 0.1),
    "map_pose": TopicSpec(motion.MapPose, 0.1, 0.4),
    "lidar_odometry": TopicSpec(motion.LidarOdometry, 0.1, 0.5),
    "lidar_localization": TopicSpec(motion.LidarLocalization, 0.2, 0.5),
    "ground": TopicSpec(perception.LidarGround, 0.1, 0.4, is_logged=False),
    "obstacles": TopicSpec(perception.Obstacles, 0.1, 0.35),
    "tracks": TopicSpec(perception.Tracks, 0.1, 0.35),
    "health": TopicSpec(perception.SensorHealth, 0.1, 0.35),
    "path": TopicSpec(plan.Path, 0.0, NEVER_STALE_S),
    "mission": TopicSpec(plan.MissionStatus, 0.1, 0.3),
    "control_command": TopicSpec(command.ControlCommand, 0.02, 0.1),
    "safe_command": TopicSpec(command.SafeCommand, 0.02, 0.1),
    "supervisor": TopicSpec(command.SupervisorState, 0.1, 0.3),
    "order": TopicSpec(command.SignedOrder, 0.0, NEVER_STALE_S),
    "order_status": TopicSpec(command.OrderStatus, 0.1, 0.3),
    "operator_command": TopicSpec(command.OperatorCommand, 0.0, NEVER_STALE_S),
    "fault": TopicSpec(faults.Fault, 0.0, NEVER_STALE_S),
    "node_timing": TopicSpec(timing.NodeTiming, 1.0, NEVER_STALE_S),
    "truth_machine": TopicSpec(truth.TrueMachine, 0.05, NEVER_STALE_S),
    "truth_objects": TopicSpec(truth.TrueObjects, 0.1, NEVER_STALE_S),
    "truth_shapes": TopicSpec(truth.TrueShapes, 0.1, NEVER_STALE_S),
}


def spec_of(topic: str) -> TopicSpec:
    """Row of the table for a topic; raises WiringError for an unknown kind."""
    row = TOPICS.get(topic.partition("/")[0])
    if row is None:
        raise WiringError(f"topic {topic!r}: its kind is not in messages/topics.py (known: {', '.join(TOPICS)})")
    return row
