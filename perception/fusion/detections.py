"""One sensor's obstacles as the tracker takes them: in `odom`, each with its noise and what it is worth."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic import Field

from configs.strict import Config
from geometry.transforms import apply, yaw_of
from messages.message import Float64
from messages.perception import Obstacles
from perception.fusion.kalman import box_noise
from perception.fusion.static_occupancy import Stillness


class KindConfig(Config):
    """How much a kind of sensor is believed, and for how long what it saw is kept."""

    worth: float = Field(gt=0.0, le=200.0, description="of one sure detection; a lidar's of so many returns")
    score: tuple[float, float] | None = Field(default=None, description="of the best class: worth nothing, and sure")
    forget_new_s: float = Field(gt=0.0, le=10.0, description="before it is confirmed")
    forget_s: float = Field(gt=0.0, le=10.0)


class KindsConfig(Config):
    """Each kind of sensor; the name of a sensor begins with its kind."""

    lidar: KindConfig
    radar: KindConfig
    camera: KindConfig
    ultrasonic: KindConfig

    def of(self, sensor: str) -> KindConfig:
        """That of a sensor."""
        kind: KindConfig = getattr(self, sensor.partition("_")[0])
        return kind


class NoiseConfig(Config):
    """How sharply a lidar's box tells where its owner is."""

    position_sigma_m: float = Field(gt=0.0, le=2.0)
    size_share: float = Field(ge=0.0, le=1.0, description="of a box's side, added to the sigma of its centre")
    strip_m: float = Field(gt=0.0, le=20.0, description="what is as long and thin may be a piece of a fence or wall")
    strip_ratio: float = Field(gt=0.0, lt=1.0, description="most width of such a strip over its length")

    def is_strip(self, size_m: Float64) -> npt.NDArray[np.bool_]:
        """Which boxes (K,) may be strips: they end where sight does, and their middles tell no motion."""
        return np.asarray((size_m[:, 0] >= self.strip_m) & (size_m[:, 1] <= self.strip_ratio * size_m[:, 0]))


@dataclass(frozen=True)
class Detections:
    """One sensor's obstacles in `odom`, K rows; `R` (K, 2, 2) is the noise of their centres.

    `still` is the share of cells occupied for long; `velocity_mps` (K, 2) and `body_m` (K,), the length of what a
    camera takes it for, are NaN where not known; `returns` (K,) is the evidence, `log_scores` (K, 7) that of classes.
    """

    stamp_ns: int
    sensor: int
    kind: KindConfig
    is_lidar: bool
    p_m: Float64
    R: Float64
    size_m: Float64
    yaw_rad: Float64
    velocity_mps: Float64
    body_m: Float64
    returns: Float64
    log_scores: Float64
    still: Float64


def to_odom(
    obstacles: Obstacles,
    T_odom_base: Float64,
    sensor: int,
    stillness: Stillness,
    kinds: KindsConfig,
    noise: NoiseConfig,
) -> Detections:
    """Obstacles of one message as detections; the stillness of their cells is looked up and remembered."""
    yaw, kind = yaw_of(T_odom_base), kinds.of(obstacles.sensor)
    c, s = np.cos(yaw), np.sin(yaw)
    is_lidar, is_camera = (obstacles.sensor.startswith(name) for name in ("lidar", "camera"))
    points = apply(T_odom_base, obstacles.points_base_m)
    yaws = obstacles.yaw_rad + yaw
    body = obstacles.size_m[:, :2].max(axis=1) if len(yaws) else np.empty(0)
    return Detections(
        obstacles.stamp_ns, sensor, kind, is_lidar,
        np.asarray(apply(T_odom_base, obstacles.center_base_m), np.float64),
        box_noise(obstacles.sigma_m, yaws, 0.0, 1.0) if len(obstacles.sigma_m)
        else box_noise(obstacles.size_m, yaws, noise.position_sigma_m, noise.size_share),
        obstacles.size_m, (yaws + np.pi / 2) % np.pi - np.pi / 2,
        obstacles.velocity_mps @ np.array([[c, s], [-s, c]]), body if is_camera else np.full(len(yaws), np.nan),
        worth_of(obstacles, kind, is_lidar), np.log(np.maximum(obstacles.class_scores, 0.01)),
        stillness.observe(points.astype(np.float32), obstacles.offsets, obstacles.stamp_ns),
    )  # fmt: skip


def worth_of(obstacles: Obstacles, kind: KindConfig, is_lidar: bool) -> npt.NDArray[np.float64]:
    """Evidence (K,): of a lidar by the number of returns, of a camera by its score, of others the same each time."""
    if is_lidar:
        counts = np.diff(obstacles.offsets).astype(np.float64)
        return np.asarray(np.minimum(counts, kind.worth) ** 1.5 * kind.worth**-0.5)
    if kind.score is None:
        return np.full(len(obstacles.yaw_rad), kind.worth)
    low, high = kind.score
    best = obstacles.class_scores.max(axis=1) if len(obstacles.yaw_rad) else np.empty(0)
    return np.asarray(kind.worth * np.clip((best - low) / (high - low), 0.0, 1.0))
