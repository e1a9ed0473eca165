"""Range of image boxes: from their foot point on the ground, checked against their height.

      camera o_                    foot   the lower edge of a box, intersected with the plane of the wheels; the error
             | `-._                       grows with the square of the distance (pitch of machine and terrain)
      height |     `-._  /|\\      size   the known height of the class over its height in the image; the error
             |_________`-/_\\___          grows with the distance (people differ)

If both agree: the mean weighted by their variances. If not (feet hidden by crop or by the image border, a slope, a
sitting person): the smaller range, with their difference as sigma.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Camera
from geometry.arrays import Float64, Int64
from messages.perception import ObstacleClass
from perception.camera.boxes import Boxes
from perception.camera.classes import GROUPS

R_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # x right, y down, z ahead


class SizePrior(Config):
    """Height of a class, its standard deviation, and depth."""

    height_m: float = Field(gt=0.0, le=10.0)
    height_sigma_m: float = Field(gt=0.0, le=5.0)
    depth_m: float = Field(gt=0.0, le=20.0)


class RangingConfig(Config):
    """Error sources and greatest range of ranging."""

    person: SizePrior
    animal: SizePrior
    vehicle: SizePrior
    pitch_sigma_deg: float = Field(gt=0.0, le=10.0, description="of the ground relative to the plane of the wheels")
    edge_sigma_px: float = Field(gt=0.0, le=50.0, description="of a box edge in the image")
    agree_sigma: float = Field(gt=0.0, le=10.0)
    max_range_m: float = Field(gt=1.0, le=200.0)

    def prior(self, group: int) -> SizePrior:
        """The prior of one of `GROUPS`."""
        priors = {ObstacleClass.PERSON: self.person, ObstacleClass.ANIMAL: self.animal}
        return priors.get(GROUPS[group], self.vehicle)


@dataclass(frozen=True)
class CameraGeometry:
    """Camera geometry for ranging: rays of pixels in `base`."""

    camera: Camera

    @property
    def origin_m(self) -> Float64:
        """Position of the camera in `base`, (3,)."""
        return self.camera.mount.T_base_sensor[:3, 3]

    @property
    def K(self) -> Float64:
        """Intrinsic matrix, (3, 3)."""
        (fx, fy), (cx, cy) = self.camera.focal_px, self.camera.center_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def rays(self, pixels: Float64) -> Float64:
        """Directions (N, 3) in `base` of pixels (N, 2); their component along the optical axis is 1."""
        if len(pixels) == 0:
            return np.empty((0, 3))
        flat = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.K, np.array(self.camera.distortion)).reshape(-1, 2)
        optical = np.concatenate([flat.astype(np.float64), np.ones((len(flat), 1))], axis=1)
        return np.asarray(optical @ (self.camera.mount.T_base_sensor[:3, :3] @ R_BODY_OPTICAL).T, np.float64)

    def sector_edges(self, sectors: int) -> Float64:
        """Azimuths (sectors + 1,) in `base`, ascending, of the borders of equal column sectors of the image."""
        width, height = self.camera.size_px
        column = np.linspace(width, 0.0, sectors + 1)
        ray = self.rays(np.stack([column, np.full(sectors + 1, height / 2)], axis=1))
        return np.asarray(np.unwrap(np.arctan2(ray[:, 1], ray[:, 0])), np.float64)

    def horizon_row(self) -> float:
        """Image row of the horizon at the middle column."""
        width, height = self.camera.size_px
        top, bottom = self.rays(np.array([[width / 2, 0.0], [width / 2, height]], np.float64))
        slope = np.array([top[2] / math.hypot(top[0], top[1]), bottom[2] / math.hypot(bottom[0], bottom[1])])
        return float(np.clip(slope[0] / (slope[0] - slope[1]), 0.0, 1.0) * height)


@dataclass(frozen=True)
class RangedBoxes:
    """Boxes on the ground in `base`: `foot_m` (K, 2), `sigma_m` (K, 2) along and across the ray, `azimuth_rad` (K,)
    of the ray, `size_m` (K, 3) depth, width and height; `row` (K,) index of the box."""

    foot_m: Float64
    sigma_m: Float64
    azimuth_rad: Float64
    size_m: Float64
    row: Int64


def locate(boxes: Boxes, model: CameraGeometry, config: RangingConfig) -> RangedBoxes:
    """The boxes within `max_range_m`; `boxes.label` are indices into `GROUPS`."""
    low = model.rays(np.stack([boxes.corners_px[:, [0, 2]].mean(axis=1), boxes.corners_px[:, 3]], axis=1))
    high = model.rays(np.stack([boxes.corners_px[:, [0, 2]].mean(axis=1), boxes.corners_px[:, 1]], axis=1))
    side = model.rays(np.stack([boxes.corners_px[:, 2], boxes.corners_px[:, 3]], axis=1))
    height_m = model.origin_m[2]
    rows, found = [], []
    for k in range(len(boxes)):
        prior = config.prior(int(boxes.label[k]))
        foot = range_by_foot(low[k], height_m, model.camera.focal_px[1], config)
        size = range_by_size(low[k], high[k], prior)
        is_cut = boxes.corners_px[k, 3] >= model.camera.size_px[1] - 2
        range_m, sigma_m = combine(foot, size, is_cut, config.agree_sigma)
        if range_m <= config.max_range_m:
            level = math.hypot(low[k, 0], low[k, 1])
            width = 2.0 * math.hypot(side[k, 0] - low[k, 0], side[k, 1] - low[k, 1]) * range_m / level
            tall = (high[k, 2] / math.hypot(high[k, 0], high[k, 1]) - low[k, 2] / level) * range_m
            across = range_m * config.edge_sigma_px / model.camera.focal_px[0]
            rows.append(k)
            found.append(
                (range_m, sigma_m, across, math.atan2(low[k, 1], low[k, 0]), prior.depth_m, width, max(tall, 0.1))
            )
    table = np.array(found, np.float64).reshape(-1, 7)
    azimuth = table[:, 3]
    foot_m = model.origin_m[:2] + table[:, :1] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    return RangedBoxes(foot_m, table[:, 1:3].copy(), azimuth.copy(), table[:, 4:7].copy(), np.array(rows, np.int64))


def range_by_foot(ray: Float64, height_m: float, focal_px: float, config: RangingConfig) -> tuple[float, float]:
    """Horizontal range from the camera at which a ray meets the ground, and its sigma; infinite when it does not."""
    down = -ray[2] / math.hypot(ray[0], ray[1])
    angle_sigma = math.hypot(math.radians(config.pitch_sigma_deg), config.edge_sigma_px / focal_px)
    if down <= 1e-6 or height_m <= 0.0:
        return math.inf, math.inf
    range_m = height_m / down
    return range_m, (range_m**2 + height_m**2) / height_m * angle_sigma


def range_by_size(low: Float64, high: Float64, prior: SizePrior) -> tuple[float, float]:
    """Horizontal range at which an object of the prior's height fills the angle between two rays, and its sigma."""
    tall = high[2] / math.hypot(high[0], high[1]) - low[2] / math.hypot(low[0], low[1])
    if tall <= 1e-6:
        return math.inf, math.inf
    return prior.height_m / tall, prior.height_sigma_m / tall


def combine(
    foot: tuple[float, float], size: tuple[float, float], is_cut: bool, agree_sigma: float
) -> tuple[float, float]:
    """Combined range and sigma; `is_cut`: the feet are below the image, so that both ranges are upper bounds."""
    (a, sigma_a), (b, sigma_b) = foot, size
    if not (math.isfinite(a) and math.isfinite(b)):
        return (b, sigma_b) if math.isfinite(b) else (a, sigma_a)
    if is_cut or abs(a - b) > agree_sigma * math.hypot(sigma_a, sigma_b):
        return min(a, b), max(abs(a - b), sigma_a if a < b else sigma_b)
    weight_a, weight_b = 1.0 / sigma_a**2, 1.0 / sigma_b**2
    return (weight_a * a + weight_b * b) / (weight_a + weight_b), (weight_a + weight_b) ** -0.5
