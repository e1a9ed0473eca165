"""Roll and pitch limits: a slope or a wheel in a ditch that the machine must not go on over."""

import math

from messages.command import RuleResult
from safety.pose_history import tilt_of
from safety.rules.results import no_objection, stop
from safety.rules.situation import Situation


def evaluate(situation: Situation) -> RuleResult:
    """Both limits belong to what is allowed."""
    if situation.odom is None:
        return no_objection("tilt")
    limits = situation.config.limits
    roll_deg, pitch_deg = (abs(math.degrees(angle)) for angle in tilt_of(situation.odom.T_odom_base))
    if not roll_deg <= limits.roll_deg:
        return stop("tilt.roll", f"roll {roll_deg:.1f}°, at most {limits.roll_deg:g}°")
    if not pitch_deg <= limits.pitch_deg:
        return stop("tilt.pitch", f"pitch {pitch_deg:.1f}°, at most {limits.pitch_deg:g}°")
    return no_objection("tilt")
