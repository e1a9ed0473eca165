"""Class of tracks from shape over time and speed.

A cyclist, whom no shape of a standing person covers, is a person, unless there was clear space beneath, as of dust;
what has no class, is small and runs is an animal; what floated a moment ago and is fast flies.
"""

import numpy as np

from geometry.arrays import Float64, Int64
from messages.perception import ObstacleClass
from perception.class_order import AIRBORNE, ANIMAL, CLASSES, PERSON, UNKNOWN
from perception.fusion.tracks import FLIGHT_MPS, TrackTable
from perception.lidar.classes import UNKNOWN_WEIGHT, Trapezoid, trapezoid

CLASS_SPEEDS_MPS = {
    ObstacleClass.PERSON: 4.0,
    ObstacleClass.POLE: 0.7,
    ObstacleClass.MOUND: 0.7,
    ObstacleClass.DITCH: 0.7,
}
MAX_SPEED_MPS = np.array([CLASS_SPEEDS_MPS.get(label, np.inf) for label in CLASSES])
# length, width and height of bicycle and rider (m), and their speed (m/s): zero below, one from, one to, zero above
YOUNG_NS = 500_000_000  # a track that is younger has no speed yet
FLOATED_NS = 1_000_000_000  # dust at the ground has clear space beneath it in some scans, and its parts seem to run
CYCLIST_SPEED_MPS = 4.0
CYCLIST = ((1.3, 1.55, 1.95, 2.2), (0.2, 0.4, 0.9, 1.1), (1.2, 1.45, 2.0, 2.3), (1.5, 2.5, 10.0, 14.0))
RUNNER = ((0.2, 0.4, 1.0, 1.4), (0.0, 0.02, 0.4, 0.6), (0.1, 0.25, 0.6, 0.9), (0.5, 1.0, 8.0, 12.0))  # a dog or a hare


def classify(table: TrackTable, velocity_mps: Float64) -> tuple[Int64, Float64]:
    """Index in `CLASSES` and probability (T,) of the most likely class."""
    speed = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    log = (
        table.class_evidence - table.class_evidence.max(axis=1, keepdims=True, initial=-np.inf)
        if len(speed)
        else table.class_evidence
    )
    share = np.exp(log)
    share *= np.where(speed[:, None] > MAX_SPEED_MPS, 0.01, 1.0)
    share /= share.sum(axis=1, keepdims=True)
    is_young = (table.last_ns - table.first_ns < YOUNG_NS) & (table.size_m[:, 1] > CYCLIST[1][1])
    runner = moving_probability(RUNNER, table.size_m, speed) * share[:, UNKNOWN]
    share[:, UNKNOWN] -= runner
    share[:, ANIMAL] += runner
    cyclist = moving_probability(CYCLIST, table.size_m, np.where(is_young, CYCLIST_SPEED_MPS, speed))
    cyclist *= 1.0 - share[:, AIRBORNE]
    share *= 1.0 - cyclist[:, None]
    share[:, PERSON] += cyclist
    share[(table.last_ns - table.floated_ns <= FLOATED_NS) & (speed >= FLIGHT_MPS)] = np.eye(len(CLASSES))[AIRBORNE]
    best = share.argmax(axis=1).astype(np.int64)
    return best, share[np.arange(len(best)), best]


def moving_probability(body: tuple[Trapezoid, ...], size_m: Float64, speed_mps: Float64) -> Float64:
    """Probability (T,) that boxes (T, 3) at these speeds (T,) are such a body, against an unknown object."""
    length, width, height, speed = body
    fit = trapezoid(size_m[:, 0], *length) * trapezoid(size_m[:, 1], *width) * trapezoid(size_m[:, 2], *height)
    fit = fit * trapezoid(speed_mps, *speed)
    return np.asarray(fit / (fit + UNKNOWN_WEIGHT), np.float64)
