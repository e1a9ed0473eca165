"""Steering: ready, and following its command."""

from configs.strict import Config
from configs.vehicle import Seconds
from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE, NOT_READY, NOT_FOLLOWING = "steering", "steering.not_ready", "steering.not_following"


class SteeringLimits(Config):
    """How long a deviation may last."""

    debounce_s: Seconds


def evaluate(situation: Situation, limits: SteeringLimits) -> RuleResult:
    """Stop when it fails while moving or does not follow; stand while it is not ready."""
    if situation.machine is None:
        return no_objection(CODE)
    if situation.vehicle.steering_deviation_s > limits.debounce_s:
        return stop(NOT_FOLLOWING, "steering does not follow its command")
    if situation.machine.is_steering_ready:
        return no_objection(CODE)
    if situation.vehicle.steering_unavailable_s > limits.debounce_s:
        return stop(NOT_READY, f"steering not ready (exit code {situation.machine.steering_exit_code})")
    return limit(NOT_READY, 0.0, "steering not ready")


RULE = Rule(
    order=70,
    clauses=("BD-5.5.2d", "BD-5.5.2a"),
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=SteeringLimits,
    config_keys=("limits.curvature_error_radpm", "limits.curvature_delay_s", "limits.curvature_memory_s"),
    texts_zh={NOT_READY: "转向系统未就绪", NOT_FOLLOWING: "转向不跟随指令"},
)
