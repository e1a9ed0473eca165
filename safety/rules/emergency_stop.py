"""Emergency stop: the button, or the vehicle's own brake pedal (BD-5.8.1b); latched by the mode machine."""

from messages.command import RuleResult
from safety.rules.results import emergency, no_objection
from safety.rules.situation import Situation


def evaluate(situation: Situation) -> RuleResult:
    """Full stop on button or pedal; a machine that says nothing is the watchdog's matter."""
    machine = situation.machine
    if machine is None:
        return no_objection("emergency_stop.button")
    if machine.is_emergency_button_pressed:
        return emergency("emergency_stop.button", "emergency stop pressed")
    if not machine.brake_pedal < situation.config.limits.brake_pedal:
        return emergency("emergency_stop.pedal", f"brake pedal at {machine.brake_pedal:.0%}")
    return no_objection("emergency_stop.button")
