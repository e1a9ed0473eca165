"""Benchmark of lidar perception on KITTI: recall, latency, false stops, gap, thinning, noise, inserted persons, speed.

    ./headland benchmark perception_kitti

The stack's own configuration with the recording car's sensor model and mount. Each line ends with its bar.
"""

import argparse
import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one core, also for the compared libraries

from collections.abc import Callable
from functools import partial
from importlib import import_module
from time import process_time

import numpy as np
from scipy.stats import beta

from benchmarks.perception_kitti_data import FRAMES, Label, detections, frame, has_frames, labels
from benchmarks.perception_pasting import paste_trials
from benchmarks.perception_scoring import (
    Drive,
    classes,
    drive,
    false_stops,
    gap_errors,
    latencies,
    perceive,
    recall,
    thin,
)
from benchmarks.recordings import DATA
from geometry.arrays import Float32

NOISE = 2000


def lower_bound(good: int, n: int) -> float:
    """One-sided exact (Clopper-Pearson) 95 % bound."""
    return 0.0 if good == 0 else float(beta.ppf(0.05, good, n - good + 1))


def print_row(name: str, value: str, bar: str) -> None:
    """One line of the table."""
    sys.stdout.write(f"{name:<46} {value:<44} {bar}\n")
    sys.stdout.flush()


def show_recall() -> None:
    """Limit 1 by range, and PointRCNN by the same rule with its boxes as clusters."""
    rows = list(recall())
    for low, high, bar in ((0, 30, "100 %"), (30, 40, ">= 98 %"), (40, 80, "-")):
        those = [s.counts for _, _, s in rows if low <= s.edge_m < high]
        print_row(f"strict recall, {low} to {high} m", f"{sum(those)} of {len(those)}", bar)
    hits = [_network_counts(number, label) for number, label, _ in rows]
    print_row("PointRCNN by the same rule", f"{sum(hits)} of {len(hits)}", "not above ours")
    for seed in range(3):
        those = [s.counts for _, _, s in recall(0.25, seed)]
        print_row(f"75 % of returns removed, seed {seed}", f"{sum(those)} of {len(those)}", ">= 93 %")


def _network_counts(number: int, label: Label) -> bool:
    points = frame(number)
    inside = label.contains(points)
    for box in detections().get(number, ()):
        own = box.contains(points)
        if own.any() and (own & inside).sum() >= 0.5 * inside.sum() and label.contains(points[own], 0.5).mean() >= 0.5:
            return True
    return False


def show_drives() -> None:
    """Limits 2, 3 and the noise of limit 6, at 10 Hz and at 2.5 Hz."""
    changes: dict[str, Callable[[int, Float32], Float32]] = {
        "as recorded": lambda _, p: p,
        "a quarter of the returns": lambda n, p: thin(p, 0.25, np.random.default_rng(n)),
        f"{NOISE} noise returns": add_noise,
    }
    for name, change in changes.items():
        for step in (1, 4):
            run = drive(range(0, FRAMES, step), change)
            late = [s for k, (first, s) in latencies(run).items() if _could_be_confirmed(run, k, first, step)]
            print_row(
                f"{name}, {10 / step:g} Hz: latency",
                f"{max(late):.1f} s at most of {len(late)}",
                "<= 0.3 s or one scan",
            )
            wrong = {track for _, track, _ in false_stops(run)}
            print_row(f"{name}, {10 / step:g} Hz: false stops", str(len(wrong)), "0")
            if change is changes["as recorded"]:
                show_classes(run, f"{10 / step:g} Hz")


def show_classes(run: Drive, rate: str) -> None:
    """Class of the confirmed tracks on labelled objects; a cyclist is a person."""
    found = classes(run)
    for name, right, bar in (("Pedestrian", "person", 90), ("Cyclist", "person", 90), ("Van", "vehicle", 95)):
        n = sum(count for (label, _), count in found.items() if label == name)
        good = found[name, right]
        print_row(f"{name} as {right}, {rate}", f"{good} of {n}, {100 * good / max(n, 1):.0f} %", f">= {bar} %")


def _could_be_confirmed(run: Drive, object_id: int, first: int, step: int) -> bool:
    """Whether labels continue long enough: two more scans, and 0.3 s."""
    last = max(n for n in run.numbers if any(label.id == object_id for label in labels().get(n, ())))
    return last - first >= max(3, step)


def add_noise(number: int, points_m: Float32) -> Float32:
    """Returns at random ranges and directions, most of them near the car, from the ground to the height of a van."""
    rng = np.random.default_rng(1000 + number)
    r, a = rng.uniform(2.0, 60.0, NOISE), rng.uniform(-np.pi, np.pi, NOISE)
    noise = np.column_stack([r * np.cos(a), r * np.sin(a), rng.uniform(-1.7, 1.0, NOISE)])
    return np.concatenate([points_m, noise.astype(np.float32)])


def show_gap_and_pastes() -> None:
    """Limit 5 and the inserted objects of limit 6."""
    errors = np.abs(gap_errors())
    print_row("gap to true nearest return, median", f"{np.median(errors):.3f} m", "<= 0.10 m")
    print_row("gap to true nearest return, 95 %", f"{np.quantile(errors, 0.95):.3f} m", "<= 0.30 m")
    for name, height, bar in (("people and cyclists", None, ">= 95 %"), ("objects 0.5 m high", 0.5, ">= 90 %")):
        good = sum(paste_trials(200, height))
        print_row(f"200 {name} on free ground", f"{good / 2:.1f} %, bound {100 * lower_bound(good, 200):.1f} %", bar)


def show_speed() -> None:
    """Limit 9: processor time of the node for 124 k returns, and of other libraries' ground and clusters."""
    paths = sorted((DATA / "kitti-patchworkpp" / "data").glob("*.bin"))
    scans = [np.fromfile(p, np.float32).reshape(-1, 4) for p in paths]
    others = _others()
    points = [scan[:, :3].copy() for scan in scans]
    ours = _median_s(perceive, points)
    print_row(f"{len(scans[0])} returns to obstacles, median", f"{1e3 * ours:.1f} ms on one core", "<= 10 ms")
    if others is None:
        print_row("pypatchworkpp + open3d DBSCAN", "pypatchworkpp is not installed: not shown", ">= 3 x")
    else:
        theirs = _median_s(others, scans)
        print_row("pypatchworkpp + open3d DBSCAN", f"{1e3 * theirs:.0f} ms, {theirs / ours:.0f} x", ">= 3 x")


def _median_s(work: Callable[[Float32], object], scans: list[Float32]) -> float:
    return float(np.median([_processor_s(partial(work, scan)) for _ in range(5) for scan in scans]))


def _processor_s(work: Callable[[], object]) -> float:
    """Processor time of all threads, including those of libraries."""
    start = process_time()
    work()
    return process_time() - start


def _others() -> Callable[[Float32], object] | None:
    """Ground by Patchwork++ with its defaults, clusters of the rest by DBSCAN; for returns (N, 4) with intensity."""
    try:
        pypatchworkpp = import_module("pypatchworkpp")
    except ImportError:  # not available for other processors
        return None
    import open3d

    patchwork = pypatchworkpp.patchworkpp(pypatchworkpp.Parameters())

    def run(scan: Float32) -> object:
        patchwork.estimateGround(scan)
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(patchwork.getNonground().astype(np.float64)))
        return cloud.cluster_dbscan(0.5, 5)

    return run


def main() -> None:
    """Prints all results, one line each."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    if not has_frames():
        raise SystemExit(f"no recording under {DATA}; set HEADLAND_DATA to its folder")
    show_recall()
    show_drives()
    show_gap_and_pastes()
    show_speed()


if __name__ == "__main__":
    main()
