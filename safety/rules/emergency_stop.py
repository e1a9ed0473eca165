"""Emergency stop: the button or the vehicle's own brake pedal; latched by the mode machine."""

from pydantic import Field

from configs.strict import Config
from messages.command import RuleResult
from safety.rules.results import emergency, no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

BUTTON, PEDAL = "emergency_stop.button", "emergency_stop.pedal"


class EmergencyStopLimits(Config):
    """When the brake pedal counts as pressed."""

    brake_pedal: float = Field(gt=0.0, lt=1.0, description="position, 0 released to 1 fully pressed")


def evaluate(situation: Situation, limits: EmergencyStopLimits) -> RuleResult:
    """Emergency stop on button or pedal; without a machine state `message_timeout` stops."""
    machine = situation.machine
    if machine is None:
        return no_objection(BUTTON)
    if machine.is_emergency_button_pressed:
        return emergency(BUTTON, "emergency stop pressed")
    if not machine.brake_pedal < limits.brake_pedal:
        return emergency(PEDAL, f"brake pedal at {machine.brake_pedal:.0%}")
    return no_objection(BUTTON)


RULE = Rule(
    order=10,
    clauses=("BD-5.8.1b",),
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=EmergencyStopLimits,
    texts_zh={BUTTON: "急停按钮已按下", PEDAL: "制动踏板已踩下"},
)
