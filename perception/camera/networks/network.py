"""What all network families share: interface, cells of a level, and recognition of scores."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from geometry.arrays import Float32
from perception.camera.boxes import Candidates

Outputs = Mapping[str, Float32]
# ImageNet's mean and deviation in the order red, green, blue
IMAGENET_MEAN = np.array([123.675, 116.28, 103.53], np.float32)
IMAGENET_STD = np.array([58.395, 57.12, 57.375], np.float32)


class Network(ABC):
    """Network family, selected by the signature of the model's outputs, for one input size."""

    classes: int
    is_stretched: bool = False  # trained on images scaled to the input in each direction, else in one ratio

    @abstractmethod
    def prepare(self, bgr: Float32) -> Float32:
        """Input values (3, H, W) from image values 0 to 255."""

    @abstractmethod
    def decode(self, outputs: Outputs) -> Candidates:
        """Candidates in input pixels, from the outputs by name."""


def cells(height: int, width: int, stride: int) -> Float32:
    """Corners (rows * columns, 2) of the cells of one level, x and y in pixels, row by row."""
    y, x = np.mgrid[0 : math.ceil(height / stride), 0 : math.ceil(width / stride)]
    return np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32) * np.float32(stride)


def are_scores(values: Float32) -> bool:
    """Whether all values are finite and from 0 to 1: a model exported without its last sigmoid has others."""
    return bool(((values >= 0.0) & (values <= 1.0)).all())


def standardized_rgb(bgr: Float32) -> Float32:
    """ImageNet's standardization of (3, H, W), channels in the order red, green, blue."""
    return (bgr[::-1] - IMAGENET_MEAN[:, None, None]) / IMAGENET_STD[:, None, None]


def standardized_bgr(bgr: Float32) -> Float32:
    """ImageNet's standardization of (3, H, W), channels in the order blue, green, red."""
    return (bgr - IMAGENET_MEAN[::-1, None, None]) / IMAGENET_STD[::-1, None, None]
