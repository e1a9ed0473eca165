"""Overspeed: the machine is faster than it was commanded to be."""

from configs.strict import Config
from configs.vehicle import Seconds
from messages.command import RuleResult
from safety.rules.results import emergency, no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE, CONTRADICTED = "overspeed", "speeds.contradicted"


class OverspeedLimits(Config):
    """How long it may last."""

    debounce_s: Seconds


def evaluate(situation: Situation, limits: OverspeedLimits) -> RuleResult:
    """Emergency stop: drive or bus no longer obey the supervisor, or one of the two speeds is wrong."""
    if situation.vehicle.overspeed_s <= limits.debounce_s:
        return no_objection(CODE)
    contradiction = contradiction_of(situation)
    if contradiction:
        return emergency(CONTRADICTED, contradiction)
    return emergency(CODE, "the machine is faster than commanded")


def contradiction_of(situation: Situation) -> str:
    """The speeds of bus and odometry where at most one of them can be right, else ""."""
    machine, odom = situation.machine, situation.inputs.odom
    if machine is None or odom is None:
        return ""
    sent_mps, measured_mps = abs(machine.speed_mps), abs(odom.speed_mps)
    if abs(sent_mps - measured_mps) <= 0.5 * situation.config.limits.overspeed_mps:
        return ""
    return f"{sent_mps:.1f} m/s on the bus, {measured_mps:.1f} m/s by odometry"


RULE = Rule(
    order=85,
    clauses=("BD-5.2.5a",),
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=OverspeedLimits,
    config_keys=("limits.overspeed_mps", "limits.min_slowing_mps2"),
    texts_zh={CODE: "车速高于指令", CONTRADICTED: "总线车速与里程计车速不一致"},
)
