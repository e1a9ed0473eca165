"""Class scores of a single cluster from its shape; the tracker adds motion. Shapes are of bodies on the ground."""

import numpy as np

from geometry.arrays import Bool, Float64, UInt8
from messages.perception import ObstacleClass
from perception.class_order import AIRBORNE, ANIMAL, CLASSES, UNKNOWN, VEHICLE
from perception.lidar.bodies import BODY, MAY_HOLD_BODY

UNKNOWN_WEIGHT = 0.25  # score of `UNKNOWN` against a perfect match of 1
PART = 0.2  # of a body that is seen in part: less than `UNKNOWN_WEIGHT`
# height, length and width of bodies, each a trapezoid (zero below, one from, one to, zero above) in metres
Trapezoid = tuple[float, float, float, float]
SHAPES: tuple[tuple[ObstacleClass, Trapezoid, Trapezoid, Trapezoid], ...] = (
    # standing to crouched adults and children
    (ObstacleClass.PERSON, (0.55, 0.9, 2.0, 2.3), (0.05, 0.15, 0.9, 1.3), (0.0, 0.1, 0.8, 1.1)),
    # on a bicycle
    (ObstacleClass.PERSON, (1.2, 1.45, 2.0, 2.3), (1.3, 1.55, 1.95, 2.2), (0.1, 0.2, 0.55, 0.75)),
    # hare to sheep, calf and deer
    (ObstacleClass.ANIMAL, (0.2, 0.4, 1.3, 1.5), (0.3, 0.7, 1.4, 1.7), (0.0, 0.1, 0.45, 0.7)),
    # cow and horse
    (ObstacleClass.ANIMAL, (1.2, 1.35, 1.6, 1.9), (1.3, 1.6, 2.4, 3.0), (0.2, 0.4, 0.8, 1.05)),
    # quad bike to lorry
    (ObstacleClass.VEHICLE, (0.7, 1.0, 3.6, 4.5), (1.3, 1.8, 12.0, 20.0), (0.3, 0.8, 3.2, 4.0)),
    # post to trunk
    (ObstacleClass.POLE, (0.8, 1.3, 9.0, 20.0), (0.0, 0.05, 0.35, 0.5), (0.0, 0.05, 0.3, 0.5)),
    # heaps of soil
    (ObstacleClass.MOUND, (0.15, 0.25, 0.8, 1.2), (1.0, 1.6, 8.0, 15.0), (0.4, 0.8, 6.0, 12.0)),
)
Limit = Float64 | float
LIMITS: Float64 = np.array([shape[1:] for shape in SHAPES]).transpose(2, 1, 0)[:, :, None]  # (4, 3, 1, shapes)
SHAPED = [CLASSES.index(shape[0]) for shape in SHAPES]
IS_LARGE = np.isin(SHAPED, (ANIMAL, VEHICLE))
BODY_SCORES = np.isin(CLASSES, (ObstacleClass.UNKNOWN, ObstacleClass.PERSON)).astype(np.float64)


def class_scores(size_m: Float64, top_m: Float64, is_floating: Bool, kinds: UInt8) -> Float64:
    """Scores (K, 8) in the order of `ObstacleClass`; sizes (K, 3) with the longer level side first, rows sum to 1.

    A smaller part of an animal or a vehicle may be all that is seen of it. `is_floating` (K,): there is clear space
    beneath the cluster. `kinds` (K,), of `perception.lidar.bodies`: a body beside something larger is a person or a
    post: as much unknown as anything else, so that a track that was a person before stays one. A cluster that may hold
    a body is as much unknown as a vehicle.
    """
    scores = np.zeros((len(size_m), len(CLASSES)))
    scores[:, UNKNOWN] = UNKNOWN_WEIGHT
    sides_m = np.stack([top_m, size_m[:, 0], size_m[:, 1]])[:, :, None]
    height, length, width = trapezoid(sides_m, *LIMITS)
    is_part = IS_LARGE & (sides_m[1:] <= LIMITS[2, 1:]).all(axis=0)
    fits = np.where(is_floating[:, None], 0.0, height * np.maximum(length * width, PART * is_part))
    for column, label in enumerate(SHAPED):
        scores[:, label] = np.maximum(scores[:, label], fits[:, column])
    scores[:, AIRBORNE] = is_floating
    doubtful = kinds == MAY_HOLD_BODY
    scores[doubtful, UNKNOWN] = np.maximum(scores[doubtful, UNKNOWN], scores[doubtful, VEHICLE])
    scores[kinds == BODY] = BODY_SCORES
    return np.asarray(scores / scores.sum(axis=1, keepdims=True), np.float64)


def trapezoid(x: Float64, a: Limit, b: Limit, c: Limit, d: Limit) -> Float64:
    """Zero up to `a`, rising to one at `b`, one up to `c`, falling to zero at `d`."""
    return np.clip(np.minimum((x - a) / (b - a), (d - x) / (d - c)), 0.0, 1.0)
