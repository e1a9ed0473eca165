"""Object detector from an ONNX file; the network family is recognized by its outputs.

image 1280 x 720 ──► tiles by aspect ratio ──► fitted to the input ──► network ──► candidates
                       ┌───────┬─┬───────┐     (letterbox or stretched) in the image
                       │   1   │ │   2   │
                       └───────┴─┴───────┘
"""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float32, UInt8
from messages.errors import ConfigError
from perception.camera.boxes import Candidates, area, intersection
from perception.camera.classes import COCO
from perception.camera.model import Model, open_model, trial
from perception.camera.networks import recognize
from perception.camera.networks.network import Network

PADDING = 114  # grey level beside the image, as in training (YOLOX data_augment.py, preproc)


class DetectorConfig(Config):
    """Model file and selection of a network's candidates."""

    model: str | None = Field(
        default=None,
        description="name in configs/models.yaml, or ONNX file from the repository root; none: nothing is detected",
    )
    min_score: float = Field(gt=0.0, lt=1.0)
    max_iou: float = Field(gt=0.0, lt=1.0, description="boxes of a class that overlap more are one object")
    max_tile_ratio: float = Field(
        ge=1.0, le=4.0, description="width over height above which an image is split into tiles"
    )
    input_px: int = Field(
        ge=64, le=4096, multiple_of=32, description="side of the input where the model leaves it open"
    )


@dataclass(frozen=True)
class Detector:
    """Loaded and recognized model."""

    model: Model
    network: Network
    config: DetectorConfig

    def detect(self, bgr: UInt8) -> Candidates:
        """Candidates of at least `min_score` in an image (H, W, 3), in its pixels."""
        tiles = split_tiles(bgr.shape[1], bgr.shape[0], self.config.max_tile_ratio)
        found = [self._detect_in(bgr, left, right) for left, right in tiles]
        return join_tiles(found, tiles, bgr.shape[1])

    def _detect_in(self, bgr: UInt8, left: int, right: int) -> Candidates:
        canvas, scale = fit(bgr[:, left:right], self.model.size_px, self.network.is_stretched)
        planes = np.ascontiguousarray(canvas.transpose(2, 0, 1)).astype(np.float32)
        candidates = self.network.decode(self.model.run(self.network.prepare(planes)))
        good = candidates.scores.max(axis=1) >= self.config.min_score
        corners = candidates.corners_px[good] / np.tile(scale, 2)
        limits = np.array([right - left, bgr.shape[0]] * 2, np.float32)
        corners = np.clip(corners, 0.0, limits) + np.array([left, 0, left, 0], np.float32)
        return Candidates(corners.astype(np.float32), candidates.scores[good])


def split_tiles(width: int, height: int, max_ratio: float) -> list[tuple[int, int]]:
    """Columns (left, right) of overlapping tiles of an image, each no wider than about `max_ratio` times the height."""
    n = math.ceil(width / (max_ratio * height))
    # overlap of an eighth, so that a person on a border is complete in one tile
    side = min(width, math.ceil(width / n * 9 / 8))
    starts = [round(i * (width - side) / max(n - 1, 1)) for i in range(n)]
    return [(start, start + side) for start in starts]


def join_tiles(found: list[Candidates], tiles: list[tuple[int, int]], width: int) -> Candidates:
    """Candidates of all tiles, without those cut by a tile's border that the neighbouring tile shows completely."""
    kept = []
    for i, (candidates, (left, right)) in enumerate(zip(found, tiles, strict=True)):
        corners = candidates.corners_px.astype(np.float64)
        cut = (corners[:, 0] <= left + 2) & (left > 0) | (corners[:, 2] >= right - 2) & (right < width)
        others = [c.corners_px for j, c in enumerate(found) if abs(i - j) == 1]
        other = np.concatenate([*others, np.empty((0, 4), np.float32)]).astype(np.float64)
        common = np.zeros(len(corners))
        common[cut] = intersection(corners[cut], other).max(axis=1, initial=0.0)
        kept_rows = np.flatnonzero(~(cut & (common >= 0.7 * area(corners))))
        kept.append(Candidates(candidates.corners_px[kept_rows], candidates.scores[kept_rows]))
    return Candidates(np.concatenate([c.corners_px for c in kept]), np.concatenate([c.scores for c in kept]))


def fit(bgr: UInt8, size_px: tuple[int, int], is_stretched: bool) -> tuple[UInt8, Float32]:
    """Image (H, W, 3) of the input's size, and input pixels per image pixel (2,) in x and y.

    Stretched: scaled in each direction. Otherwise in one ratio, at the top left, the rest grey.
    """
    ratio = np.array([size_px[1] / bgr.shape[1], size_px[0] / bgr.shape[0]], np.float32)
    if is_stretched:
        return np.asarray(cv2.resize(bgr, size_px[::-1], interpolation=cv2.INTER_LINEAR), np.uint8), ratio
    scale = min(size_px[0] / bgr.shape[0], size_px[1] / bgr.shape[1])
    width, height = max(1, int(bgr.shape[1] * scale)), max(1, int(bgr.shape[0] * scale))
    canvas = np.full((*size_px, 3), PADDING, np.uint8)
    canvas[:height, :width] = cv2.resize(bgr, (width, height), interpolation=cv2.INTER_LINEAR)
    return canvas, np.full(2, scale, np.float32)


def load_detector(path: Path, config: DetectorConfig) -> Detector:
    """Detector in an ONNX file; raises ConfigError with the file and its outputs when it is not supported."""
    model = open_model(path, config.input_px)
    height, width = model.size_px
    network = recognize(trial(path, model), height, width)
    if network is None:
        raise ConfigError(
            f"{path}: its outputs {model.outputs()} are those of none of YOLOX, NanoDet, PicoDet and RT-DETR for "
            f"{width} x {height}"
        )
    if network.classes != len(COCO):
        raise ConfigError(
            f"{path}: its outputs {model.outputs()} have {network.classes} classes, not COCO's {len(COCO)}"
        )
    return Detector(model, network, config)
