"""Vegetation: plants that hide whoever lies there are worked only with the consent of a named person."""

from messages.command import RuleResult
from safety.rules.results import advisory, limit, no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE, CONSENTED = "vegetation", "vegetation.consented"


def evaluate(situation: Situation) -> RuleResult:
    """Stop in plants without consent, or higher than it; with consent report what they hide."""
    height_m, config, consent = situation.vegetation_m, situation.config.vegetation, situation.consent
    if height_m == 0.0:
        return no_objection(CODE)
    plants = f"plants of {height_m:.2f} m hide persons who lie"
    if consent is None:
        return limit(CODE, 0.0, f"{plants}; the mission has no consent to that")
    if height_m > consent.vegetation_m + config.uncertainty_m:
        return limit(CODE, 0.0, f"{plants}; consent up to {consent.vegetation_m:.2f} m by {consent.by}")
    return advisory(CONSENTED, f"{plants}; consent by {consent.by}")


RULE = Rule(
    order=155,
    clauses=("BD-5.2.4",),
    effect=Effect.DETECTION,
    evaluate=evaluate,
    config_keys=("vegetation.min_height_m", "vegetation.margin_m", "vegetation.min_cells"),
    texts_zh={CODE: "植物过高，可能遮挡躺卧人员，作业任务未经同意", CONSENTED: "植物可能遮挡躺卧人员，已有人同意"},
)
