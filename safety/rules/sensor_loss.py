"""A lost radar, camera or ultrasonic sensor leaves less proven free: the machine slows to what the others prove."""

from configs.vehicle import kmh
from messages.command import RuleResult
from safety.rules.results import limit, no_objection
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed


def evaluate(situation: Situation) -> RuleResult:
    """The sensor that is missed most; while what all need is silent, that is the cause and is told alone."""
    config = situation.config
    if not situation.sensor_failures or situation.timed_out_topics:
        return no_objection("sensor_loss")
    worst = min(situation.sensor_failures, key=lambda failure: config.sensor_loss.without_m(failure.kind))
    range_m = config.sensor_loss.without_m(worst.kind)
    twice = highest_speed(range_m / config.field.slow_range_factor, situation.braking, 0.0)
    speed = min(twice, highest_speed(range_m, situation.braking, situation.allowance_m))
    if situation.is_docking and worst.kind == "ultrasonic":
        speed = min(speed, kmh(config.docking.ultrasonic_lost_kmh))
    return limit(worst.code, speed, worst.text)
