"""Radar: detections at a removed object are deleted."""

import math
from dataclasses import replace

import numpy as np

from configs.vehicle import Radar
from geometry.transforms import apply
from messages.sensors import RadarScan
from validation.obstacle_stop.boxes import Box
from validation.sensors import MARGIN_M


def field_of_view(radar: Radar) -> tuple[float, float]:
    """Half the field of view (rad) and the range (m)."""
    return math.radians(radar.field_of_view_deg) / 2.0, radar.range_m[1]


def remove_object(scan: RadarScan, box: Box, radar: Radar) -> RadarScan:
    """Cycle without the detections at the box, compared horizontally (radar elevation is inaccurate)."""
    level = scan.range_m * np.cos(scan.elevation_rad)
    p = np.column_stack([level * np.cos(scan.azimuth_rad), level * np.sin(scan.azimuth_rad), np.zeros(len(level))])
    at = np.asarray(apply(radar.mount.T_base_sensor, p)[:, :2], np.float64)
    keep = box.distance_m(at) > MARGIN_M
    columns = ("range_m", "azimuth_rad", "elevation_rad", "doppler_mps", "rcs_dbsm")
    return replace(scan, **{name: getattr(scan, name)[keep] for name in columns})
