"""Roll and pitch limits: a slope, or a wheel in a ditch."""

import math

from configs.strict import Config
from configs.vehicle import Degrees
from messages.command import RuleResult
from safety.pose_history import tilt_of
from safety.rules.results import no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE, ROLL, PITCH = "tilt", "tilt.roll", "tilt.pitch"


class TiltLimits(Config):
    """Highest roll and pitch to either side."""

    roll_deg: Degrees
    pitch_deg: Degrees


def evaluate(situation: Situation, limits: TiltLimits) -> RuleResult:
    """Stop above either limit, and on NaN."""
    odom = situation.inputs.odom
    if odom is None:
        return no_objection(CODE)
    roll_deg, pitch_deg = (abs(math.degrees(angle)) for angle in tilt_of(odom.T_odom_base))
    if not roll_deg <= limits.roll_deg:
        return stop(ROLL, f"roll {roll_deg:.1f}°, at most {limits.roll_deg:g}°")
    if not pitch_deg <= limits.pitch_deg:
        return stop(PITCH, f"pitch {pitch_deg:.1f}°, at most {limits.pitch_deg:g}°")
    return no_objection(CODE)


RULE = Rule(
    order=100,
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=TiltLimits,
    texts_zh={ROLL: "横向倾角过大", PITCH: "纵向倾角过大"},
)
