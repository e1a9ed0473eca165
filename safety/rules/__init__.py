"""The rules, one file each: `(situation) -> RuleResult`; the most restrictive wins, of equals the first here."""

from collections.abc import Callable

from messages.command import RuleResult
from safety.rules import (
    brake,
    clock_step,
    detection_range,
    driver_override,
    emergency_stop,
    geofence,
    implement_fold,
    localization,
    message_timeout,
    protective_field,
    reported_fault,
    sensor_loss,
    speed_limit,
    steering,
    supply_voltage,
    tilt,
    tracked_obstacle,
    wall_clearance,
)
from safety.rules.situation import Situation

Rule = Callable[[Situation], RuleResult]

RULES: dict[str, Rule] = {
    "emergency_stop": emergency_stop.judge,
    "driver_override": driver_override.judge,
    "clock_step": clock_step.judge,
    "reported_fault": reported_fault.judge,
    "message_timeout": message_timeout.judge,
    "supply_voltage": supply_voltage.judge,
    "steering": steering.judge,
    "brake": brake.judge,
    "localization": localization.judge,
    "tilt": tilt.judge,
    "geofence": geofence.judge,
    "implement_fold": implement_fold.judge,
    "protective_field": protective_field.judge,
    "tracked_obstacle": tracked_obstacle.judge,
    "detection_range": detection_range.judge,
    "sensor_loss": sensor_loss.judge,
    "wall_clearance": wall_clearance.judge,
    "speed_limit": speed_limit.judge,
}
BLOCKING_RULES = frozenset(
    {"protective_field", "tracked_obstacle", "detection_range", "sensor_loss"}
)  # to stand for one is an obstacle stop
OBSTACLE_RULES = frozenset({"protective_field", "tracked_obstacle"})  # what an ablation switches off
