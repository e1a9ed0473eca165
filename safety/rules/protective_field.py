"""Protective field: the machine stops the margin before any raw return in its path."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed, stopping_distance

CODE, NO_SCAN = "protective_field", "protective_field.no_scan"


def evaluate(situation: Situation) -> RuleResult:
    """Slow as both clearances allow; brake at once when one is within the stopping distance."""
    clearance = situation.clearance
    if clearance is None:
        return limit(NO_SCAN, 0.0, "no lidar scan ahead yet")
    nearest_m = min(clearance.main_m, clearance.arc_m)
    if math.isinf(nearest_m):
        return no_objection(CODE)
    if situation.is_moving and stopping_distance(situation.speed_mps, situation.braking) > nearest_m:
        return stop(CODE, f"obstacle {nearest_m:.1f} m ahead, inside the stopping distance")
    main = highest_speed(clearance.main_m, situation.braking, situation.allowance_m)
    arc = highest_speed(clearance.arc_m, situation.braking, situation.config.field.arc_margin_m)
    return limit(CODE, min(main, arc), f"obstacle {nearest_m:.1f} m ahead")


RULE = Rule(
    order=130,
    clauses=("BD-5.2.4", "BD-5.2.5b"),
    effect=Effect.OBSTACLE,
    evaluate=evaluate,
    config_keys=(
        "field.margin_m",
        "field.arc_margin_m",
        "field.lateral_margin_near_m",
        "field.lateral_margin_far_m",
        "field.min_height_m",
        "measured_ground.slope",
        "measured_ground.wheels_tolerance_m",
        "near_field.range_m",
        "near_field.min_height_m",
        "near_field.roughness_factor",
        "near_field.dense_factor",
        "near_field.dense_width_m",
        "negative_obstacle.depth_m",
        "negative_obstacle.beneath_m",
        "negative_obstacle.fall",
        "airborne.dust_range_m",
        "airborne.dust_returns",
        "airborne.clear_m",
        "braking.reaction_s",
        "braking.build_up_s",
        "braking.deceleration_mps2",
    ),
    texts_zh={CODE: "前方有障碍物", NO_SCAN: "尚无前方激光雷达数据"},
)
