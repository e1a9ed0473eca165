"""Ultrasonic: echoes from a removed object are deleted."""

import math
from dataclasses import replace

import numpy as np

from configs.vehicle import Ultrasonic
from geometry.transforms import apply, invert
from messages.sensors import UltrasonicRange
from validation.obstacle_stop.boxes import Box
from validation.sensors import MARGIN_M


def field_of_view(sensor: Ultrasonic) -> tuple[float, float]:
    """Half the cone (rad) and the range (m)."""
    return math.radians(sensor.cone_deg) / 2.0, sensor.range_m[1]


def remove_object(echo: UltrasonicRange, box: Box, sensor: Ultrasonic) -> UltrasonicRange:
    """Measurement without the echo when the box is in the cone at its distance."""
    p = apply(invert(sensor.mount.T_base_sensor), np.column_stack([box.footprint_m(), np.full(25, box.center_m[2])]))
    away = np.hypot(p[:, 0], p[:, 1])
    is_in_cone = np.abs(np.arctan2(p[:, 1], p[:, 0])) <= 0.5 * math.radians(sensor.cone_deg) + np.arctan2(
        MARGIN_M, away
    )
    nearest, far = (f(away, initial=i, where=is_in_cone) for f, i in ((np.min, np.inf), (np.max, -np.inf)))
    is_mine = nearest - MARGIN_M <= echo.range_m <= far + MARGIN_M
    return replace(echo, range_m=math.nan) if is_mine else echo
