"""Benchmark of lidar perception in bad weather: KITTI scans degraded by published models (benchmarks/weather.py).

    ./headland benchmark perception_weather [--out runs/perception_weather] [--only TEXT] [--pastes 160]

Each row: strict recall of labelled objects up to 20 m and from there to 30 m; of the 40 scans of the drive at 10 Hz
those with a confirmed track of clutter in a straight tube of 20 x 2.8 m ahead (tracks), all such tracks within 20 m
(false), and scans with a confirmed return of clutter in the tube in the supervisor's lidar source (raw); detection
range stated by both, medians; of the persons inserted within the range that perception states for their sector, those
that are not found by the strict rule; and those found of all by range.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.spatial import KDTree

from benchmarks.perception_kitti_data import (
    BUMPER_M,
    FRAMES,
    LIDAR_XYZ_M,
    PERIOD_NS,
    START_NS,
    car,
    frame,
    has_frames,
    labels,
    reflectivity,
    scan_of,
    sensor,
)  # fmt: skip
from benchmarks.perception_pasting import pastes
from benchmarks.perception_scoring import Result, perceive, poses, strict, track
from benchmarks.recordings import DATA
from benchmarks.weather import WEATHERS, Scan, Weather, recorded
from configs.strict import CONFIGS, parse, read_yaml
from geometry.arrays import Bool, Float32
from geometry.pose2 import from_frame
from geometry.transforms import yaw_of
from messages.perception import SensorHealth
from messages.sensors import LidarScan
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import Box, footprint_of

TUBE_M, HALF_WIDTH_M = 20.0, 1.4
MATCH_M = 0.6  # of a track and its cluster
BINS_M = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
FOUND = 0.95  # share of the inserted persons
LEAST_RETURNS = 10  # of an object as recorded


@dataclass
class Row:
    """Results of one weather; `found` and `inserted` by range of `BINS_M`."""

    weather: str
    recall_20: tuple[int, int]
    recall_30: tuple[int, int]
    track_stops: int
    false_tracks: int
    raw_stops: int
    stated_m: float
    supervisor_m: float
    beyond: tuple[int, int]
    found: list[int]
    inserted: list[int]


def row_of(name: str, weather: Weather, inserted: int) -> Row:
    """All measures of one weather."""
    scans = [_degraded(weather, recorded(frame(n), reflectivity(n)), n) for n in range(FRAMES)]
    results = [perceive(scan.points_m, START_NS + k * PERIOD_NS) for k, scan in enumerate(scans)]
    near, far = ([s for edge, s in _recall(results) if low <= edge < high] for low, high in ((0, 20), (20, 30)))
    stops, tracks = _clutter_tracks(scans, results)
    raw_stops, ranges = _supervisor(scans)
    stated, found, total, missed = [], np.zeros((2, len(BINS_M) - 1), int), 0, 0
    for k, pasted in enumerate(pastes(inserted, seed=7, range_m=(BINS_M[0], BINS_M[-1]))):
        scan = _degraded(weather, recorded(pasted.points_m, pasted.reflectivity), 100 + k)
        result = perceive(scan.points_m)
        is_found = strict(scan.points_m, result.obstacles, pasted.label).counts
        at = int(np.searchsorted(BINS_M, pasted.range_m)) - 1
        found[:, at] += is_found, 1
        stated_m = _stated(result.health, pasted.azimuth_rad)
        stated.append(stated_m)
        total += pasted.range_m <= stated_m
        missed += pasted.range_m <= stated_m and not is_found
    return Row(
        name, (sum(near), len(near)), (sum(far), len(far)), stops, tracks, raw_stops,
        float(np.median(stated)), float(np.median(ranges)), (missed, total), *found.tolist(),
    )  # fmt: skip


def _degraded(weather: Weather, scan: Scan, seed: int) -> Scan:
    return weather(scan, sensor(), np.random.default_rng(seed))


def _recall(results: list[Result]) -> Iterator[tuple[float, bool]]:
    """Range of the nearest recorded return of each label, and whether it counts."""
    for number, result in enumerate(results):
        for label in labels().get(number, ()):
            own = frame(number)[label.contains(frame(number))]
            if len(own) >= LEAST_RETURNS:
                yield (
                    float(np.hypot(own[:, 0], own[:, 1]).min()),
                    strict(result.points_m, result.obstacles, label).counts,
                )


def _clutter_tracks(scans: list[Scan], results: list[Result]) -> tuple[int, int]:
    """Scans of a drive with a confirmed track in the tube whose cluster is mostly clutter; number of all such tracks
    within reach."""
    run = track(range(len(scans)), results)
    stops, wrong = 0, set()
    for number, scan, result, tracks in zip(run.numbers, scans, run.results, run.tracks, strict=True):
        o, T = result.obstacles, poses()[number]
        sizes = np.diff(o.offsets)
        which = np.repeat(np.arange(len(sizes)), sizes)
        is_false = np.bincount(which, scan.is_clutter[o.indices], len(sizes)) > 0.5 * sizes
        centers = o.center_base_m @ T[:3, :3].T + T[:3, 3]
        in_tube = np.bincount(which, _is_in_tube(o.points_base_m), len(sizes)) > 0
        is_near = np.hypot(o.center_base_m[:, 0] - LIDAR_XYZ_M[0], o.center_base_m[:, 1]) < TUBE_M
        stop = False
        for one in tracks.tracks:
            if not one.is_confirmed or len(sizes) == 0:
                continue
            away = np.hypot(*(centers[:, :2] - one.p_odom_m[:2]).T)
            k = int(away.argmin())
            if away[k] < MATCH_M and is_false[k] and is_near[k]:
                wrong.add(one.id)
                stop |= bool(in_tube[k])
        stops += stop
    return stops, len(wrong)


def _supervisor(scans: list[Scan]) -> tuple[int, list[float]]:
    """Scans of a drive with a confirmed return of the supervisor in the tube that is clutter; its detection ranges."""
    source, stops, ranges = _source(), 0, []
    for k, scan in enumerate(scans):
        pose = _update(source, scan.points_m, k)
        ranges.append(source.detection_range_m(1))
        hits = np.column_stack([from_frame(pose, source.hits_odom_m[:, :2]), source.hits_odom_m[:, 2]])
        hits = hits[_is_in_tube(hits)]
        clutter, real = (KDTree(scan.points_m[which] + LIDAR_XYZ_M) if which.any() else None
                         for which in (scan.is_clutter, ~scan.is_clutter))  # fmt: skip
        if len(hits) and clutter is not None and real is not None:
            stops += bool((clutter.query(hits)[0] < np.minimum(real.query(hits)[0], MATCH_M)).any())
    return stops, ranges


def _is_in_tube(points_m: np.ndarray) -> Bool:
    """Which points (N, 3) of base lie ahead of the car."""
    ahead = points_m[:, 0] - _front_m()
    return np.asarray((ahead > 0.0) & (ahead < TUBE_M) & (np.abs(points_m[:, 1]) < HALF_WIDTH_M))


def _source() -> LidarSource:
    config = parse(SupervisorConfig, read_yaml(CONFIGS / "stack/safety.yaml"), "stack/safety.yaml")
    return LidarSource("top", sensor(), footprint_of(car(), None), config)


def _update(source: LidarSource, points: Float32, k: int) -> np.ndarray:
    """Processes scan `k`; returns the pose of base."""
    T = poses()[k]
    pose = np.array([T[0, 3], T[1, 3], yaw_of(T)])
    area = Box((-5.0, _front_m() + TUBE_M), (-6.0, 6.0))
    scan: LidarScan = scan_of(points, START_NS + k * PERIOD_NS)
    source.update(scan, pose, Motion(0.0, 0.0), 0.0, area)
    return pose


def _front_m() -> float:
    return LIDAR_XYZ_M[0] + BUMPER_M


def _stated(health: SensorHealth, azimuth_rad: float) -> float:
    k = int(np.searchsorted(health.sector_edges_rad, azimuth_rad)) - 1
    return float(health.detection_range_m[max(k, 0)])


HEADER = (
    f"{'weather':<22} {'<= 20 m':>9} {'to 30 m':>9} {'tracks':>7} {'false':>6} {'raw':>4} {'stated':>7} {'superv.':>7} "
    f"{'missed within stated':>21}   found of inserted at 5-10, 10-15, ... 35-40 m"
)


def text_of(row: Row) -> str:
    """One line of the table."""
    shares = " ".join(f"{a}/{b}" for a, b in zip(row.found, row.inserted, strict=True))
    pairs = [f"{a}/{b}" for a, b in (row.recall_20, row.recall_30, row.beyond)]
    return (
        f"{row.weather:<22} {pairs[0]:>9} {pairs[1]:>9} {row.track_stops:>7} {row.false_tracks:>6} {row.raw_stops:>4} "
        f"{row.stated_m:>5.0f} m {row.supervisor_m:>5.0f} m {pairs[2]:>21}   {shares}"
    )


def found_m(row: Row) -> float:
    """Range up to which at least `FOUND` of the inserted persons are found."""
    end_m = 0.0
    for high, found, n in zip(BINS_M[1:], row.found, row.inserted, strict=True):
        if n and found < FOUND * n:
            break
        end_m = high if n else end_m
    return end_m


def draw(rows: list[Row], path: Path) -> None:
    """Picture of all rows: scans with clutter ahead, and detection ranges."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 0.35 * len(rows) + 1.5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    y = np.arange(len(rows))
    left.barh(y - 0.2, [row.track_stops for row in rows], 0.4, label="confirmed track of clutter")
    left.barh(y + 0.2, [row.raw_stops for row in rows], 0.4, label="confirmed return of clutter (supervisor)")
    left.set_yticks(y, [row.weather for row in rows])
    left.invert_yaxis()
    left.set_xlim(0, FRAMES)
    left.set_xlabel(f"scans of {FRAMES} with clutter in the tube ahead")
    right.plot([found_m(row) for row in rows], y, "k|", markersize=14, label=f"persons found ({FOUND:.0%})")
    right.plot([row.stated_m for row in rows], y, "o", label="stated by perception (median)")
    right.plot([row.supervisor_m for row in rows], y, "x", label="stated by the supervisor (median)")
    right.set_xlim(0, 80)
    right.set_xlabel("range in m; persons are inserted up to 40 m")
    for axes in (left, right):
        axes.legend(fontsize="small")
    figure.savefig(path, dpi=100)


def main() -> None:
    """Prints one line per weather."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, help="folder for rows.json and weather.png; its rows are not computed again"
    )
    parser.add_argument("--only", default="", help="weathers whose name contains this")
    parser.add_argument("--pastes", type=int, default=160, help="persons inserted per weather")
    options = parser.parse_args()
    if not has_frames():
        raise SystemExit(f"no recording under {DATA}; set HEADLAND_DATA to its folder")
    rows: dict[str, Row] = {}
    kept = options.out / "rows.json" if options.out else None
    if kept is not None and kept.exists():
        rows = {values["weather"]: Row(**values) for values in json.loads(kept.read_text())}
    sys.stdout.write(HEADER + "\n")
    for name, weather in WEATHERS.items():
        if options.only not in name:
            continue
        if name not in rows:
            rows[name] = row_of(name, weather, options.pastes)
            if kept is not None:
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_text(json.dumps([asdict(row) for row in rows.values()], indent=1))
        sys.stdout.write(text_of(rows[name]) + "\n")
        sys.stdout.flush()
    if kept is not None:
        draw([rows[name] for name in WEATHERS if name in rows], kept.with_name("weather.png"))


if __name__ == "__main__":
    main()
