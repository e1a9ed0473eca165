"""Obstacles of one sensor as tracker input: in `odom`, with measurement noise and evidence."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from configs.sensor_kinds import SENSOR_KINDS, require_kinds
from configs.strict import Config
from geometry.arrays import Bool, Float64, Int64
from geometry.transforms import apply, yaw_of
from messages.perception import Obstacles
from perception.fusion.kalman import box_noise
from perception.fusion.static_occupancy import StaticOccupancy


class KindConfig(Config):
    """Evidence of one detection of a kind of sensor, and how long its tracks are kept without one."""

    evidence: float = Field(gt=0.0, le=200.0, description="of one certain detection; lidar: of so many returns")
    score: tuple[float, float] | None = Field(default=None, description="of the best class: no evidence, full evidence")
    keep_unconfirmed_s: float = Field(gt=0.0, le=10.0, description="before confirmation")
    keep_s: float = Field(gt=0.0, le=10.0)


def kind_of(sensor: str) -> str:
    """Kind of a sensor, the first part of its name: `radar_front` is of kind `radar`."""
    return sensor.partition("_")[0]


KindConfigs = Annotated[dict[str, KindConfig], AfterValidator(lambda kinds: require_kinds(kinds, SENSOR_KINDS))]


class NoiseConfig(Config):
    """Position noise of lidar boxes."""

    position_sigma_m: float = Field(gt=0.0, le=2.0)
    size_share: float = Field(ge=0.0, le=1.0, description="of a box's side, added to the sigma of its centre")
    strip_m: float = Field(gt=0.0, le=20.0, description="length of a thin box that may be a section of a fence or wall")
    strip_ratio: float = Field(gt=0.0, lt=1.0, description="greatest width of such a strip over its length")

    def is_strip(self, size_m: Float64) -> Bool:
        """Which boxes (K,) may be strips: their visible ends move with the view, so their centres show no motion."""
        return np.asarray((size_m[:, 0] >= self.strip_m) & (size_m[:, 1] <= self.strip_ratio * size_m[:, 0]))


@dataclass(frozen=True)
class Detections:
    """One sensor's obstacles in `odom`, K rows; `R` (K, 2, 2) is the noise of their centres.

    `shows_motion` (K,): those of lidars, of cameras, and with a measured velocity. Echoes without bearing from plants
    and walls seem to go along with the machine, and the centre of a fence is that of its reflections in view.
    `max_speed_mps` (K,) is the bound from long-occupied cells, or infinite; `velocity_mps` (K, 2) and `body_length_m`
    (K,), the length of the class that a camera detects, are NaN where unknown; `evidence` (K,) is that of existence,
    `class_log_scores` (K, 8) that of the classes.
    """

    stamp_ns: int
    sensor: int
    kind: KindConfig
    is_lidar: bool
    shows_motion: Bool
    p_m: Float64
    R: Float64
    size_m: Float64
    yaw_rad: Float64
    velocity_mps: Float64
    body_length_m: Float64
    evidence: Float64
    class_log_scores: Float64
    max_speed_mps: Float64

    def view(self, rows: Int64) -> Float64:
        """Sensor and length of some rows, (n, 2)."""
        return np.column_stack([np.full(len(rows), self.sensor, np.float64), self.size_m[rows, 0]])


def to_odom(
    obstacles: Obstacles,
    T_odom_base: Float64,
    sensor: int,
    static_occupancy: StaticOccupancy,
    kinds: dict[str, KindConfig],
    noise: NoiseConfig,
) -> Detections:
    """Detections from the obstacles of one message; updates the static occupancy with them."""
    yaw, kind = yaw_of(T_odom_base), kinds[kind_of(obstacles.sensor)]
    c, s = np.cos(yaw), np.sin(yaw)
    is_lidar, is_camera = (obstacles.sensor.startswith(name) for name in ("lidar", "camera"))
    points = apply(T_odom_base, obstacles.points_base_m)
    yaws = obstacles.yaw_rad + yaw
    body = obstacles.size_m[:, :2].max(axis=1) if len(yaws) else np.empty(0)
    shows_motion = np.isfinite(obstacles.velocity_mps).all(axis=1) | np.bool_(is_lidar or is_camera)
    return Detections(
        obstacles.stamp_ns, sensor, kind, is_lidar, np.asarray(shows_motion),
        np.asarray(apply(T_odom_base, obstacles.center_base_m), np.float64),
        box_noise(obstacles.sigma_m, yaws, 0.0, 1.0) if len(obstacles.sigma_m)
        else box_noise(obstacles.size_m, yaws, noise.position_sigma_m, noise.size_share),
        obstacles.size_m, (yaws + np.pi / 2) % np.pi - np.pi / 2,
        obstacles.velocity_mps @ np.array([[c, s], [-s, c]]), body if is_camera else np.full(len(yaws), np.nan),
        evidence_of(obstacles, kind, is_lidar), np.log(np.maximum(obstacles.class_scores, 0.01)),
        static_occupancy.observe(
            points.astype(np.float32), obstacles.offsets, obstacles.size_m[:, 0], obstacles.stamp_ns
        ),
    )  # fmt: skip


def evidence_of(obstacles: Obstacles, kind: KindConfig, is_lidar: bool) -> Float64:
    """Evidence (K,): lidar by number of returns, camera by score, others constant."""
    if is_lidar:
        counts = np.diff(obstacles.offsets).astype(np.float64)
        return np.asarray(np.minimum(counts, kind.evidence) ** 1.5 * kind.evidence**-0.5)
    if kind.score is None:
        return np.full(len(obstacles.yaw_rad), kind.evidence)
    low, high = kind.score
    best = obstacles.class_scores.max(axis=1) if len(obstacles.yaw_rad) else np.empty(0)
    return np.asarray(kind.evidence * np.clip((best - low) / (high - low), 0.0, 1.0))
