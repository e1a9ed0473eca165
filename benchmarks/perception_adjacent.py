"""Benchmark of segmentation: persons close to a wall, car, hedge or person, inserted in KITTI scans and ray-cast.

    ./headland benchmark perception_adjacent [--trials 60] [--gaps 0.2 0.3 0.4 0.5]

A person stands 5 to 20 m away in front of the structure or beside its end, in four scans at 10 Hz. Own: at the end a
confirmed track about the person is no longer than 1.5 m. Possibly: the track that holds its returns is a person or of
unknown class. Scenes in which other things hide the person (fewer than 10 returns) are drawn again. Persons are returns
of pedestrians of the recording, or cast like the structure: a body of cylinders.
"""

import argparse
import os
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from benchmarks.perception_kitti_data import (
    FRAMES,
    LIDAR_XYZ_M,
    PERIOD_NS,
    START_NS,
    frame,
    has_frames,
    sensor,
)
from benchmarks.perception_pasting import cuts, free_ground
from benchmarks.perception_scoring import Result, perceive, track_still
from benchmarks.recordings import DATA
from configs.vehicle import Lidar
from geometry.arrays import Float32, Float64
from messages.perception import ObstacleClass, Tracks

SCANS, NOISE_M = 4, 0.02
MIN_RETURNS = 10  # of a person who is not hidden
LONGEST_M = 1.5
RANGE_M = (5.0, 20.0)
POSSIBLY = (ObstacleClass.PERSON, ObstacleClass.UNKNOWN, ObstacleClass.ANIMAL)
# level boxes about the middle of the face that a person stands before: x out of the face, y along it (m)
Boxes = tuple[tuple[tuple[float, float], ...], ...]
WALL: Boxes = (((-0.2, 0.0), (-3.0, 3.0), (0.0, 2.2)),)
CAR: Boxes = (((-1.75, 0.0), (-2.15, 2.15), (0.25, 0.85)), ((-1.65, -0.15), (-1.2, 1.0), (0.85, 1.45)))
HEDGE: Boxes = (((-0.9, 0.0), (-3.0, 3.0), (0.0, 1.6)),)
OTHER: Boxes = (((-0.3, 0.0), (-0.25, 0.25), (0.0, 1.4)), ((-0.25, -0.05), (-0.1, 0.1), (1.4, 1.7)))
# boxes, mean depth of a return
STRUCTURES = {"wall": (WALL, 0.0), "car": (CAR, 0.0), "hedge": (HEDGE, 0.12), "person": (OTHER, 0.0)}
# cylinders of a person: place across (m), from and to height, radius
BODY = ((-0.1, 0.0, 0.85, 0.08), (0.1, 0.0, 0.85, 0.08), (0.0, 0.8, 1.45, 0.2), (0.0, 1.48, 1.75, 0.1))


@dataclass(frozen=True)
class Scene:
    """Beams (N, 3) from the lidar and the range at which each returns, the structure's place, and its turn."""

    directions: Float64
    ranges_m: Float64
    origin_m: Float64
    face_m: Float64
    turn_rad: float


def box_ranges(scene: Scene, boxes: Boxes, depth_m: float, rng: np.random.Generator) -> Float64:
    """Range (N,) of the structure, infinite where a beam misses it."""
    d, o = _local(scene)
    nearest = np.full(len(d), np.inf)
    for limits in boxes:
        low, high = np.array(limits).T
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (low - o) / d, (high - o) / d
        enter, leave = np.fmin(a, b).max(axis=1), np.fmax(a, b).min(axis=1)
        if depth_m > 0.0:
            enter = enter + rng.exponential(depth_m, len(enter))
        nearest = np.where((enter < leave) & (enter > 0.0), np.minimum(nearest, enter), nearest)
    return nearest


def body_ranges(scene: Scene, at_m: tuple[float, float]) -> Float64:
    """Range (N,) of a body at a place of the structure's frame, which faces along it."""
    d, o = _local(scene)
    nearest = np.full(len(d), np.inf)
    for y, low, high, radius in BODY:
        p = o[:2] - (at_m[0], at_m[1] + y)
        a, b, c = (d[:, :2] ** 2).sum(axis=1), d[:, :2] @ p, p @ p - radius**2
        with np.errstate(invalid="ignore"):
            t = (-b - np.sqrt(b * b - a * c)) / a
        z = o[2] + t * d[:, 2]
        nearest = np.where((t > 0.0) & (z >= low) & (z <= high), np.fmin(nearest, t), nearest)
    return nearest


def _local(scene: Scene) -> tuple[Float64, Float64]:
    """Directions and origin of the beams in the structure's frame."""
    c, s = np.cos(scene.turn_rad), np.sin(scene.turn_rad)
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return scene.directions @ R.T, R @ (scene.origin_m - scene.face_m)


def kitti_scene(rng: np.random.Generator) -> Scene | None:
    """A recorded scan about a free place, without what stood where the structure will be."""
    points = frame(int(rng.integers(0, FRAMES))).astype(np.float64)
    r, a = rng.uniform(*RANGE_M), rng.uniform(-np.pi, np.pi)
    ground = free_ground(points.astype(np.float32), r, a)
    if ground is None:
        return None
    at = np.array([r * np.cos(a), r * np.sin(a), ground])
    about = np.hypot(*(points[:, :2] - at[:2]).T) < 4.0
    points = points[~(about & (points[:, 2] > ground + 0.2))]
    ranges = np.linalg.norm(points, axis=1)
    known = ranges > 0.5
    turn = a + np.pi + rng.uniform(-1.0, 1.0)  # the face looks towards the lidar, up to 57° aside
    return Scene(points[known] / ranges[known, None], ranges[known], np.zeros(3), at, turn)


def level_scene(lidar: Lidar, rng: np.random.Generator) -> Scene:
    """All beams of a lidar over level ground, in its own frame."""
    el = np.radians(np.array(lidar.elevation_deg))[:, None]
    az = np.linspace(-np.pi, np.pi, lidar.columns, endpoint=False)[None]
    d = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el) + 0.0 * az], axis=2).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        ranges = np.where(d[:, 2] < 0.0, -LIDAR_XYZ_M[2] / d[:, 2], np.inf)
    r, a = rng.uniform(*RANGE_M), rng.uniform(-np.pi, np.pi)
    at = np.array([r * np.cos(a), r * np.sin(a), -LIDAR_XYZ_M[2]])
    return Scene(d, ranges, np.zeros(3), at, a + np.pi + rng.uniform(-1.0, 1.0))


def scans_of(
    scene: Scene, structure: str, gap_m: float, is_cut: bool, rng: np.random.Generator
) -> tuple[list[Float32], Float64] | None:
    """Four scans, and the place of the person, who stands before the face or, one time in three, beside its end.

    None: something hides the person.
    """
    boxes, depth_m = STRUCTURES[structure]
    end_m = max(high for _, (_, high), _ in boxes)
    pedestrians = [cut for cut in cuts() if cut.name == "Pedestrian"]
    cut = pedestrians[int(rng.integers(len(pedestrians)))]
    is_beside, aside = rng.random() < 1.0 / 3.0, rng.uniform(-0.6, 0.6) * end_m
    c, s = np.cos(scene.turn_rad), np.sin(scene.turn_rad)
    to_scene = np.array([[c, s], [-s, c]])
    azimuth = float(np.arctan2(scene.face_m[1], scene.face_m[0]))
    c, s = np.cos(azimuth), np.sin(azimuth)
    level = cut.points_m[:, :2] @ np.array([[c, s], [-s, c]])
    reach_x, reach_y = -(level @ to_scene.T).min(axis=0) if is_cut else (0.2, 0.2)  # of the person, to the structure
    at = (-0.2, end_m + gap_m + reach_y) if is_beside else (gap_m + reach_x, aside)
    place = scene.face_m + np.append(np.array(at) @ to_scene, 0.0)
    away = float(np.hypot(*place[:2]))
    scans = []
    for _ in range(SCANS):
        ranges = np.minimum(scene.ranges_m, box_ranges(scene, boxes, depth_m, rng))
        body, own = body_ranges(scene, at), np.zeros((0, 3))
        if is_cut:
            kept = rng.random(len(cut.points_m)) < (cut.seen_m / away) ** 2
            own = np.column_stack([level[kept] + place[:2], cut.points_m[kept, 2] + place[2]])
            ranges = np.where(body < ranges, np.inf, ranges)
        if (len(own) if is_cut else (body < ranges).sum()) < MIN_RETURNS:
            return None
        ranges = ranges if is_cut else np.minimum(ranges, body)
        seen = ranges < sensor().range_m[1]
        points = scene.directions[seen] * (ranges[seen] + rng.normal(0.0, NOISE_M, seen.sum()))[:, None]
        scans.append(np.concatenate([points, own]).astype(np.float32))
    return scans, place


def outcome(scans: list[Float32], place_m: Float64) -> str:
    """own, possibly, or the class of the track in which the person is lost."""
    results: list[Result] = [perceive(one, START_NS + k * PERIOD_NS) for k, one in enumerate(scans)]
    tracks: Tracks = track_still(results)
    at = place_m + LIDAR_XYZ_M
    best, text = np.inf, "none"
    for one in tracks.tracks:
        if not one.is_confirmed:
            continue
        c, s = np.cos(one.yaw_rad), np.sin(one.yaw_rad)
        d = at[:2] - one.p_odom_m[:2]
        along, across = abs(c * d[0] + s * d[1]), abs(c * d[1] - s * d[0])
        outside = np.hypot(max(along - one.size_m[0] / 2, 0.0), max(across - one.size_m[1] / 2, 0.0))
        if outside < 0.4 and one.size_m[0] <= LONGEST_M and np.hypot(*d) < 0.6:
            return "own"
        if outside < min(best, 0.4):
            best, text = outside, "possibly" if one.label in POSSIBLY else one.label.value
    return text


def main() -> None:
    """Prints one line per structure, gap and kind of person."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--gaps", type=float, nargs="+", default=[0.2, 0.3, 0.4, 0.5])
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if not has_frames():
        raise SystemExit(f"no recording under {DATA}; set HEADLAND_DATA to its folder")
    makers: dict[str, tuple[Callable[[np.random.Generator], Scene | None], bool]] = {
        "recorded scan, recorded person": (kitti_scene, True),
        "recorded scan, cast person": (kitti_scene, False),
        "cast": (lambda rng: level_scene(sensor(), rng), False),
    }
    total: Counter[str] = Counter()
    for kind, (make, is_cut) in makers.items():
        for structure in STRUCTURES:
            for gap in options.gaps:
                rng = np.random.default_rng([options.seed, round(100 * gap), len(structure)])
                found: Counter[str] = Counter()
                while found.total() < options.trials:
                    scene = make(rng)
                    seen = None if scene is None else scans_of(scene, structure, gap, is_cut, rng)
                    if seen is not None:
                        found[outcome(*seen)] += 1
                total += found
                rest = ", ".join(f"{name} {n}" for name, n in found.most_common() if name not in ("own", "possibly"))
                n = found.total()
                sys.stdout.write(
                    f"{kind:<32} {structure:<6} {gap:.1f} m   own {found['own']:>3} possibly {found['possibly']:>3} "
                    f"of {n}   {rest}\n"
                )
                sys.stdout.flush()
    sys.stdout.write(f"all: own {total['own']}, possibly {total['possibly']} of {total.total()}\n")


if __name__ == "__main__":
    main()
