"""RT-DETR: a fixed number of boxes that needs no non-maximum suppression, in two forms of export."""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32
from perception.camera.boxes import Candidates
from perception.camera.classes import COCO
from perception.camera.networks.network import Network, Outputs, are_scores


@dataclass(frozen=True)
class RtDetrLogits(Network):
    """RT-DETR (Zhao 2023) as Hugging Face exports it: `logits` (1, Q, C) and `pred_boxes` (1, Q, 4).

    Boxes are center and size in shares of the input, which is RGB from 0 to 1, stretched.
    """

    width_px: int
    height_px: int
    classes: int
    is_stretched = True

    @staticmethod
    def recognize(outputs: Outputs, height: int, width: int) -> "RtDetrLogits | None":
        """The network if the outputs are those of RT-DETR without its post-processing, else None."""
        # a file may give the features of its layers too
        if "logits" not in outputs or "pred_boxes" not in outputs:
            return None
        logits, boxes = outputs["logits"], outputs["pred_boxes"]
        if logits.ndim != 3 or logits.shape[0] != 1 or boxes.shape != (1, logits.shape[1], 4) or not are_scores(boxes):
            return None
        return RtDetrLogits(width, height, logits.shape[2])

    def prepare(self, bgr: Float32) -> Float32:
        return bgr[::-1] / np.float32(255.0)

    def decode(self, outputs: Outputs) -> Candidates:
        boxes = outputs["pred_boxes"][0] * np.array([self.width_px, self.height_px] * 2, np.float32)
        center, half = boxes[:, :2], boxes[:, 2:] / 2
        # exp overflows to infinity and the score to 0
        with np.errstate(over="ignore"):
            scores = 1.0 / (1.0 + np.exp(-outputs["logits"][0]))
        return Candidates(np.concatenate([center - half, center + half], axis=1), scores)


@dataclass(frozen=True)
class RtDetr(Network):
    """RT-DETR (Zhao 2023) as its authors export it: `labels` and `scores` (1, Q) and `boxes` (1, Q, 4).

    Boxes are left, top, right, bottom in the size given as second input, `orig_target_sizes`. The file does not tell
    its number of classes; a label that is none of COCO's is an error.
    """

    classes: int = len(COCO)
    is_stretched = True

    @staticmethod
    def recognize(outputs: Outputs, height: int, width: int) -> "RtDetr | None":
        """The network if the outputs are those of RT-DETR with its post-processing, else None."""
        if set(outputs) != {"labels", "boxes", "scores"}:
            return None
        labels, scores = outputs["labels"], outputs["scores"]
        is_match = labels.ndim == 2 and labels.shape[0] == 1 and scores.shape == labels.shape
        if not is_match or outputs["boxes"].shape != (1, labels.shape[1], 4) or not are_scores(scores):
            return None
        return RtDetr(max(len(COCO), int(labels.max(initial=0.0)) + 1))

    def prepare(self, bgr: Float32) -> Float32:
        return bgr[::-1] / np.float32(255.0)

    def decode(self, outputs: Outputs) -> Candidates:
        label = outputs["labels"][0].astype(np.int64)
        if label.min(initial=0) < 0 or label.max(initial=0) >= self.classes:
            raise ValueError(f"class {label.max()} from a network of COCO's {self.classes} classes")
        scores = np.zeros((len(label), self.classes), np.float32)
        scores[np.arange(len(label)), label] = outputs["scores"][0]
        return Candidates(outputs["boxes"][0], scores)
