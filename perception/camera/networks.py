"""Network families: input preparation, and decoding of the outputs to candidates in input pixels."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64
from perception.camera.boxes import Candidates

Shape = tuple[int, ...]
YOLOX_STRIDES = (8, 16, 32)
# ImageNet's mean and deviation, BGR (NanoDet config/nanodet-m.yml)
NANODET_MEAN = np.array([103.53, 116.28, 123.675], np.float32)
NANODET_STD = np.array([57.375, 57.12, 58.395], np.float32)


class Network(ABC):
    """Network family, selected by the signature of the model's outputs, for one input size."""

    classes: int

    @abstractmethod
    def prepare(self, bgr: Float32) -> Float32:
        """Input values (3, H, W) from image values 0 to 255."""

    @abstractmethod
    def decode(self, outputs: Sequence[Float32]) -> Candidates:
        """Candidates in input pixels, from the outputs in the model's order."""


def centers(height: int, width: int, stride: int) -> Float32:
    """Corners (rows * columns, 2) of the cells of one level, x and y in pixels, row by row."""
    y, x = np.mgrid[0 : math.ceil(height / stride), 0 : math.ceil(width / stride)]
    return np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32) * np.float32(stride)


@dataclass(frozen=True)
class Yolox(Network):
    """YOLOX (Ge 2021): one output (1, N, 5 + C) of offsets, log sizes, objectness and classes; takes plain BGR.

    Files are exported with or without the conversion of offsets to pixels; `is_decoded`: with.
    """

    corner_px: Float32
    stride_px: Float32
    classes: int
    is_decoded: bool

    @staticmethod
    def recognize(outputs: Mapping[str, Float32], height: int, width: int) -> "Yolox | None":
        """The network if the outputs are those of YOLOX for this input size, else None."""
        levels = [centers(height, width, s) for s in YOLOX_STRIDES]
        corner = np.concatenate(levels)
        values = list(outputs.values())
        if len(values) != 1 or values[0].ndim != 3 or values[0].shape[1] != len(corner) or values[0].shape[2] <= 5:
            return None
        stride = np.concatenate([np.full(len(c), s, np.float32) for c, s in zip(levels, YOLOX_STRIDES, strict=True)])
        # offsets are within a few cells; pixels follow the grid
        in_pixels = np.abs(values[0][0, :, :2] - corner).mean() < np.abs(values[0][0, :, :2]).mean()
        return Yolox(corner, stride, values[0].shape[2] - 5, bool(in_pixels))

    def prepare(self, bgr: Float32) -> Float32:
        return bgr

    def decode(self, outputs: Sequence[Float32]) -> Candidates:
        raw = outputs[0][0]
        center, size = raw[:, :2], raw[:, 2:4]
        if not self.is_decoded:
            center = center * self.stride_px[:, None] + self.corner_px
            size = np.exp(np.minimum(size, 20.0)) * self.stride_px[:, None]
        return Candidates(np.concatenate([center - size / 2, center + size / 2], axis=1), raw[:, 4:5] * raw[:, 5:])


@dataclass(frozen=True)
class Nanodet(Network):
    """NanoDet (RangiLyu 2020): per stride class scores (1, n, C) and a distribution of distances (1, n, 4 (R + 1)).

    `levels` holds stride, index of the scores and index of the distances among the outputs.
    """

    levels: tuple[tuple[int, int, int], ...]
    center_px: tuple[Float32, ...]
    classes: int

    @staticmethod
    def recognize(outputs: Mapping[str, Float32], height: int, width: int) -> "Nanodet | None":
        """The network if the outputs are those of NanoDet for this input size, else None."""
        names = list(outputs)
        strides = [int(n[16:]) for n in names if n.startswith("cls_pred_stride_") and n[16:].isdigit()]
        levels, places, classes = [], [], set()
        for stride in strides:
            score, distance = f"cls_pred_stride_{stride}", f"dis_pred_stride_{stride}"
            place = centers(height, width, max(stride, 1))
            if distance not in outputs or not _is_level(outputs[score].shape, outputs[distance].shape, len(place)):
                return None
            levels.append((stride, names.index(score), names.index(distance)))
            # the middle of a cell, counted from the middle of the first pixel (nanodet/model/head/gfl_head.py)
            places.append(place + np.float32((stride - 1) / 2))
            classes.add(outputs[score].shape[2])
        if len(classes) != 1 or len(names) != 2 * len(levels):
            return None
        return Nanodet(tuple(levels), tuple(places), classes.pop())

    def prepare(self, bgr: Float32) -> Float32:
        return (bgr - NANODET_MEAN[:, None, None]) / NANODET_STD[:, None, None]

    def decode(self, outputs: Sequence[Float32]) -> Candidates:
        corners, scores = [], []
        for (stride, score, distance), center in zip(self.levels, self.center_px, strict=True):
            reach = expectation(outputs[distance][0]) * stride
            corners.append(np.concatenate([center - reach[:, :2], center + reach[:, 2:]], axis=1))
            scores.append(outputs[score][0])
        return Candidates(np.concatenate(corners).astype(np.float32), np.concatenate(scores))


def _is_level(score: Shape, distance: Shape, n: int) -> bool:
    is_match = len(score) == 3 and len(distance) == 3 and score[1] == distance[1] == n
    return is_match and n > 0 and distance[2] % 4 == 0 and distance[2] > 4


def expectation(logits: Float32) -> Float64:
    """Mean (N, 4) of the four distributions over 0, 1, … R given by (N, 4 (R + 1)) logits (Li 2020, eq. 4)."""
    grouped = logits.reshape(len(logits), 4, -1).astype(np.float64)
    weight = np.exp(grouped - grouped.max(axis=2, keepdims=True))
    weight /= weight.sum(axis=2, keepdims=True)
    return np.asarray(weight @ np.arange(grouped.shape[2], dtype=np.float64), np.float64)


FAMILIES: tuple[type[Yolox] | type[Nanodet], ...] = (Yolox, Nanodet)


def recognize(outputs: Mapping[str, Float32], height: int, width: int) -> Network | None:
    """The network family of the outputs of a trial run (by name, in the model's order), or None."""
    found = (family.recognize(outputs, height, width) for family in FAMILIES)
    return next((network for network in found if network is not None), None)
