"""Boxes (N, 4) in a picture as left, top, right, bottom in pixels: overlap and suppression of doubles."""

from dataclasses import dataclass

import numpy as np

from messages.message import Float32, Float64, Int64


@dataclass(frozen=True)
class Candidates:
    """What a network proposes: `corners_px` (N, 4) in the picture, `scores` (N, C) of its classes."""

    corners_px: Float32
    scores: Float32


@dataclass(frozen=True)
class Boxes:
    """What is left of the candidates, best first: `corners_px` (K, 4), `label` (K,), `score` (K,)."""

    corners_px: Float64
    label: Int64
    score: Float64

    def __len__(self) -> int:
        return len(self.score)


def area(corners: Float64) -> Float64:
    """Areas (N,); an inside-out box has none."""
    return np.asarray(np.prod(np.maximum(corners[:, 2:] - corners[:, :2], 0.0), axis=1), np.float64)


def intersection(a: Float64, b: Float64) -> Float64:
    """Areas (N, M) that boxes `a` (N, 4) and `b` (M, 4) have in common."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0.0), axis=2), np.float64)


def iou(a: Float64, b: Float64) -> Float64:
    """Intersection over union, (N, M); 0 where both are empty."""
    common = intersection(a, b)
    union = area(a)[:, None] + area(b)[None, :] - common
    return np.asarray(common / np.maximum(union, 1e-9), np.float64)


def pick(candidates: Candidates, least_score: float, most_iou: float, most: int = 1000) -> Boxes:
    """The candidates above `least_score`, one for each thing: per class, the best first, none overlapping a better one.

    A candidate counts once for each class it scores in. Ties go by the candidates' order. Candidates with a number
    that is not finite are left out.
    """
    finite = np.isfinite(np.concatenate([candidates.corners_px, candidates.scores], axis=1)).all(axis=1, keepdims=True)
    row, label = np.nonzero(np.logical_and(candidates.scores >= least_score, finite))
    score = candidates.scores[row, label].astype(np.float64)
    best = np.argsort(-score, kind="stable")[:most]
    boxes = Boxes(candidates.corners_px[row[best]].astype(np.float64), label[best].astype(np.int64), score[best])
    keep = _suppress(boxes.corners_px, boxes.label, most_iou)
    return Boxes(boxes.corners_px[keep], boxes.label[keep], boxes.score[keep])


def _suppress(corners: Float64, label: Int64, most_iou: float) -> Int64:
    """Which of the boxes, best first, stay (Neubeck and Van Gool 2006, greedy); classes do not touch each other."""
    # each class goes to a place of its own, so that one pass serves all
    span = float(np.ptp(corners)) + 1.0 if corners.size else 1.0
    apart = corners + (label * span)[:, None]
    left, keep = np.arange(len(corners)), []
    while left.size:
        keep.append(left[0])
        rest = left[1:]
        left = rest[np.flatnonzero(iou(apart[left[:1]], apart[rest])[0] <= most_iou)]
    return np.array(keep, np.int64)
