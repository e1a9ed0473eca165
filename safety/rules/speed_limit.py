"""Speed limit of machine and configuration; at the shed that of docking."""

from configs.vehicle import kmh
from messages.command import RuleResult
from safety.rules.results import limit
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE, DOCKING = "speed_limit", "speed_limit.docking"


def evaluate(situation: Situation) -> RuleResult:
    """Always returns a limit."""
    if situation.is_docking:
        return limit(DOCKING, kmh(situation.config.docking.speed_kmh), "maximum speed at the shed")
    return limit(CODE, situation.max_speed_mps, "maximum speed")


RULE = Rule(
    order=180,
    effect=Effect.LIMIT,
    evaluate=evaluate,
    config_keys=("limits.speed_kmh", "docking.speed_kmh"),
    texts_zh={CODE: "最高车速", DOCKING: "机库最高车速"},
)
