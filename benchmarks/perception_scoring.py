"""Evaluation of obstacles against labels: strict rule, inserted objects, gaps, latencies and false stops."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from time import perf_counter
from typing import TypeVar

import numpy as np

from benchmarks.perception_kitti_data import (
    BUMPER_M,
    FRAMES,
    LIDAR_XYZ_M,
    PERIOD_NS,
    START_NS,
    Label,
    car,
    configs,
    frame,
    labels,
    scan_of,
    sensor,
)  # fmt: skip
from geometry.arrays import Float32, Float64
from geometry.transforms import invert
from messages.message import Message
from messages.motion import Odometry
from messages.perception import LidarGround, Obstacles, SensorHealth, Track, Tracks
from perception.fusion.tracker import Tracker
from perception.lidar.obstacles import LidarObstacles

M = TypeVar("M", bound=Message)
HALF_WIDTH_M = 1.4
SCAN, OBSTACLES, GROUND = "lidar/top", "obstacles/lidar_top", "ground/top"


class Feed:
    """Inbox with one new message per topic."""

    def __init__(self, **messages: Message) -> None:
        self._messages = {name.replace("__", "/"): message for name, message in messages.items()}

    def last(self, topic: str, kind: type[M]) -> M | None:
        """The message of a topic."""
        message = self._messages.get(topic)
        return message if isinstance(message, kind) else None

    def latest(self, topic: str, kind: type[M]) -> M | None:
        """As `last`: nothing is stale."""
        return self.last(topic, kind)

    def at(self, topic: str, kind: type[M], stamp_ns: int) -> M | None:
        """As `last`, for any time."""
        return self.last(topic, kind)

    def all(self, topic: str, kind: type[M]) -> tuple[M, ...]:
        """The message as the only one."""
        message = self.last(topic, kind)
        return () if message is None else (message,)


@dataclass(frozen=True)
class Result:
    """Output of the node for one scan."""

    points_m: Float32
    obstacles: Obstacles
    ground: LidarGround
    health: SensorHealth


@cache
def new_node() -> LidarObstacles:
    """Node for the recording car."""
    return LidarObstacles("top", sensor(), car(), None, configs()[0])


def perceive(points_m: Float32, stamp_ns: int = START_NS) -> Result:
    """Processes one scan by the node's pipeline."""
    node, scan = new_node(), scan_of(points_m, stamp_ns)
    ground, obstacles, health = node._pipeline.run(scan, None, node.name, 0)
    return Result(scan.points_m, obstacles, ground, health)


@dataclass(frozen=True)
class Score:
    """The two shares of the strict rule for one object, its number of returns and the range of its nearest one."""

    returns: int
    edge_m: float
    share: float
    near: float

    @property
    def counts(self) -> bool:
        """Whether one cluster has half of the returns in the box, and half of that cluster lies about the box."""
        return self.share >= 0.5 and self.near >= 0.5


def strict(points_m: Float32, obstacles: Obstacles, label: Label) -> Score:
    """The score of the cluster with most returns in the box."""
    inside = label.contains(points_m)
    n = int(inside.sum())
    edge = float(np.hypot(points_m[inside, 0], points_m[inside, 1]).min()) if n else np.inf
    sizes = np.diff(obstacles.offsets)
    hits = np.bincount(np.repeat(np.arange(len(sizes)), sizes), inside[obstacles.indices], len(sizes))
    if n == 0 or len(sizes) == 0 or hits.max() == 0:
        return Score(n, edge, 0.0, 0.0)
    k = int(hits.argmax())
    own = points_m[obstacles.indices[obstacles.offsets[k] : obstacles.offsets[k + 1]]]
    return Score(n, edge, float(hits[k]) / n, float(label.contains(own, 0.5).mean()))


def thin(points_m: Float32, share: float, rng: np.random.Generator) -> Float32:
    """A random share of the returns."""
    return points_m if share >= 1.0 else points_m[rng.random(len(points_m)) < share]


def recall(
    share: float = 1.0, seed: int = 0, least: int = 10, numbers: Sequence[int] = range(FRAMES)
) -> Iterator[tuple[int, Label, Score]]:
    """Frame, label and score of each object that has enough returns before thinning."""
    rng = np.random.default_rng(seed)
    for number in numbers:
        full = frame(number)
        points = thin(full, share, rng)
        result = perceive(points)
        for label in labels().get(number, ()):
            inside = label.contains(full)
            if inside.sum() >= least:
                score = strict(points, result.obstacles, label)
                edge = float(np.hypot(full[inside, 0], full[inside, 1]).min())
                yield number, label, Score(score.returns, edge, score.share, score.near)


def gap_errors() -> Float64:
    """Error of the gap before the bumper for each detected labelled object."""
    errors = []
    for number in range(FRAMES):
        result = perceive(frame(number))
        for label in labels().get(number, ()):
            inside = label.contains(result.points_m)
            o = result.obstacles
            sizes = np.diff(o.offsets)
            hits = np.bincount(np.repeat(np.arange(len(sizes)), sizes), inside[o.indices], len(sizes))
            if inside.sum() < 10 or hits.max() < 0.5 * inside.sum():
                continue
            # ground returns at the foot of the box are no part of the object
            true = result.points_m[inside & (result.ground.is_obstacle_point == 1)]
            errors.append(_gap(o.nearest_base_m[hits.argmax()] - LIDAR_XYZ_M) - min(_gap(p) for p in true))
    return np.array(errors)


def _gap(p_lidar_m: Float64 | Float32) -> float:
    aside = max(abs(float(p_lidar_m[1])) - car().body.width_m / 2, 0.0)
    return float(np.hypot(float(p_lidar_m[0]) - BUMPER_M, aside))


@cache
def poses() -> tuple[Float64, ...]:
    """`T_odom_base` of each frame by KISS-ICP, since the recording has no speed."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.config.config import MappingConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig(mapping=MappingConfig(voxel_size=0.5))
    config.data.max_range, config.data.deskew = 60.0, False
    config.registration.max_num_threads = 1
    icp = KissICP(config)
    T = np.eye(4)
    T[:3, 3] = LIDAR_XYZ_M
    found = []
    for number in range(FRAMES):
        icp.register_frame(frame(number).astype(np.float64), np.zeros(0))
        found.append(T @ icp.last_pose @ invert(T))
    return tuple(found)


@dataclass(frozen=True)
class Drive:
    """The recording processed by both nodes: one entry per scan."""

    numbers: tuple[int, ...]
    results: tuple[Result, ...]
    tracks: tuple[Tracks, ...]
    tracker_s: tuple[float, ...]


def drive(numbers: Sequence[int], change: Callable[[int, Float32], Float32] = lambda _, p: p) -> Drive:
    """Processes frames in order, after `change`, by node and tracker at the times of the frames."""
    return track(numbers, [perceive(change(n, frame(n)), START_NS + n * PERIOD_NS) for n in numbers])


def track(numbers: Sequence[int], results: Sequence[Result]) -> Drive:
    """Tracks the results of frames in order."""
    tracker = Tracker([OBSTACLES], configs()[1])
    published: list[Tracks] = []
    walls: list[float] = []
    for number, result in zip(numbers, results, strict=True):
        stamp = START_NS + number * PERIOD_NS
        odom = Odometry(stamp, poses()[number], 0.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))
        start = perf_counter()
        out = dict(tracker.step(stamp, Feed(obstacles__lidar_top=result.obstacles, odom=odom)))["tracks"]
        walls.append(perf_counter() - start)
        assert isinstance(out, Tracks)
        published.append(out)
    return Drive(tuple(numbers), tuple(results), tuple(published), tuple(walls))


def track_still(results: Sequence[Result]) -> Tracks:
    """Tracks after the results of a machine that stands."""
    tracker, out = Tracker([OBSTACLES], configs()[1]), None
    for result in results:
        stamp = result.obstacles.stamp_ns
        odom = Odometry(stamp, np.eye(4), 0.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))
        out = dict(tracker.step(stamp, Feed(obstacles__lidar_top=result.obstacles, odom=odom)))["tracks"]
    assert isinstance(out, Tracks)
    return out


def latencies(run: Drive) -> dict[int, tuple[int, float]]:
    """By object: frame of the first scan with ten returns, and seconds from it until a confirmed track."""
    first: dict[int, int] = {}
    found: dict[int, tuple[int, float]] = {}
    for number, result, tracks in zip(run.numbers, run.results, run.tracks, strict=True):
        for label in labels().get(number, ()):
            inside = label.contains(result.points_m)
            if inside.sum() >= 10:
                first.setdefault(label.id, number)
            if label.id in first and label.id not in found and _is_tracked(tracks, label, poses()[number]):
                found[label.id] = (first[label.id], (number - first[label.id]) * PERIOD_NS * 1e-9)
    return {k: found.get(k, (f, np.inf)) for k, f in first.items()}


def classes(run: Drive) -> Counter[tuple[str, str]]:
    """Number of tracked objects with ten returns, over all scans, by the name of their label and the track's class."""
    found: Counter[tuple[str, str]] = Counter()
    for number, result, tracks in zip(run.numbers, run.results, run.tracks, strict=True):
        for label in labels().get(number, ()):
            if label.contains(result.points_m).sum() >= 10 and (own := _tracks_of(tracks, label, poses()[number])):
                found[label.name, own[0].label.value] += 1
    return found


def _is_tracked(tracks: Tracks, label: Label, T_odom_base: Float64) -> bool:
    return len(_tracks_of(tracks, label, T_odom_base)) > 0


def _tracks_of(tracks: Tracks, label: Label, T_odom_base: Float64) -> list[Track]:
    """Confirmed tracks in a label's box enlarged by 0.5 m, the nearest to its centre first."""
    T = invert(T_odom_base)
    own = []
    for track in tracks.tracks:
        at = (T @ [*track.p_odom_m, 1.0])[:3] - LIDAR_XYZ_M
        if track.is_confirmed and label.contains(np.array([at], np.float32), 0.5).any():
            own.append((float(np.hypot(*(label.T_box_lidar @ [*at, 1.0])[:2])), track))
    return [track for _, track in sorted(own, key=lambda pair: pair[0])]


def false_stops(run: Drive, half_width_m: float = HALF_WIDTH_M) -> list[tuple[int, int, float]]:
    """Frame, track and distance of confirmed tracks in the volume driven through later, away from all labels."""
    found = []
    for number, result, tracks in zip(run.numbers, run.results, run.tracks, strict=True):
        T = poses()[number]
        later = np.array([(invert(T) @ poses()[n])[:2, 3] for n in range(number, FRAMES)])
        o = result.obstacles
        p_odom = o.center_base_m @ T[:3, :3].T + T[:3, 3]
        for track in tracks.tracks:
            if not track.is_confirmed or len(p_odom) == 0:
                continue
            k = int(np.hypot(*(p_odom[:, :2] - track.p_odom_m[:2]).T).argmin())
            points = o.points_base_m[o.offsets[k] : o.offsets[k + 1]]
            inside = _in_path(points, later, half_width_m)
            lidar = points[inside] - np.array(LIDAR_XYZ_M, np.float32)
            near = np.zeros(len(lidar), bool)
            for label in labels().get(number, ()):
                near |= label.contains(lidar, 0.5)
            if (~near).sum() >= 3:
                found.append((number, track.id, float(lidar[~near, 0].min())))
    return found


def _in_path(points_m: Float32, later_m: Float64, half_width_m: float) -> np.ndarray:
    """Which points the front of the car sweeps: ahead of the bumper now, within the half width of its axle's path."""
    front = car().body.front_m
    inside = np.zeros(len(points_m), bool)
    for a, b in itertools.pairwise(later_m):
        along = b - a
        length = float(np.hypot(*along))
        if length < 0.02:
            continue
        u = along / length
        d = points_m[:, :2] - a
        s, aside = d @ u, np.abs(d[:, 0] * u[1] - d[:, 1] * u[0])
        inside |= (s > front) & (s < front + length) & (aside < half_width_m)
    return inside & (points_m[:, 0] > front)
