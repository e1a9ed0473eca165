"""Which of the last echoes of one sensor are an object: it repeats, where a neighbour's pulse or a gust does not.

range                     x  stray                an object's echoes lie within what it and the machine can
  |    o                                          move from one to the next; three of the last five do.
  |       o     o  o  <- told
  |_____________________ time
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Ultrasonic
from messages.message import Float64
from messages.motion import Odometry


class EchoConfig(Config):
    """What makes echoes one object, and what follows when it comes too near to be heard."""

    window: int = Field(ge=1, le=50)
    window_s: float = Field(gt=0.0, le=5.0)
    repeats: int = Field(ge=1, le=50)
    gate_m: float = Field(gt=0.0, le=2.0)
    fastest_mps: float = Field(gt=0.0, le=20.0, description="of an object along the axis")
    dead_margin_m: float = Field(ge=0.0, le=2.0, description="an object last heard so near the dead zone may be in it")
    hold_s: float = Field(ge=0.0, le=60.0, description="for which it is then taken to be there")
    release_m: float = Field(gt=0.0, le=5.0, description="withdrawn so far, the dead zone has left it behind")


@dataclass(frozen=True)
class Echo:
    """One measurement; `range_m` is NaN when nothing came back; `travel_m` is how far the sensor had come along its
    axis by then."""

    stamp_ns: int
    range_m: float
    travel_m: float


def is_range(range_m: float, sensor: Ultrasonic) -> bool:
    """Whether a number can be what the sensor says: NaN, or up to its reach and a little more."""
    return math.isnan(range_m) or 0.0 <= range_m <= 1.1 * sensor.range_m[1]


def axis_speed(odom: Odometry, T_base_sensor: Float64) -> float:
    """Speed of the sensor over ground along its axis; the lever arm turns with the machine."""
    x, y = T_base_sensor[0, 3], T_base_sensor[1, 3]
    vx, vy = odom.speed_mps - odom.yaw_rate_radps * y, odom.lateral_mps + odom.yaw_rate_radps * x
    return float(T_base_sensor[0, 0] * vx + T_base_sensor[1, 0] * vy)


def repeated_range(echoes: Sequence[Echo], config: EchoConfig) -> float | None:
    """Range now of the object that the last echoes (oldest first) agree on, or None.

    Each echo, from the newest back, is tried: those that lie within reach of it speak for it. What is told is the
    nearer of that echo and the median of its party, all brought to the time of the newest.
    """
    if not echoes:
        return None
    last = echoes[-1]
    recent = [e for e in echoes[-config.window :] if last.stamp_ns - e.stamp_ns <= round(config.window_s * 1e9)]
    heard = [e for e in recent if not math.isnan(e.range_m)]
    now_m = np.array([e.range_m - (last.travel_m - e.travel_m) for e in heard])
    time_s = np.array([e.stamp_ns * 1e-9 for e in heard])
    for k in range(len(heard) - 1, -1, -1):
        party = np.abs(now_m - now_m[k]) <= config.gate_m + config.fastest_mps * np.abs(time_s - time_s[k])
        if party.sum() >= config.repeats:
            return max(0.0, float(min(now_m[k], np.median(now_m[party]))))
    return None


@dataclass(frozen=True)
class Near:
    """The object last told, in case it slips into the dead zone."""

    stamp_ns: int
    range_m: float
    travel_m: float


def held_range(near: Near | None, now: Echo, sensor: Ultrasonic, config: EchoConfig) -> float | None:
    """Range of an object that may sit in the dead zone: it was last heard at its edge, not long ago, and the machine
    has not withdrawn since."""
    if near is None or near.range_m > sensor.range_m[0] + config.dead_margin_m:
        return None
    came_m = now.travel_m - near.travel_m
    if now.stamp_ns - near.stamp_ns > round(config.hold_s * 1e9) or came_m <= -config.release_m:
        return None
    return min(max(near.range_m - came_m, 0.0), sensor.range_m[0])
