"""The pose must be good enough for the work, and fixes must come (BD-5.2.6a, BD-5.3d: 120 s is the outer bound)."""

from messages.command import RuleResult
from messages.motion import PositionSource
from safety.rules.results import advisory, limit, no_objection, stop
from safety.rules.situation import Situation

CODE = "localization"


def evaluate(situation: Situation) -> RuleResult:
    """Alarm at once without fixes, slow above one protection level, stop above the other or after the time.

    Under the roof there is no sky: the place rests on UWB, and must be known better.
    """
    pose, config = situation.map_pose, situation.config.localization
    if pose is None:
        return no_objection(CODE)
    if not pose.is_initialized or pose.source is PositionSource.NONE:
        return stop("localization.none", "no position yet")
    if not pose.gnss_age_s <= config.gnss_stop_s and pose.source is not PositionSource.UWB:
        return stop("localization.gnss_age", f"no fix for {pose.gnss_age_s:.0f} s")
    docking = situation.config.docking
    if situation.is_under_roof and not pose.uwb_age_s <= docking.max_uwb_age_s:
        return stop("localization.uwb_lost", f"no UWB range for {pose.uwb_age_s:.1f} s in the shed")
    most_m = docking.protection_stop_m if situation.is_under_roof else config.protection_stop_m
    if not pose.protection_level_m <= most_m:
        return stop("localization.protection", f"position only within {pose.protection_level_m:.2f} m")
    if pose.protection_level_m > config.protection_slow_m:
        return limit(CODE, config.slow_mps, f"position only within {pose.protection_level_m:.2f} m")
    if pose.gnss_age_s > config.gnss_alarm_s and not situation.is_under_roof:
        return advisory("localization.gnss_lost", f"no fix for {pose.gnss_age_s:.1f} s")
    return no_objection(CODE)
