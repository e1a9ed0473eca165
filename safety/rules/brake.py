"""Brake: effective when applied, and proof tested before the first metre."""

from configs.strict import Config
from configs.vehicle import Seconds, kmh
from messages.command import RuleResult
from safety.monitors.brake_test import Phase
from safety.rules.results import emergency, limit, no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

WEAK, TEST, TEST_FAILED = "brake.weak", "brake.test", "brake.test_failed"


class BrakeLimits(Config):
    """How long the deceleration may stay below its share of the demand."""

    debounce_s: Seconds


def evaluate(situation: Situation, limits: BrakeLimits) -> RuleResult:
    """Emergency stop with all brakes on too little deceleration or a failed proof test; slow until it has passed."""
    if situation.vehicle.brake_ineffective_s > limits.debounce_s:
        return emergency(WEAK, "the machine does not slow as commanded")
    phase = situation.brake_test
    if phase is Phase.FAILED:
        return emergency(TEST_FAILED, "the brake did not stop the machine within its stopping distance")
    if phase is Phase.BRAKE:
        return limit(TEST, 0.0, "brake proof test")
    if phase is Phase.CREEP:
        return limit(TEST, kmh(situation.config.brake_test.speed_kmh), "slow until the brake is proof tested")
    return no_objection(WEAK)


RULE = Rule(
    order=80,
    clauses=("BD-5.2.5b",),
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=BrakeLimits,
    config_keys=("limits.min_brake_ratio", "brake_test.speed_kmh", "brake_test.brake_kmh"),
    texts_zh={WEAK: "制动力不足", TEST: "制动测试", TEST_FAILED: "制动测试未通过"},
)
