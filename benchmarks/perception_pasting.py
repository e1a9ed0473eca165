"""Returns of labelled persons and cyclists, inserted on free ground at other ranges and thinned by range."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from benchmarks.perception_kitti_data import FRAMES, Label, frame, labels, reflectivity
from benchmarks.perception_scoring import perceive, strict
from geometry.arrays import Bool, Float32, Float64

SENSOR_Z_M = 1.73
FOOT_M = 0.1  # below, a cut contains more road than person
CLEAR_M = 1.0
PERSONS = ("Pedestrian", "Cyclist")


@dataclass(frozen=True)
class Cut:
    """Returns (N, 3) of a label about its centre, seen along x and with the lowest at 0, their reflectivity, and their
    original range."""

    name: str
    points_m: Float32
    reflectivity: Float32
    seen_m: float


@dataclass(frozen=True)
class Pasted:
    """Returns of a scan with an inserted object, their reflectivity, which are its own (N,), and its place."""

    points_m: Float32
    reflectivity: Float32
    is_own: Bool
    range_m: float
    azimuth_rad: float

    @property
    def label(self) -> Label:
        """Box about the own returns."""
        put = self.points_m[self.is_own]
        low, high = put.min(axis=0) - 0.02, put.max(axis=0) + 0.02
        T = np.eye(4)
        T[:3, 3] = [-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]]
        size = high - low
        return Label(-1, "pasted", float(size[0]), float(size[1]), float(size[2]), T)


@cache
def cuts() -> tuple[Cut, ...]:
    """Persons and cyclists of every third frame."""
    found = []
    for number in range(0, FRAMES, 3):
        for label in labels()[number]:
            if label.name in PERSONS:
                inside = label.contains(frame(number))
                own, bright = frame(number)[inside].copy(), reflectivity(number)[inside]
                own[:, 2] -= np.quantile(own[:, 2], 0.01)
                own, bright = own[own[:, 2] > FOOT_M], bright[own[:, 2] > FOOT_M]
                middle = (own[:, :2].min(axis=0) + own[:, :2].max(axis=0)) / 2
                turn = np.arctan2(middle[1], middle[0])
                own[:, :2] = (own[:, :2] - middle) @ np.array(
                    [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
                )
                found.append(Cut(label.name, own.astype(np.float32), bright, float(np.hypot(*middle))))
    return tuple(found)


def pastes(
    n: int, height_m: float | None = None, seed: int = 0, range_m: tuple[float, float] = (8.0, 30.0)
) -> Iterator[Pasted]:
    """`n` scans with an object each; all are scaled to `height_m` if given."""
    rng = np.random.default_rng(seed)
    done = 0
    while done < n:
        number = int(rng.integers(0, FRAMES))
        cut = cuts()[rng.integers(len(cuts()))]
        r, a = rng.uniform(*range_m), rng.uniform(-np.pi, np.pi)
        ground = free_ground(frame(number), r, a)
        own = rng.random(len(cut.points_m)) < (cut.seen_m / r) ** 2
        if ground is None or own.sum() < 10:
            continue
        yield _insert(number, cut, own, height_m / 1.75 if height_m else 1.0, ground, r, a)
        done += 1


def paste_trials(n: int, height_m: float | None = None, seed: int = 0) -> Iterator[bool]:
    """Whether each of `n` inserted objects counts by the strict rule."""
    for pasted in pastes(n, height_m, seed):
        yield strict(pasted.points_m, perceive(pasted.points_m).obstacles, pasted.label).counts


def _insert(number: int, cut: Cut, own: Bool, scale: float, ground_m: float, r: float, a: float) -> Pasted:
    """The scan with returns of a cut at a place, without what they hide."""
    points, c, s = frame(number), np.cos(a), np.sin(a)
    level = cut.points_m[own, :2] @ np.array([[c, s], [-s, c]]) + [r * c, r * s]
    put = np.concatenate([level, cut.points_m[own, 2:] * scale + ground_m], axis=1).astype(np.float32)
    along, aside = _along(points, a)
    seen = ~((along > r) & (aside < 0.25) & (points[:, 2] < put[:, 2].max()))
    return Pasted(
        np.concatenate([points[seen], put]),
        np.concatenate([reflectivity(number)[seen], cut.reflectivity[own]]),
        np.repeat([False, True], [int(seen.sum()), len(put)]), r, a,
    )  # fmt: skip


def free_ground(points: Float32, r: float, a: float) -> float | None:
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


def _along(points: Float32, a: float) -> tuple[Float64, Float64]:
    along = points[:, 0] * np.cos(a) + points[:, 1] * np.sin(a)
    return along, np.abs(-points[:, 0] * np.sin(a) + points[:, 1] * np.cos(a))
