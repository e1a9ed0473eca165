"""Returns of labelled persons and cyclists, inserted on free ground at other ranges and thinned by range."""

from collections.abc import Iterator
from functools import cache

import numpy as np

from benchmarks.perception_kitti_data import FRAMES, Label, frame, labels
from benchmarks.perception_scoring import perceive, strict
from geometry.arrays import Float32

SENSOR_Z_M = 1.73
FOOT_M = 0.1  # below, a cut contains more road than person
CLEAR_M = 1.0


@cache
def cuts() -> tuple[tuple[Label, Float32, float], ...]:
    """Label, returns about its centre with the lowest at 0, and their original range."""
    found = []
    for number in range(0, FRAMES, 3):
        for label in labels()[number]:
            if label.name in ("Pedestrian", "Cyclist"):
                own = frame(number)[label.contains(frame(number))].copy()
                own[:, 2] -= np.quantile(own[:, 2], 0.01)
                own = own[own[:, 2] > FOOT_M]
                middle = (own[:, :2].min(axis=0) + own[:, :2].max(axis=0)) / 2
                turn = np.arctan2(middle[1], middle[0])
                own[:, :2] = (own[:, :2] - middle) @ np.array(
                    [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
                )
                found.append((label, own.astype(np.float32), float(np.hypot(*middle))))
    return tuple(found)


def paste_trials(n: int, height_m: float | None = None, seed: int = 0) -> Iterator[bool]:
    """Whether each of `n` pasted objects counts; all are scaled to `height_m` if given."""
    rng = np.random.default_rng(seed)
    done = 0
    while done < n:
        points = frame(int(rng.integers(0, FRAMES)))
        _label, own, seen_m = cuts()[rng.integers(len(cuts()))]
        r, a = rng.uniform(8.0, 30.0), rng.uniform(-np.pi, np.pi)
        ground = _free_ground(points, r, a)
        own = own[rng.random(len(own)) < (seen_m / r) ** 2]
        if ground is None or len(own) < 10:
            continue
        z = own[:, 2:] * (height_m / 1.75 if height_m else 1.0)
        c, s = np.cos(a), np.sin(a)
        level = own[:, :2] @ np.array([[c, s], [-s, c]]) + [r * c, r * s]
        put = np.concatenate([level, z + ground], axis=1).astype(np.float32)
        yield _counts(_without_shadow(points, put, r, a), put)
        done += 1


def _free_ground(points: Float32, r: float, a: float) -> float | None:
    """Height of the ground at a free and visible position, else None."""
    at = r * np.array([np.cos(a), np.sin(a)])
    about = points[np.hypot(*(points[:, :2] - at).T) < CLEAR_M + 0.5]
    if len(about) < 8:
        return None
    ground = float(np.quantile(about[:, 2], 0.1))
    along, aside = _along(points, a)
    way = (along > 2.8) & (along < r - 0.5) & (aside < 0.4) & (points[:, 2] > ground + 0.3)
    empty = about[:, 2].max() < ground + 0.25 and not way.any()
    return ground if empty and abs(ground + SENSOR_Z_M) < 0.8 else None


def _along(points: Float32, a: float) -> tuple[np.ndarray, np.ndarray]:
    along = points[:, 0] * np.cos(a) + points[:, 1] * np.sin(a)
    return along, np.abs(-points[:, 0] * np.sin(a) + points[:, 1] * np.cos(a))


def _without_shadow(points: Float32, put: Float32, r: float, a: float) -> Float32:
    along, aside = _along(points, a)
    return np.asarray(points[~((along > r) & (aside < 0.25) & (points[:, 2] < put[:, 2].max()))], np.float32)


def _counts(points: Float32, put: Float32) -> bool:
    """Strict rule with the box about the inserted returns."""
    low, high = put.min(axis=0) - 0.02, put.max(axis=0) + 0.02
    T = np.eye(4)
    T[:3, 3] = [-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]]
    size = high - low
    box = Label(-1, "pasted", float(size[0]), float(size[1]), float(size[2]), T)
    combined = np.concatenate([points, put])
    return strict(combined, perceive(combined).obstacles, box).counts
