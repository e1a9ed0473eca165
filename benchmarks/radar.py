"""Benchmark of the radar pipeline on recordings: one cycle of a Continental ARS548, one minute of a Toyota ACC radar.

    ./headland benchmark radar

ARS548: the raw packets of a ROS 2 bag are decoded and compared, field by field, with the supplied reference; the speed
of the car is then estimated from the Doppler alone, and targets are classified as static or moving.
Toyota: the radar outputs tracks, not echoes; each cycle is processed as a scan, with odometry from wheels and gyro. The
reference velocity is the change of the device track's position over ground within one second.
"""

import argparse
import sqlite3
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.recordings import DATA
from configs.strict import load, parse, read_yaml
from configs.vehicle import Mount, Radar, Vehicle
from datasets.importers.captures.ars548 import INVALID, DetectionList, decode_detections, is_invalid, to_scan
from geometry.arrays import Float64
from geometry.transforms import apply, planar
from messages.motion import Odometry
from messages.perception import Obstacles
from messages.sensors import RadarScan
from perception.radar.clusters import find_clusters
from perception.radar.doppler import estimate_velocity, to_base, usable
from perception.radar.obstacles import RadarConfig, RadarObstacles, warm

ROOT = Path(__file__).parents[1]
FIELDS = {
    "azimuth_angle": "azimuth_rad", "azimuth_angle_std": "azimuth_sigma_rad", "elevation_angle": "elevation_rad",
    "elevation_angle_std": "elevation_sigma_rad", "range": "range_m", "range_std": "range_sigma_m",
    "range_rate": "doppler_mps", "range_rate_std": "doppler_sigma_mps", "rcs": "rcs_dbsm",
    "measurement_id": "measurement", "raw_positive_predictive_value": "existence_percent",
    "classification": "classification", "raw_multi_target_probability": "several_percent", "object_id": "object",
    "raw_ambiguity_flag": "ambiguity_percent",
}  # fmt: skip
ARS548 = Radar(
    mount=Mount(xyz_m=(3.872, 0.0, 0.641)), field_of_view_deg=120.0, rate_hz=20.0, range_m=(0.2, 300.0),
    range_sigma_m=0.2, azimuth_sigma_deg=0.5, doppler_sigma_mps=0.25,
)  # fmt: skip
TOYOTA = Radar(
    mount=Mount(xyz_m=(3.7, 0.0, 0.6)), field_of_view_deg=90.0, rate_hz=20.0, range_m=(1.0, 200.0),
    range_sigma_m=0.3, azimuth_sigma_deg=0.5, doppler_sigma_mps=0.2,
)  # fmt: skip


def datagrams(bag: Path) -> Iterator[bytes]:
    """UDP payloads in a bag of `nebula_msgs/NebulaPackets` (CDR, little-endian)."""
    connection = sqlite3.connect(f"file:{bag}?mode=ro&immutable=1", uri=True)
    for (data,) in connection.execute("SELECT data FROM messages ORDER BY id"):
        (name,) = struct.unpack_from("<I", data, 12)
        place = (16 + name + 3) // 4 * 4
        (count,) = struct.unpack_from("<I", data, place)
        place += 4
        for _ in range(count):
            (size,) = struct.unpack_from("<I", data, place + 8)
            yield data[place + 12 : place + 12 + size]
            place += (12 + size + 3) // 4 * 4
    connection.close()


def differences(cycle: DetectionList, truth: dict[str, Any]) -> list[str]:
    """Fields of a decoded cycle that differ from the reference, to its six digits."""
    rows, d = truth["detections"], cycle.detections
    wrong = [] if len(rows) == len(d) else [f"{len(d)} detections, not {len(rows)}"]
    for theirs, ours in FIELDS.items():
        wanted = np.array([row[theirs] for row in rows], np.float64)
        if len(wanted) == len(d) and not np.allclose(d[ours].astype(np.float64), wanted, rtol=1e-5, atol=1e-6):
            wrong.append(theirs)
    flags = {name: [bool(row[f"invalid_{name}"]) for row in rows] for name in INVALID}
    wrong += [f"invalid_{name}" for name, flag in flags.items() if flag != is_invalid(d, name).tolist()]
    origin = [truth["origin_pos"][k] for k in "xyz"]
    head = [*cycle.mount[:3], *cycle.mount[4:], *cycle.doppler_limits_mps, *cycle.alignment_rad]
    rest = [
        truth[k] for k in ("origin_pitch", "origin_yaw", "ambiguity_free_velocity_min", "ambiguity_free_velocity_max")
    ]
    rest += [truth[k] for k in ("alignment_azimuth_correction", "alignment_elevation_correction")]
    return wrong if np.allclose(head, origin + rest, rtol=1e-5) else [*wrong, "head"]


def run_ars548(folder: Path, config: RadarConfig) -> bool:
    """Prints the results of one recorded cycle; returns whether it equals the reference."""
    cycles = [c for c in map(decode_detections, datagrams(next(folder.glob("*/*.db3")))) if c is not None]
    truth = yaml.load(next(folder.glob("*_detection.yaml")).read_text(), yaml.CSafeLoader)
    wrong = differences(cycles[0], truth) if len(cycles) == 1 else [f"{len(cycles)} lists"]
    print(f"ARS548: {len(cycles[0].detections)} detections, differences: {', '.join(wrong) or 'nothing'}")
    scan = to_scan(cycles[0], cycles[0].stamp_ns)
    which = usable(scan, ARS548.range_m, np.radians(ARS548.field_of_view_deg) / 2)
    velocity, agrees = estimate_velocity(scan, which, config.health.agree_mps)
    T = ARS548.mount.T_base_sensor
    warm()
    find_clusters(to_base(scan, which, T, np.zeros(3)), 0.01, config.clusters)
    start = time.perf_counter()
    echoes = to_base(scan, which, T, np.append(velocity, 0.0))
    clusters = find_clusters(echoes, np.radians(ARS548.azimuth_sigma_deg), config.clusters)
    ms = (time.perf_counter() - start) * 1e3
    moving = np.abs(clusters.radial_mps) > config.health.agree_mps
    print(
        f"  speed by Doppler {velocity[0]:.2f} m/s ahead, {velocity[1]:.2f} left; {agrees.mean():.0%} of echoes static"
    )
    print(f"  {len(clusters)} targets, {int(moving.sum())} of them moving, {ms:.1f} ms")
    return not wrong


@dataclass(frozen=True)
class Drive:
    """Cycles of the Toyota: scans, odometry at each, and the device's track number of each detection."""

    scans: list[RadarScan]
    odometry: list[Odometry]
    tracks: list[Float64]


def read_comma(folder: Path) -> Drive:
    """The radar of a comma2k19 segment with odometry from wheel speed and gyro; a cycle ends with a pause of 20 ms."""
    log = folder / "processed_log"
    value, t = np.load(log / "CAN" / "radar" / "value"), np.load(log / "CAN" / "radar" / "t")
    speed = np.load(log / "CAN" / "speed" / "value").ravel(), np.load(log / "CAN" / "speed" / "t")
    gyro = np.load(log / "IMU" / "gyro" / "value"), np.load(log / "IMU" / "gyro" / "t")
    drive, x, y, yaw, last = Drive([], [], []), 0.0, 0.0, 0.0, float(t[0])
    for rows in np.split(np.arange(len(t)), np.flatnonzero(np.diff(t) > 0.02) + 1):
        now = float(t[rows[-1]])
        v, turn = float(np.interp(now, speed[1], speed[0])), -float(np.interp(now, gyro[1], gyro[0][:, 2]))
        middle = yaw + turn * (now - last) / 2
        x, y, yaw = (
            x + v * (now - last) * np.cos(middle),
            y + v * (now - last) * np.sin(middle),
            yaw + turn * (now - last),
        )
        last, stamp_ns = now, round(now * 1e9)
        ahead, left, relative = value[rows, 0], value[rows, 1], value[rows, 2]
        range_m, azimuth = np.hypot(ahead, left), np.arctan2(left, ahead)
        level, rcs = np.zeros(len(rows)), np.full(len(rows), 10.0)  # elevation and cross-section are not measured
        drive.scans.append(RadarScan(stamp_ns, range_m, azimuth, level, relative * np.cos(azimuth), rcs))
        drive.odometry.append(Odometry(stamp_ns, planar(x, y, yaw), v, 0.0, 0.0, turn, 0.0, np.zeros((6, 6))))
        drive.tracks.append(value[rows, 5])
    return drive


def reference(drive: Drive, window_s: float = 1.0) -> dict[tuple[int, float], tuple[float, float]]:
    """Velocity in `odom` of each device track at each cycle, from its positions within the window."""
    path: dict[float, list[tuple[int, float, Float64]]] = {}
    for i, (scan, odom, tracks) in enumerate(zip(drive.scans, drive.odometry, drive.tracks, strict=True)):
        level = np.zeros(len(tracks))
        p = np.stack([scan.range_m * np.cos(scan.azimuth_rad), scan.range_m * np.sin(scan.azimuth_rad), level], axis=1)
        places = apply(odom.T_odom_base @ TOYOTA.mount.T_base_sensor, p)
        for track, place in zip(tracks, places, strict=True):
            path.setdefault(float(track), []).append((i, scan.stamp_ns * 1e-9, place[:2]))
    out = {}
    for track, rows in path.items():
        times, places = np.array([r[1] for r in rows]), np.array([r[2] for r in rows])
        for i, now, _ in rows:
            near = np.flatnonzero(np.abs(times - now) <= window_s / 2)
            # track numbers are reused for other targets: positions then jump
            steps = np.hypot(*np.diff(places[near], axis=0).T)
            if np.ptp(times[near]) > 0.9 * window_s and steps.max() < 3.0:
                velocity = np.polyfit(times[near] - now, places[near], 1)[0]
                out[(i, track)] = (float(velocity[0]), float(velocity[1]))
    return out


def run_comma(folder: Path, vehicle: Vehicle, config: RadarConfig) -> None:
    """Prints the agreement of the pipeline's targets with the device tracks."""
    drive = read_comma(folder)
    node = RadarObstacles("front", TOYOTA, vehicle, None, config)
    truth = reference(drive)
    found, errors, still, moving, right, ms = 0, [], 0, 0, 0, []
    for i, (scan, odom) in enumerate(zip(drive.scans, drive.odometry, strict=True)):
        start = time.perf_counter()
        obstacles = node.process(scan, odom)
        ms.append((time.perf_counter() - start) * 1e3)
        for k, track in enumerate(drive.tracks[i]):
            if (i, float(track)) in truth:
                velocity = np.array(truth[(i, float(track))])
                row = _nearest(obstacles, scan, k)
                stands = bool(np.hypot(*velocity) < 2.0)
                still, moving, found = still + stands, moving + (not stands), found + (row is not None)
                if row is not None and np.isfinite(obstacles.velocity_mps[row]).all():
                    velocity_odom = odom.T_odom_base[:2, :2] @ obstacles.velocity_mps[row]
                    errors.append(np.hypot(*(velocity_odom - velocity)))
                    right += (np.hypot(*velocity_odom) < 2.0) == stands
    n, known = still + moving, len(errors)
    print(
        f"Toyota: {len(drive.scans)} cycles, {n} places of tracks at least 1 s old ({moving} moving, {still} standing)"
    )
    print(f"  {found / n:.1%} published as obstacles, {known / n:.1%} with velocity; {np.median(ms):.2f} ms per cycle")
    print(f"  error of velocity: median {np.median(errors):.2f}, 95 % {np.percentile(errors, 95):.2f} m/s")
    print(f"  moving or static classified correctly: {right / max(known, 1):.1%}")


def _nearest(obstacles: Obstacles, scan: RadarScan, k: int) -> int | None:
    sensor = TOYOTA.mount.T_base_sensor[:2, 3]
    p = sensor + scan.range_m[k] * np.array([np.cos(scan.azimuth_rad[k]), np.sin(scan.azimuth_rad[k])])
    gap = np.hypot(*(obstacles.center_base_m[:, :2] - p).T)
    return int(gap.argmin()) if len(gap) and gap.min() < 2.0 else None


def run(data: Path) -> bool:
    """Print everything; whether the ARS548 is decoded rightly."""
    perception = read_yaml(ROOT / "configs/stack/perception.yaml")
    config = parse(RadarConfig, perception["radar"], "stack/perception.yaml: radar")
    vehicle = load(Vehicle, ROOT / "configs" / "machines" / "tractor_e.yaml")
    good = run_ars548(data / "tier4-nebula" / "ars548", config)
    run_comma(next((data / "comma2k19-example" / "Example_1").glob("*/40")), vehicle, config)
    return good


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA)
    sys.exit(0 if run(parser.parse_args().data) else 1)
