"""Boxes (N, 4) in an image as left, top, right, bottom in pixels: overlap and non-maximum suppression."""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64, Int64


@dataclass(frozen=True)
class Candidates:
    """Candidates of a network: `corners_px` (N, 4) in the image, `scores` (N, C) of its classes."""

    corners_px: Float32
    scores: Float32


@dataclass(frozen=True)
class Boxes:
    """Selected candidates, best first: `corners_px` (K, 4), `label` (K,), `score` (K,)."""

    corners_px: Float64
    label: Int64
    score: Float64

    def __len__(self) -> int:
        return len(self.score)


def area(corners: Float64) -> Float64:
    """Areas (N,); 0 for an inverted box."""
    return np.asarray(np.prod(np.maximum(corners[:, 2:] - corners[:, :2], 0.0), axis=1), np.float64)


def intersection(a: Float64, b: Float64) -> Float64:
    """Areas (N, M) of the intersections of boxes `a` (N, 4) and `b` (M, 4)."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0.0), axis=2), np.float64)


def iou(a: Float64, b: Float64) -> Float64:
    """Intersection over union, (N, M); 0 where both are empty."""
    common = intersection(a, b)
    union = area(a)[:, None] + area(b)[None, :] - common
    return np.asarray(common / np.maximum(union, 1e-9), np.float64)


def non_max_suppression(candidates: Candidates, min_score: float, max_iou: float, max_count: int = 1000) -> Boxes:
    """Candidates of at least `min_score`: per class, best first, none that overlaps a better one by over `max_iou`.

    A candidate counts once for each class it scores in. Ties keep the order of the candidates. Candidates with a value
    that is not finite are left out.
    """
    finite = np.isfinite(np.concatenate([candidates.corners_px, candidates.scores], axis=1)).all(axis=1, keepdims=True)
    row, label = np.nonzero(np.logical_and(candidates.scores >= min_score, finite))
    score = candidates.scores[row, label].astype(np.float64)
    best = np.argsort(-score, kind="stable")[:max_count]
    boxes = Boxes(candidates.corners_px[row[best]].astype(np.float64), label[best].astype(np.int64), score[best])
    keep = _suppress(boxes.corners_px, boxes.label, max_iou)
    return Boxes(boxes.corners_px[keep], boxes.label[keep], boxes.score[keep])


def _suppress(corners: Float64, label: Int64, max_iou: float) -> Int64:
    """Rows of the boxes that are kept, best first (greedy, Neubeck and Van Gool 2006), separately per class."""
    # classes are shifted apart, so that one pass handles all
    span = float(np.ptp(corners)) + 1.0 if corners.size else 1.0
    apart = corners + (label * span)[:, None]
    left, keep = np.arange(len(corners)), []
    while left.size:
        keep.append(left[0])
        rest = left[1:]
        left = rest[np.flatnonzero(iou(apart[left[:1]], apart[rest])[0] <= max_iou)]
    return np.array(keep, np.int64)
