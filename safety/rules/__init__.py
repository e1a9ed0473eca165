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
    "emergency_stop": emergency_stop.evaluate,
    "driver_override": driver_override.evaluate,
    "clock_step": clock_step.evaluate,
    "reported_fault": reported_fault.evaluate,
    "message_timeout": message_timeout.evaluate,
    "supply_voltage": supply_voltage.evaluate,
    "steering": steering.evaluate,
    "brake": brake.evaluate,
    "localization": localization.evaluate,
    "tilt": tilt.evaluate,
    "geofence": geofence.evaluate,
    "implement_fold": implement_fold.evaluate,
    "protective_field": protective_field.evaluate,
    "tracked_obstacle": tracked_obstacle.evaluate,
    "detection_range": detection_range.evaluate,
    "sensor_loss": sensor_loss.evaluate,
    "wall_clearance": wall_clearance.evaluate,
    "speed_limit": speed_limit.evaluate,
}
BLOCKING_RULES = frozenset(
    {"protective_field", "tracked_obstacle", "detection_range", "sensor_loss"}
)  # to stand for one is an obstacle stop
OBSTACLE_RULES = frozenset({"protective_field", "tracked_obstacle"})  # what an ablation switches off
