"""The highest speed of machine and configuration, and in and before the shed that of docking."""

from configs.vehicle import kmh
from messages.command import RuleResult
from safety.rules.results import limit
from safety.rules.situation import Situation


def evaluate(situation: Situation) -> RuleResult:
    """Always said."""
    if situation.is_docking:
        return limit("speed_limit.docking", kmh(situation.config.docking.speed_kmh), "highest speed at the shed")
    return limit("speed_limit", situation.max_speed_mps, "highest speed")
