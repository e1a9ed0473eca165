"""Sensor loss: without a radar, camera or ultrasonic sensor the machine slows to what the other sensors detect."""

from typing import Annotated

from pydantic import AfterValidator

from configs.sensor_kinds import MONITORED_KINDS, require_kinds
from configs.strict import Config
from configs.vehicle import kmh
from messages.command import RuleResult
from safety.config import Metres
from safety.rules.results import limit, no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed

CODE = "sensor_loss"


class SensorLossLimits(Config):
    """Detection range of the remaining sensors when one kind is lost in the direction of travel."""

    without_m: Annotated[dict[str, Metres], AfterValidator(lambda ranges: require_kinds(ranges, MONITORED_KINDS))]


def evaluate(situation: Situation, limits: SensorLossLimits) -> RuleResult:
    """The loss that leaves the shortest range; none while a topic timed out, which is then the only cause reported."""
    config = situation.config
    if not situation.sensor_failures or situation.timed_out_topics:
        return no_objection(CODE)
    worst = min(situation.sensor_failures, key=lambda failure: limits.without_m[failure.kind])
    range_m = limits.without_m[worst.kind]
    by_factor = highest_speed(range_m / config.field.slow_range_factor, situation.braking, 0.0)
    speed = min(by_factor, highest_speed(range_m, situation.braking, situation.allowance_m))
    if situation.is_docking and worst.kind == "ultrasonic":
        speed = min(speed, kmh(config.docking.ultrasonic_lost_kmh))
    return limit(worst.code, speed, worst.text)


RULE = Rule(
    order=160,
    clauses=("BD-5.2.4",),
    effect=Effect.DETECTION | Effect.ADVISORY,
    evaluate=evaluate,
    limits=SensorLossLimits,
    config_keys=("field.slow_range_factor", "docking.ultrasonic_lost_kmh"),
    texts_zh={"*.silent": "{} 无消息", "*.frozen": "{} 数据重复不变", "*.blind": "{} 被遮挡"},
)
