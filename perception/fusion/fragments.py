"""Fragments: detections and tracks that belong to the box of an existing track and get no track of their own.

lidar   a vehicle at close range is detected in pieces: pieces inside its box are fragments, and those within a margin
        about it; but of one that is detected as a whole nothing outside of its box is that has the shape of a person,
        and nothing is that was separated from its cluster
others  their position is less accurate: a detection that may lie within the box of a lidar track is a fragment of it,
        unless its velocity differs or the box is too large for its body
"""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Bool, Float64, Int64
from geometry.jit import kernel


class FragmentsConfig(Config):
    """Limits of position, velocity and size for a fragment."""

    margin_m: float = Field(ge=0.0, le=2.0, description="about a box")
    gate_sigma: float = Field(gt=0.0, le=10.0, description="of positions from radar, camera and ultrasonic sensors")
    agree_mps: float = Field(gt=0.0, le=5.0, description="between their velocities")
    max_size_ratio: float = Field(ge=1.0, le=20.0, description="of a box to the body that a camera detects in it")


def is_fragment(
    p_m: Float64, S: Float64, velocity_mps: Float64, body_length_m: Float64, size_m: Float64, is_lidar: Bool,
    is_person: Bool, is_body: Bool, parents: "ParentTracks",
    config: FragmentsConfig,
) -> Bool:  # fmt: skip
    """Whether each of K detections or tracks is a fragment of each of H parents, (K, H).

    Only the first two columns of the positions `p_m` (K, ..) and the first block of their covariances `S` are used;
    `velocity_mps` (K, 2) and `body_length_m` (K,) are NaN where unknown; `is_lidar` (K,) selects the rule;
    `is_person` (K,): that is the most likely class; `is_body` (K,): it was separated from something larger.
    """
    found = np.empty((len(p_m), len(parents.row)), np.bool_)
    _find_fragments(
        p_m, S, velocity_mps, body_length_m, size_m, is_lidar, is_person, is_body,
        parents.p_m, parents.size_m, parents.cosine, parents.sine, parents.velocity_mps, parents.is_vehicle,
        parents.is_whole,
        config.margin_m, config.gate_sigma, config.agree_mps, config.max_size_ratio, found,
    )  # fmt: skip
    return found


@kernel
def _find_fragments(
    p: Float64, S: Float64, velocity: Float64, body: Float64, size: Float64, is_lidar: Bool, is_person: Bool,
    is_body: Bool, parents_p: Float64, parents_size: Float64, cosine: Float64, sine: Float64, parents_velocity: Float64,
    is_vehicle: Bool, is_whole: Bool,
    margin: float, gate: float, agree: float, max_size_ratio: float, found: Bool,
) -> None:  # fmt: skip
    for i in range(found.shape[0]):
        a, b, d = S[i, 0, 0], S[i, 0, 1], S[i, 1, 1]
        for j in range(found.shape[1]):
            c, s = cosine[j], sine[j]
            dx, dy = p[i, 0] - parents_p[j, 0], p[i, 1] - parents_p[j, 1]
            along, across = abs(c * dx + s * dy), abs(c * dy - s * dx)
            half, broad = 0.5 * parents_size[j, 0], 0.5 * parents_size[j, 1]
            if is_lidar[i]:
                inside = along <= half + margin and across <= broad + margin
                is_beside = along > half or across > broad
                inside = inside and not (is_beside and is_person[i] and is_whole[j]) and not is_body[i]
                found[i, j] = inside and is_vehicle[j] and size[i, 0] < parents_size[j, 0]
                continue
            # sigmas of the position along and across the box
            u = math.sqrt(max(c * c * a + 2.0 * c * s * b + s * s * d, 0.0))
            v = math.sqrt(max(s * s * a - 2.0 * c * s * b + c * c * d, 0.0))
            inside = along <= half + (margin + gate * u) and across <= broad + (margin + gate * v)
            vx, vy = velocity[i, 0] - parents_velocity[j, 0], velocity[i, 1] - parents_velocity[j, 1]
            differs = math.sqrt(vx * vx + vy * vy) > agree or parents_size[j, 0] > max_size_ratio * body[i]
            found[i, j] = inside and not differs


def shift_center(center_m: Float64, p_m: Float64, free_m: Float64, yaw_rad: Float64) -> Float64:
    """Centres (K, 2) after the least shift that puts points (K, 2) within `free_m` (K, 2) about them, at these yaws."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    d, half = p_m - center_m, np.maximum(free_m, 0.0) / 2
    along, across = c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]
    along, across = along - np.clip(along, -half[:, 0], half[:, 0]), across - np.clip(across, -half[:, 1], half[:, 1])
    return np.asarray(center_m + np.stack([c * along - s * across, s * along + c * across], axis=1))


class ParentTracks:
    """Lidar tracks as boxes, H rows: `row` in the table, position, size, yaw, velocity, and which are vehicles.

    `is_whole`: the last detection was no piece of the body.
    """

    def __init__(
        self, row: Int64, p_m: Float64, size_m: Float64, yaw_rad: Float64, velocity_mps: Float64, is_vehicle: Bool,
        is_whole: Bool,
    ) -> None:  # fmt: skip
        self.row, self.p_m, self.size_m = row, p_m, size_m
        self.cosine, self.sine = np.cos(yaw_rad), np.sin(yaw_rad)
        self.velocity_mps, self.is_vehicle, self.is_whole = velocity_mps, is_vehicle, is_whole
