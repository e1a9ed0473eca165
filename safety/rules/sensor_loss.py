"""A lost radar, camera or ultrasonic sensor leaves less proven free: the machine slows to what the others prove."""

from configs.vehicle import kmh
from messages.command import RuleResult
from safety.rules.results import limit, no_objection
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed


def evaluate(situation: Situation) -> RuleResult:
    """The sensor that is missed most; while what all need is silent, that is the cause and is told alone."""
    config = situation.config
    if not situation.lost or situation.silent:
        return no_objection("sensor_loss")
    worst = min(situation.lost, key=lambda lost: config.sensing.without_m(lost.kind))
    range_m = config.sensing.without_m(worst.kind)
    twice = highest_speed(range_m / config.field.slow_range_factor, situation.braking, 0.0)
    speed = min(twice, highest_speed(range_m, situation.braking, situation.allowance_m))
    if situation.is_docking and worst.kind == "ultrasonic":
        speed = min(speed, kmh(config.docking.unheard_kmh))
    return limit(worst.code, speed, worst.text)
