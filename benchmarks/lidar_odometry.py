"""Lidar odometry against KISS-ICP and dead reckoning, on logs of simulated drives.

    ./headland benchmark lidar_odometry LOG... [--seconds S] [--slip SHARE]

Both matchers get the same returns and the same initial guess by dead reckoning. A row is a log and a matcher: share of
valid motions (0.2 s each), root mean square error along and across the path while moving, largest ratio of an error to
its stated sigma, error of the path over 2 s, error at the end, processor time of a scan. `--slip` shortens the initial
guess, as wheels that slip would.
"""

import argparse
import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from kiss_icp.mapping import VoxelHashMap
from kiss_icp.registration import Registration
from scipy.spatial.transform import Rotation

from configs.strict import find, load
from configs.vehicle import ImplementFile, Vehicle
from datasets.reader import read_log
from geometry.arrays import Float64
from geometry.transforms import invert
from localization.dead_reckoning.dead_reckoning import PoseHistory
from localization.dead_reckoning.kernels import first_in_voxel
from localization.lidar.scan_matching import ScanMatcher, level_of, thin
from localization.lidar.scan_preprocessing import ScanPreprocessor
from messages.motion import Odometry
from messages.sensors import LidarScan
from messages.truth import TrueMachine
from perception.lidar.obstacles import Pipeline
from tests.localization.harness import configuration
from tests.perception.lidar_scenes import LIDAR_CONFIG

MOVING_M, WINDOW, PERIOD_NS = 0.01, 10, 190_000_000
VOXEL_M, PER_VOXEL, KERNEL_M, MAX_POINTS, ITERATIONS, CONVERGENCE = 0.8, 8, 0.25, 500, 40, 0.001
Step = Callable[[Float64, Float64], tuple[Float64, Float64 | None]]  # points, guess: motion, its sigmas if valid


@dataclass(frozen=True)
class Scan:
    """Obstacle returns (N, 3) in base, pose by dead reckoning and true pose."""

    points_m: Float64
    T_odom_base: Float64
    T_map_base: Float64


def scans_of(log: Path, seconds: float, machine: str, implement: str) -> list[Scan]:
    """Scans of the odometry's lidar, 0.2 s apart."""
    vehicle = load(Vehicle, find("machines", machine))
    mounted = load(ImplementFile, find("implements", implement)).implement
    config = configuration()
    sensor = config.lidar_odometry.sensor
    lidar = vehicle.sensors.lidar[sensor]
    pipeline = Pipeline(lidar, vehicle, None, LIDAR_CONFIG)
    matching, margin_m = config.lidar_odometry.matching, config.lidar_odometry.margin_m
    points = ScanPreprocessor(lidar, vehicle.body, mounted, matching.range_m, margin_m, matching.voxel_m)
    odom, truth, waiting, out = PoseHistory(1e9), PoseHistory(1e9), list[LidarScan](), list[Scan]()
    first_ns, last_ns = None, -(2**62)
    for entry in read_log(log):
        message = entry.message
        if isinstance(message, Odometry):
            odom.add(message.stamp_ns, message.T_odom_base)
        elif isinstance(message, TrueMachine):
            truth.add(message.stamp_ns, message.T_map_base)
        elif isinstance(message, LidarScan) and entry.topic == f"lidar/{sensor}":
            first_ns = message.stamp_ns if first_ns is None else first_ns
            if message.stamp_ns - first_ns > seconds * 1e9:
                break
            waiting = [*waiting[-WINDOW:], message]  # those before the first pose never get one
        while waiting:
            now, true = odom.at(waiting[0].stamp_ns), truth.at(waiting[0].stamp_ns)
            if now is None or true is None:
                break
            scan = waiting.pop(0)
            before = odom.at(scan.stamp_ns - points.sweep_ns)
            if before is None or scan.stamp_ns - last_ns < PERIOD_NS:
                continue
            last_ns = scan.stamp_ns
            ground, _, _ = pipeline.run(scan, None, sensor, 0)
            found = points.process(scan, ground, invert(before) @ now)
            out.append(Scan(found.points_base_m, now, true))
    return out


def surfaces(first: Scan, origin_m: Float64) -> Step:
    """The matcher of the stack."""
    matcher = ScanMatcher(configuration().lidar_odometry.matching, origin_m)
    matcher.reset(level_of(first.T_odom_base))

    def step(points_m: Float64, guess: Float64) -> tuple[Float64, Float64 | None]:
        before = matcher.T_local_body
        match = matcher.match(points_m, guess)
        sigma = None if match.reason else np.sqrt(np.diag(match.covariance)[3:5])
        return invert(before) @ match.T_local_body, sigma

    return step


def kiss_icp() -> Step:
    """KISS-ICP (Vizzo et al. 2023) with its local map, one thread."""
    registration = Registration(ITERATIONS, CONVERGENCE, max_num_threads=1)
    local, pose = VoxelHashMap(VOXEL_M, 80.0, PER_VOXEL), np.eye(4)

    def step(points_m: Float64, guess: Float64) -> tuple[Float64, Float64 | None]:
        nonlocal pose
        fine = points_m[first_in_voxel(points_m, 0.5 * VOXEL_M)]
        source = thin(fine[first_in_voxel(fine, 0.75 * VOXEL_M)], MAX_POINTS)
        T = pose @ guess
        T[:3, :3] = Rotation.from_matrix(T[:3, :3]).as_matrix()
        if not local.empty() and len(source):
            T = registration.align_points_to_map(source, local, T, 3.0 * KERNEL_M, KERNEL_M)
        local.update(fine, T)
        motion, pose = invert(pose) @ T, T
        return motion, np.full(2, np.nan)

    return step


def row(name: str, scans: list[Scan], step: Step, slip: float) -> str:
    """Table row of a matcher on a log."""
    errors, ratios, valid, spent_s = list[Float64](), [0.0], 0, 0.0
    step(scans[0].points_m, np.eye(4))
    for last, scan in itertools.pairwise(scans):
        guess = invert(last.T_odom_base) @ scan.T_odom_base
        guess[:3, 3] *= 1.0 - slip
        true = invert(last.T_map_base) @ scan.T_map_base
        began = time.thread_time()
        motion, sigma = step(scan.points_m, guess)
        spent_s += time.thread_time() - began
        error = np.array([*(motion - true)[:2, 3], np.hypot(*true[:2, 3])])
        errors.append(error)
        valid += sigma is not None
        if sigma is not None and np.isfinite(sigma).all():
            ratios.append(float(np.max(np.abs(error[:2]) / sigma)))
    e = np.array(errors)
    moving, path = e[:, 2] > MOVING_M, np.cumsum(e[:, :2], axis=0)
    drift = np.linalg.norm(path[WINDOW:] - path[:-WINDOW], axis=1)
    along, across = (1e3 * float(np.sqrt(np.mean(e[moving, k] ** 2))) for k in (0, 1))
    return (
        f"| {name} | {len(scans)} | {100.0 * valid / len(e):.0f} % | {along:.1f}, {across:.1f} mm | "
        f"{max(ratios):.1f} | {1e3 * float(np.sqrt(np.mean(drift**2))):.0f}, {1e3 * float(np.max(drift)):.0f} mm | "
        f"{np.hypot(*path[-1]):.2f} of {np.sum(e[:, 2]):.0f} m | {1e3 * spent_s / len(e):.2f} ms |"
    )


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="log.mcap of a simulated drive")
    parser.add_argument("--seconds", type=float, default=1e6, metavar="S", help="of each log")
    parser.add_argument("--slip", type=float, default=0.0, metavar="SHARE")
    parser.add_argument("--machine", default="tractor_h")
    parser.add_argument("--implement", default="harrow_6m")
    given = parser.parse_args()
    lidars = load(Vehicle, find("machines", given.machine)).sensors.lidar
    origin_m = lidars[configuration().lidar_odometry.sensor].mount.T_base_sensor[:3, 3]
    heads = (
        "log, matcher", "scans", "valid", "error along, across", "largest error / sigma", "2 s: rms, largest",
        "at the end", "a scan",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    for log in given.logs:
        scans = scans_of(log, given.seconds, given.machine, given.implement)
        steps: dict[str, Step] = {
            "surfaces": surfaces(scans[0], origin_m), "KISS-ICP": kiss_icp(),
            "dead reckoning": lambda _points_m, guess: (guess, np.full(2, np.nan)),
        }  # fmt: skip
        for name, step in steps.items():
            print(row(f"{log.parent.name}, {name}", scans, step, given.slip), flush=True)


if __name__ == "__main__":
    main()
