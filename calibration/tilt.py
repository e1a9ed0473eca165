"""Mount of a sensor from the upward direction that it measures: roll and pitch change, yaw stays."""

import math

import numpy as np

from configs.vehicle import Mount
from geometry.arrays import Float64
from geometry.transforms import rotation, rpy_of


def levelled_rpy_deg(mount: Mount, up_base: Float64) -> Float64:
    """Roll, pitch and yaw (3,) of a mount for which the measured upward direction (3,) in `base` is that of `base`."""
    up = up_base / np.linalg.norm(up_base)
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    turn = axis if sine < 1e-12 else axis / sine * math.atan2(sine, float(up[2]))
    T = np.eye(4)
    T[:3, :3] = rotation(turn) @ mount.T_base_sensor[:3, :3]
    return np.degrees(rpy_of(T))
