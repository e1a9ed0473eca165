"""Drive: the machine follows its commanded speed."""

from configs.strict import Config
from configs.vehicle import Seconds
from messages.command import RuleResult
from safety.rules.overspeed import CONTRADICTED, contradiction_of
from safety.rules.results import no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "drive.not_following"


class DriveLimits(Config):
    """How long the machine may stand or creep against its command."""

    debounce_s: Seconds


def evaluate(situation: Situation, limits: DriveLimits) -> RuleResult:
    """Stop: the implement is too heavy here, the wheels dig in, or the drive is out of order or obeys a wrong speed."""
    if situation.vehicle.drive_ineffective_s <= limits.debounce_s:
        return no_objection(CODE)
    contradiction = contradiction_of(situation)
    if contradiction:
        return stop(CONTRADICTED, contradiction)
    return stop(CODE, "the machine does not move as commanded")


RULE = Rule(
    order=75,
    clauses=("BD-5.2.5a",),
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=DriveLimits,
    config_keys=("limits.min_drive_ratio", "limits.overspeed_mps"),
    texts_zh={CODE: "车辆未按指令行驶", CONTRADICTED: "总线车速与里程计车速不一致"},
)
