"""Localization: the pose is accurate enough for the work, and GNSS fixes arrive (BD-5.2.6a, BD-5.3d)."""

import math

from pydantic import Field

from configs.strict import Config
from configs.vehicle import Seconds, kmh
from messages.command import RuleResult
from messages.motion import PositionSource
from safety.config import Metres
from safety.rules.results import advisory, limit, no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE, NONE = "localization", "localization.none"
GNSS_AGE, GNSS_LOST = "localization.gnss_age", "localization.gnss_lost"
UWB_LOST, PROTECTION = "localization.uwb_lost", "localization.protection"


class LocalizationLimits(Config):
    """Protection levels and ages of fixes at which the machine slows or stops."""

    protection_slow_m: Metres
    protection_stop_m: Metres
    gnss_alarm_s: Seconds
    gnss_stop_s: float = Field(gt=0.0, le=120.0, description="BD-5.3d: 120 s at most")


def evaluate(situation: Situation, limits: LocalizationLimits) -> RuleResult:
    """Advisory at once without fixes, stop after a time without them; slow above one protection level, speed 0 above
    the other, and a fault when it stays above.

    Under the roof GNSS is not received: the position comes from UWB, as on leaving it, and the protection level is
    that of docking.
    """
    pose, docking = situation.inputs.map_pose, situation.config.docking
    if pose is None:
        return no_objection(CODE)
    if not pose.is_initialized or pose.source is PositionSource.NONE:
        return stop(NONE, "no position yet")
    if not pose.gnss_age_s <= limits.gnss_stop_s and pose.source is not PositionSource.UWB:
        return stop(GNSS_AGE, _without_fix(pose.gnss_age_s))
    if situation.is_under_roof and not pose.uwb_age_s <= docking.max_uwb_age_s:
        return stop(UWB_LOST, f"no UWB range for {pose.uwb_age_s:.1f} s in the shed")
    stop_m = docking.protection_stop_m if situation.is_under_roof else limits.protection_stop_m
    text = f"position only within {pose.protection_level_m:.2f} m"
    if not pose.protection_level_m <= stop_m:
        is_lasting = not situation.vehicle.lasting_level_m <= stop_m
        return stop(PROTECTION, text) if is_lasting else limit(CODE, 0.0, text)
    if pose.protection_level_m > limits.protection_slow_m:
        reduced_mps = kmh(situation.config.limits.reduced_kmh)
        return limit(CODE, reduced_mps, text)
    is_by_uwb = situation.is_under_roof or pose.source is PositionSource.UWB
    if pose.gnss_age_s > limits.gnss_alarm_s and not is_by_uwb:
        return advisory(GNSS_LOST, _without_fix(pose.gnss_age_s))
    return no_objection(CODE)


def _without_fix(age_s: float) -> str:
    return "no fix yet" if math.isinf(age_s) else f"no fix for {age_s:.1f} s"


RULE = Rule(
    order=90,
    clauses=("BD-5.3d", "BD-5.2.6a"),
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=LocalizationLimits,
    config_keys=(
        "limits.reduced_kmh",
        "limits.protection_alert_s",
        "docking.protection_stop_m",
        "docking.max_uwb_age_s",
    ),
    texts_zh={
        CODE: "定位精度下降，减速",
        NONE: "无定位",
        GNSS_AGE: "GNSS 定位中断超时",
        GNSS_LOST: "GNSS 差分信号中断",
        UWB_LOST: "机库内 UWB 信号中断",
        PROTECTION: "定位精度不足",
    },
)
