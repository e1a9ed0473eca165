"""The highest speed of machine and configuration."""

from messages.command import RuleResult
from safety.rules.verdict import limit
from safety.situation import Situation


def judge(situation: Situation) -> RuleResult:
    """Always said."""
    return limit("speed.limit", situation.max_speed_mps, "highest speed")
