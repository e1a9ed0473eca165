"""What is of a thing that a track already stands for: no track of its own begins, or goes on, beside that one.

lidar      a vehicle passed closely is seen in pieces: pieces inside its box are of it
the others they tell less sharply where things are: what may as well be within the box of something that a lidar
           sees is taken for that, unless it moves otherwise or is a body too small for so large a box
"""

import math

import numpy as np
import numpy.typing as npt
from pydantic import Field

from configs.strict import Config
from geometry.jit import kernel
from messages.message import Float64, Int64
from messages.perception import ObstacleClass

VEHICLE = tuple(ObstacleClass).index(ObstacleClass.VEHICLE)
Bools = npt.NDArray[np.bool_]


class PartsConfig(Config):
    """How far, how fast and how much larger something may be to be the same."""

    margin_m: float = Field(ge=0.0, le=2.0, description="about a box")
    gate_sigma: float = Field(gt=0.0, le=10.0, description="of places told by radar, camera and ultrasonic sensors")
    agree_mps: float = Field(gt=0.0, le=5.0, description="between their velocities")
    largest: float = Field(ge=1.0, le=20.0, description="a box against the body that a camera sees in it")


def explained(
    p_m: Float64, S: Float64, velocity_mps: Float64, body_m: Float64, size_m: Float64, is_lidar: Bools, hosts: "Hosts",
    config: PartsConfig,
) -> Bools:  # fmt: skip
    """Whether what is seen (K,) is of what already has a track, (K, H): a piece of a vehicle, or may be the same.

    Only the first two columns of places `p_m` (K, ..) and the first block of their covariances `S` are used;
    `velocity_mps` (K, 2) and `body_m` (K,) are NaN where not known; `is_lidar` (K,) tells which rule applies.
    """
    found = np.empty((len(p_m), len(hosts.row)), np.bool_)
    _explain(
        p_m, S, velocity_mps, body_m, size_m, is_lidar,
        hosts.p_m, hosts.size_m, hosts.cosine, hosts.sine, hosts.velocity_mps, hosts.is_vehicle,
        config.margin_m, config.gate_sigma, config.agree_mps, config.largest, found,
    )  # fmt: skip
    return found


@kernel
def _explain(
    p: Float64, S: Float64, velocity: Float64, body: Float64, size: Float64, is_lidar: Bools,
    hosts_p: Float64, hosts_size: Float64, cosine: Float64, sine: Float64, hosts_velocity: Float64, is_vehicle: Bools,
    margin: float, gate: float, agree: float, largest: float, found: Bools,
) -> None:  # fmt: skip
    for i in range(found.shape[0]):
        a, b, d = S[i, 0, 0], S[i, 0, 1], S[i, 1, 1]
        for j in range(found.shape[1]):
            c, s = cosine[j], sine[j]
            dx, dy = p[i, 0] - hosts_p[j, 0], p[i, 1] - hosts_p[j, 1]
            along, across = abs(c * dx + s * dy), abs(c * dy - s * dx)
            half, broad = 0.5 * hosts_size[j, 0], 0.5 * hosts_size[j, 1]
            if is_lidar[i]:
                inside = along <= half + margin and across <= broad + margin
                found[i, j] = inside and is_vehicle[j] and size[i, 0] < hosts_size[j, 0]
                continue
            # sigmas of the place along and across the box
            u = math.sqrt(max(c * c * a + 2.0 * c * s * b + s * s * d, 0.0))
            v = math.sqrt(max(s * s * a - 2.0 * c * s * b + c * c * d, 0.0))
            inside = along <= half + (margin + gate * u) and across <= broad + (margin + gate * v)
            vx, vy = velocity[i, 0] - hosts_velocity[j, 0], velocity[i, 1] - hosts_velocity[j, 1]
            differs = math.sqrt(vx * vx + vy * vy) > agree or hosts_size[j, 0] > largest * body[i]
            found[i, j] = inside and not differs


def middle_of(middle_m: Float64, place_m: Float64, room_m: Float64, yaw_rad: Float64) -> Float64:
    """Middles (K, 2) moved as little as puts each place (K, 2) within `room_m` (K, 2) about them, along these yaws."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    d, half = place_m - middle_m, np.maximum(room_m, 0.0) / 2
    along, across = c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]
    along, across = along - np.clip(along, -half[:, 0], half[:, 0]), across - np.clip(across, -half[:, 1], half[:, 1])
    return np.asarray(middle_m + np.stack([c * along - s * across, s * along + c * across], axis=1))


class Hosts:
    """Tracks of lidars as boxes, H rows: `row` in the table, place, size, yaw, velocity, and which are vehicles."""

    def __init__(
        self, row: Int64, p_m: Float64, size_m: Float64, yaw_rad: Float64, velocity_mps: Float64, is_vehicle: Bools
    ) -> None:
        self.row, self.p_m, self.size_m = row, p_m, size_m
        self.cosine, self.sine = np.cos(yaw_rad), np.sin(yaw_rad)
        self.velocity_mps, self.is_vehicle = velocity_mps, is_vehicle
