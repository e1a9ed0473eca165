"""Object detector from an ONNX file; the network family is recognized by its outputs.

image 1280 x 720 ──► tiles by aspect ratio ──► letterbox to the input ──► network ──► candidates
                       ┌───────┬─┬───────┐     (scaled, top left, rest grey)               in the image
                       │   1   │ │   2   │
                       └───────┴─┴───────┘
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float32, UInt8
from messages.errors import ConfigError
from perception.camera.boxes import Candidates, area, intersection
from perception.camera.classes import COCO
from perception.camera.networks import Network, recognize

PADDING = 114  # grey level beside the image, as in training (YOLOX data_augment.py, preproc)


class DetectorConfig(Config):
    """Model file and selection of a network's candidates."""

    model: str | None = Field(default=None, description="ONNX file; without one the camera has no detection range")
    min_score: float = Field(gt=0.0, lt=1.0)
    max_iou: float = Field(gt=0.0, lt=1.0, description="boxes of a class that overlap more are one object")
    max_tile_ratio: float = Field(
        ge=1.0, le=4.0, description="width over height above which an image is split into tiles"
    )
    input_px: int = Field(
        ge=64, le=4096, multiple_of=32, description="side of the input where the model leaves it open"
    )


class Session(Protocol):
    """Used part of the interface of onnxruntime's session."""

    def run(self, output_names: None, feed: dict[str, Float32]) -> list[Float32]: ...


@dataclass(frozen=True)
class Detector:
    """Loaded and recognized model; `size_px` is height and width of its input."""

    session: Session
    input_name: str
    network: Network
    size_px: tuple[int, int]
    config: DetectorConfig
    model: str

    def detect(self, bgr: UInt8) -> Candidates:
        """Candidates of at least `min_score` in an image (H, W, 3), in its pixels."""
        tiles = split_tiles(bgr.shape[1], bgr.shape[0], self.config.max_tile_ratio)
        found = [self._detect_in(bgr, left, right) for left, right in tiles]
        return join_tiles(found, tiles, bgr.shape[1])

    def _detect_in(self, bgr: UInt8, left: int, right: int) -> Candidates:
        blob, scale = letterbox(bgr[:, left:right], self.size_px, self.network)
        candidates = self.network.decode(self.session.run(None, {self.input_name: blob}))
        good = candidates.scores.max(axis=1) >= self.config.min_score
        corners = candidates.corners_px[good] / scale
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


def letterbox(bgr: UInt8, size_px: tuple[int, int], network: Network) -> tuple[Float32, float]:
    """Network input (1, 3, H, W) with the image at its top left, and input pixels per image pixel."""
    scale = min(size_px[0] / bgr.shape[0], size_px[1] / bgr.shape[1])
    width, height = max(1, int(bgr.shape[1] * scale)), max(1, int(bgr.shape[0] * scale))
    canvas = np.full((*size_px, 3), PADDING, np.uint8)
    canvas[:height, :width] = cv2.resize(bgr, (width, height), interpolation=cv2.INTER_LINEAR)
    planes = np.ascontiguousarray(canvas.transpose(2, 0, 1)).astype(np.float32)
    return network.prepare(planes)[None], scale


def load_detector(path: Path, config: DetectorConfig) -> Detector:
    """Detector in an ONNX file; raises ConfigError with the file and its outputs when it is not supported."""
    session = _open(path)
    inputs = session.get_inputs()
    size = _input_size(inputs[0].shape, config.input_px) if len(inputs) == 1 else None
    given = ", ".join(f"{o.name} {list(o.shape)}" for o in session.get_outputs())
    if size is None or inputs[0].type != "tensor(float)":
        taken = ", ".join(f"{i.name} {list(i.shape)} {i.type}" for i in inputs)
        raise ConfigError(f"{path}: takes {taken}, not one float image (1, 3, H, W); its outputs are {given}")
    name = inputs[0].name
    # trial run: true shapes, also where the file leaves them open, and warm-up
    outputs = _try(path, session, name, size)
    names = [o.name for o in session.get_outputs()]
    network = recognize(dict(zip(names, outputs, strict=True)), *size)
    if network is None:
        raise ConfigError(
            f"{path}: its outputs {given} are neither those of YOLOX nor of NanoDet for {size[1]} x {size[0]}"
        )
    if network.classes != len(COCO):
        raise ConfigError(f"{path}: its outputs {given} have {network.classes} classes, not COCO's {len(COCO)}")
    return Detector(session, name, network, size, config, path.name)


def _open(path: Path) -> Any:
    import onnxruntime  # late import: heavy, and needed only with a model

    if not path.is_file():
        raise ConfigError(f"{path}: no such model file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3  # NanoDet's file causes 300 lines of warnings
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a separate class per cause
        raise ConfigError(f"{path}: not a model that onnxruntime can load ({_first_line(error)})") from error


def _try(path: Path, session: Session, name: str, size: tuple[int, int]) -> list[Float32]:
    try:
        return session.run(None, {name: np.zeros((1, 3, *size), np.float32)})
    except Exception as error:  # as above
        raise ConfigError(f"{path}: cannot run on an image of {size[1]} x {size[0]} ({_first_line(error)})") from error


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0][:200] if str(error) else type(error).__name__


def _input_size(shape: list[int | str | None], open_px: int) -> tuple[int, int] | None:
    if len(shape) != 4 or shape[1] != 3 or (shape[0] not in (1, None) and not isinstance(shape[0], str)):
        return None
    height, width = (n if isinstance(n, int) and n > 0 else open_px for n in shape[2:])
    return height, width
