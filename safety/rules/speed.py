"""The highest speed of machine and configuration, and in and before the shed that of docking."""

from configs.vehicle import kmh
from messages.command import RuleResult
from safety.rules.verdict import limit
from safety.situation import Situation


def judge(situation: Situation) -> RuleResult:
    """Always said."""
    if situation.is_docking:
        return limit("speed.dock", kmh(situation.config.docking.speed_kmh), "highest speed at the shed")
    return limit("speed.limit", situation.max_speed_mps, "highest speed")
