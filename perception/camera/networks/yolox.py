"""YOLOX: offsets, log sizes, objectness and class scores of all cells in one output."""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32
from perception.camera.boxes import Candidates
from perception.camera.networks.network import Network, Outputs, are_scores, cells

STRIDES = (8, 16, 32)


@dataclass(frozen=True)
class Yolox(Network):
    """YOLOX (Ge 2021): one output (1, N, 5 + C); takes plain BGR.

    Files are exported with or without the conversion of offsets to pixels; `is_decoded`: with.
    """

    corner_px: Float32
    stride_px: Float32
    classes: int
    is_decoded: bool

    @staticmethod
    def recognize(outputs: Outputs, height: int, width: int) -> "Yolox | None":
        """The network if the outputs are those of YOLOX for this input size, else None.

        YOLOv6 gives the same shape with an objectness of 1 in every cell, and takes other input values.
        """
        levels = [cells(height, width, s) for s in STRIDES]
        corner = np.concatenate(levels)
        values = list(outputs.values())
        if len(values) != 1 or values[0].ndim != 3 or values[0].shape[:2] != (1, len(corner)) or values[0].shape[2] < 6:
            return None
        raw = values[0][0]
        if not are_scores(raw[:, 4:]) or (raw[:, 4] == 1.0).all():
            return None
        stride = np.concatenate([np.full(len(c), s, np.float32) for c, s in zip(levels, STRIDES, strict=True)])
        # offsets are within a few cells; pixels follow the grid
        in_pixels = np.abs(raw[:, :2] - corner).mean() < np.abs(raw[:, :2]).mean()
        return Yolox(corner, stride, raw.shape[1] - 5, bool(in_pixels))

    def prepare(self, bgr: Float32) -> Float32:
        return bgr

    def decode(self, outputs: Outputs) -> Candidates:
        (values,) = outputs.values()
        raw = values[0]
        center, size = raw[:, :2], raw[:, 2:4]
        if not self.is_decoded:
            center = center * self.stride_px[:, None] + self.corner_px
            size = np.exp(np.minimum(size, 20.0)) * self.stride_px[:, None]
        return Candidates(np.concatenate([center - size / 2, center + size / 2], axis=1), raw[:, 4:5] * raw[:, 5:])
