"""NanoDet and PicoDet: scores and distributions of the distances to the four edges, for each level of cells.

Both have the head of generalized focal loss (Li 2020). NanoDet's outputs carry the stride in their name. PicoDet's
names are arbitrary; its levels differ by their number of cells.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from geometry.arrays import Float32, Float64
from perception.camera.boxes import Candidates
from perception.camera.classes import COCO
from perception.camera.networks.network import (
    Network,
    Outputs,
    are_scores,
    cells,
    standardized_bgr,
    standardized_rgb,
)


@dataclass(frozen=True)
class Level:
    """Cells of one stride: names of the outputs (1, n, C) and (1, n, 4 (R + 1)), and the points of the cells."""

    scores: str
    distances: str
    stride_px: int
    center_px: Float32


@dataclass(frozen=True)
class FocalNetwork(Network):
    """Network with a score and four distributions of distances for each cell of each level."""

    levels: tuple[Level, ...]
    classes: int

    def decode(self, outputs: Outputs) -> Candidates:
        corners, scores = [], []
        for level in self.levels:
            reach = expectation(outputs[level.distances][0]) * level.stride_px
            corners.append(np.concatenate([level.center_px - reach[:, :2], level.center_px + reach[:, 2:]], axis=1))
            scores.append(outputs[level.scores][0])
        return Candidates(np.concatenate(corners).astype(np.float32), np.concatenate(scores))


@dataclass(frozen=True)
class Nanodet(FocalNetwork):
    """NanoDet (RangiLyu 2020): outputs `cls_pred_stride_S` and `dis_pred_stride_S`; takes standardized BGR."""

    @staticmethod
    def recognize(outputs: Outputs, height: int, width: int) -> "Nanodet | None":
        """The network if the outputs are those of NanoDet for this input size, else None."""
        strides = [int(n[16:]) for n in outputs if n.startswith("cls_pred_stride_") and n[16:].isdigit()]
        levels, classes = [], set()
        for stride in strides:
            score, distance = f"cls_pred_stride_{stride}", f"dis_pred_stride_{stride}"
            corner = cells(height, width, max(stride, 1))
            if distance not in outputs or not _is_level(outputs[score], outputs[distance], len(corner)):
                return None
            # the middle of a cell, counted from the middle of the first pixel (nanodet/model/head/gfl_head.py)
            levels.append(Level(score, distance, stride, corner + np.float32((stride - 1) / 2)))
            classes.add(outputs[score].shape[2])
        if len(classes) != 1 or len(outputs) != 2 * len(levels):
            return None
        return Nanodet(tuple(levels), classes.pop())

    def prepare(self, bgr: Float32) -> Float32:
        return standardized_bgr(bgr)


@dataclass(frozen=True)
class Picodet(FocalNetwork):
    """PP-PicoDet (Yu 2021), exported without post-processing: eight outputs; takes standardized RGB, stretched.

    The channel order is that of its training (PaddleDetection, ppdet/data/transform/operators.py, Decode); the
    project's own ONNX example gives it BGR.
    """

    is_stretched = True
    STRIDES: ClassVar = (8, 16, 32, 64)

    @staticmethod
    def recognize(outputs: Outputs, height: int, width: int) -> "Picodet | None":
        """The network if the outputs are those of PicoDet for COCO's classes and this input size, else None."""
        if len(outputs) != 2 * len(Picodet.STRIDES) or any(values.ndim != 3 for values in outputs.values()):
            return None
        name_of = {(values.shape[1], values.shape[2] == len(COCO)): name for name, values in outputs.items()}
        levels = []
        for stride in Picodet.STRIDES:
            corner = cells(height, width, stride)
            score, distance = name_of.get((len(corner), True)), name_of.get((len(corner), False))
            if score is None or distance is None or not _is_level(outputs[score], outputs[distance], len(corner)):
                return None
            # the middle of a cell (ppdet/modeling/heads/pico_head.py, cell_offset 0.5)
            levels.append(Level(score, distance, stride, corner + np.float32(stride / 2)))
        if len({level.scores for level in levels}) != len(levels):
            return None
        return Picodet(tuple(levels), len(COCO))

    def prepare(self, bgr: Float32) -> Float32:
        return standardized_rgb(bgr)


def _is_level(scores: Float32, distances: Float32, n: int) -> bool:
    is_match = scores.ndim == 3 and distances.ndim == 3 and scores.shape[:2] == distances.shape[:2] == (1, n)
    width = distances.shape[-1] if is_match else 0
    return n > 0 and width > 4 and width % 4 == 0 and are_scores(scores)


def expectation(logits: Float32) -> Float64:
    """Mean (N, 4) of the four distributions over 0, 1, … R given by (N, 4 (R + 1)) logits (Li 2020, eq. 4)."""
    grouped = logits.reshape(len(logits), 4, -1).astype(np.float64)
    weight = np.exp(grouped - grouped.max(axis=2, keepdims=True))
    weight /= weight.sum(axis=2, keepdims=True)
    return np.asarray(weight @ np.arange(grouped.shape[2], dtype=np.float64), np.float64)
