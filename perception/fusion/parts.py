"""What is of a thing that a track already stands for: no track of its own begins, or goes on, beside that one.

lidar      a vehicle passed closely is seen in pieces: pieces inside its box are of it
the others they tell less sharply where things are: what may as well be within the box of something that a lidar
           sees is taken for that, unless it moves otherwise or is a body too small for so large a box
"""

import numpy as np
import numpy.typing as npt
from pydantic import Field

from configs.strict import Config
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


def offsets(p_m: Float64, hosts_m: Float64, yaw_rad: Float64) -> Float64:
    """Places (K, 2) against the middles (H, 2) of boxes with these yaws, along and across them, (K, H, 2)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    d = p_m[:, None, :] - hosts_m
    return np.stack([c * d[..., 0] + s * d[..., 1], c * d[..., 1] - s * d[..., 0]], axis=2)


def spreads(S: Float64, yaw_rad: Float64) -> Float64:
    """Sigma (K, H, 2) of covariances (K, 2, 2) along and across boxes with these yaws (H,)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    a, b, d = S[:, None, 0, 0], S[:, None, 0, 1], S[:, None, 1, 1]
    along, across = c * c * a + 2.0 * c * s * b + s * s * d, s * s * a - 2.0 * c * s * b + c * c * d
    return np.sqrt(np.maximum(np.stack([along, across], axis=2), 0.0))


def is_within(p_m: Float64, hosts_m: Float64, size_m: Float64, yaw_rad: Float64, more_m: Float64 | float) -> Bools:
    """Whether places (K, 2) lie in boxes grown by `more_m` to each side, (K, H)."""
    away = np.abs(offsets(p_m, hosts_m, yaw_rad))
    return np.asarray((away <= 0.5 * size_m[:, :2] + more_m).all(axis=2))


def is_piece(p_m: Float64, length_m: Float64, hosts: "Hosts", config: PartsConfig) -> Bools:
    """Whether lidar clusters (K,) are pieces of vehicles, (K, H)."""
    inside = is_within(p_m, hosts.p_m, hosts.size_m, hosts.yaw_rad, config.margin_m)
    return np.asarray(inside & (length_m[:, None] < hosts.size_m[:, 0]) & hosts.is_vehicle)


def is_same(
    p_m: Float64, S: Float64, velocity_mps: Float64, body_m: Float64, hosts: "Hosts", config: PartsConfig
) -> Bools:
    """Whether what others than lidars tell (K,) may be what a lidar sees, (K, H).

    `S` (K, 2, 2) are the covariances of the places; `velocity_mps` (K, 2) and `body_m` (K,) are NaN where not known.
    """
    more = config.margin_m + config.gate_sigma * spreads(S, hosts.yaw_rad)
    inside = is_within(p_m, hosts.p_m, hosts.size_m, hosts.yaw_rad, more)
    apart = np.linalg.norm(velocity_mps[:, None, :] - hosts.velocity_mps, axis=2)
    return np.asarray(inside & ~(apart > config.agree_mps) & ~(hosts.size_m[:, 0] > config.largest * body_m[:, None]))


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
        self.yaw_rad, self.velocity_mps, self.is_vehicle = yaw_rad, velocity_mps, is_vehicle
