"""Confirmation of ultrasonic echoes: those of an object repeat, cross-talk and wind noise do not.

range                     x  stray                echoes of an object differ by no more than object and machine move
  |    o                                          from one to the next; three of the last five must agree.
  |       o     o  o  <- confirmed
  |_____________________ time
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Ultrasonic
from geometry.arrays import Float64
from messages.motion import Odometry


class EchoConfig(Config):
    """Agreement of echoes, and holding of an object that enters the dead zone."""

    window: int = Field(ge=1, le=50)
    window_s: float = Field(gt=0.0, le=5.0)
    min_agreeing: int = Field(ge=1, le=50)
    gate_m: float = Field(gt=0.0, le=2.0)
    max_target_speed_mps: float = Field(gt=0.0, le=20.0, description="of an object along the axis")
    dead_zone_margin_m: float = Field(
        ge=0.0, le=2.0, description="distance to the dead zone within which an object may have entered it"
    )
    hold_s: float = Field(ge=0.0, le=60.0, description="time for which it is then assumed in the dead zone")
    release_m: float = Field(gt=0.0, le=5.0, description="machine motion away after which the dead zone is clear")


@dataclass(frozen=True)
class Echo:
    """One measurement; `range_m` is NaN without an echo; `travel_m` is the travel of the sensor along its axis."""

    stamp_ns: int
    range_m: float
    travel_m: float


def is_valid_range(range_m: float, sensor: Ultrasonic) -> bool:
    """Whether a range is NaN or within 110 % of the sensor's range."""
    return math.isnan(range_m) or 0.0 <= range_m <= 1.1 * sensor.range_m[1]


def axis_speed(odom: Odometry, T_base_sensor: Float64) -> float:
    """Speed of the sensor over ground along its axis, with the lever arm of the yaw rate."""
    x, y = T_base_sensor[0, 3], T_base_sensor[1, 3]
    vx, vy = odom.speed_mps - odom.yaw_rate_radps * y, odom.lateral_mps + odom.yaw_rate_radps * x
    return float(T_base_sensor[0, 0] * vx + T_base_sensor[1, 0] * vy)


def repeated_range(echoes: Sequence[Echo], config: EchoConfig) -> float | None:
    """Present range of the object that the last echoes (oldest first) agree on, or None.

    For each echo from the newest back, counts the echoes that agree with it. The result is the smaller of that echo
    and the median of the agreeing ones, all propagated to the time of the newest.
    """
    if not echoes:
        return None
    last = echoes[-1]
    recent = [e for e in echoes[-config.window :] if last.stamp_ns - e.stamp_ns <= round(config.window_s * 1e9)]
    valid = [e for e in recent if not math.isnan(e.range_m)]
    now_m = np.array([e.range_m - (last.travel_m - e.travel_m) for e in valid])
    time_s = np.array([e.stamp_ns * 1e-9 for e in valid])
    for k in range(len(valid) - 1, -1, -1):
        agrees = np.abs(now_m - now_m[k]) <= config.gate_m + config.max_target_speed_mps * np.abs(time_s - time_s[k])
        if agrees.sum() >= config.min_agreeing:
            return max(0.0, float(min(now_m[k], np.median(now_m[agrees]))))
    return None


@dataclass(frozen=True)
class LastObject:
    """The object last confirmed, kept in case it enters the dead zone."""

    stamp_ns: int
    range_m: float
    travel_m: float


def held_range(last: LastObject | None, now: Echo, sensor: Ultrasonic, config: EchoConfig) -> float | None:
    """Range of an object that may be in the dead zone, or None: last confirmed at its edge within `hold_s`, and the
    machine has not moved away since."""
    if last is None or last.range_m > sensor.range_m[0] + config.dead_zone_margin_m:
        return None
    advance_m = now.travel_m - last.travel_m
    if now.stamp_ns - last.stamp_ns > round(config.hold_s * 1e9) or advance_m <= -config.release_m:
        return None
    return min(max(last.range_m - advance_m, 0.0), sensor.range_m[0])
