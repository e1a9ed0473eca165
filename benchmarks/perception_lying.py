"""Persons who lie, crouch and stand, inserted into recorded scans of several lidars: what the near field finds.

    ./headland benchmark perception_lying [--n N] [--seed SEED]

A body of boxes or cylinders stands on free ground ahead of a car with the lidar on its roof, in the beams that returned
in the recorded scan. Found: the supervisor has a confirmed return, or the lidar pipeline an obstacle, within 1 m of it
after four scans. False: the same without the body. Scans are read from HEADLAND_DATA, else from ../shared/data.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from benchmarks.perception_adjacent import Boxes, Scene, body_ranges, box_ranges
from benchmarks.perception_kitti_data import PERIOD_NS, START_NS, car, configs, frame, has_frames, scan_of
from benchmarks.recordings import DATA
from configs.strict import CONFIGS, parse, read_yaml
from configs.vehicle import Vehicle
from datasets.importers.packet_captures import open_capture
from geometry.arrays import Float64
from messages.sensors import LidarScan
from perception.lidar.obstacles import Pipeline
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import Box, footprint_of

# boxes about the place of the body: x, y, height (m); none: a standing adult of cylinders
BODIES: dict[str, Boxes] = {
    "standing adult": (),
    "crouching adult": (((-0.3, 0.3), (-0.25, 0.25), (0.0, 0.6)), ((-0.15, 0.15), (-0.12, 0.12), (0.6, 0.8))),
    "lying adult": (((-0.85, 0.85), (-0.22, 0.22), (0.0, 0.2)), ((-0.45, 0.1), (-0.2, 0.2), (0.2, 0.29))),
    "lying child": (((-0.55, 0.55), (-0.15, 0.15), (0.0, 0.17)),),
}
RANGE_M, NEAR_M, FREE_M, LOW_M = (4.7, 11.0), 1.0, 1.3, 0.1  # the car ends at 3.7 m
LEAST_RETURNS, LEAST_SHARE, SCANS, NOISE_M = 6, 0.6, 4, 0.02
TRIES = 400  # places per body that counts

Found = tuple[bool, bool]  # by supervisor, by pipeline
Outcome = tuple[Found, ...]  # with and without the body


@dataclass(frozen=True)
class Recorded:
    """A scan: its returns (N, 3) in the frame of the lidar, and the elevations of its rings (°)."""

    name: str
    points_m: Float64
    elevation_deg: list[float]

    @property
    def height_m(self) -> float:
        """Height of the lidar above the level of most of the returns near it."""
        near = (np.hypot(self.points_m[:, 0], self.points_m[:, 1]) < 10.0) & (self.points_m[:, 2] < -0.7)
        counts, edges = np.histogram(self.points_m[near, 2], 60)
        k = int(counts.argmax())
        return -0.5 * float(edges[k] + edges[k + 1])


CAPTURES = {  # folder of devices/lidar, file, number of rings
    "HDL-32E": ("mrpt-velodyne/sample_velodyne_hdl32.pcap", 32),
    "OS-0-128": ("ouster-sdk/pcaps/OS-0-128-U1_v2.3.0_1024x10.pcap", 128),
    "OS-0-32": ("ouster-sdk/pcaps/OS-0-32-U1_v2.2.0_1024x10.pcap", 32),
    "OS-1-128": ("ouster-sdk/pcaps/OS-1-128_v2.3.0_1024x10_lb_n3.pcap", 128),
    "VLP-32C": ("*/velodyne_vlp32.pcap", 32),
}


def recorded() -> Iterator[Recorded]:
    """The fullest scan of each capture, and three of KITTI."""
    for name, (pattern, rings) in CAPTURES.items():
        for path in sorted((DATA / "devices/lidar").glob(pattern)):
            scans = [one[2] for one in open_capture(path).read() if isinstance(one[2], LidarScan)]
            yield _recorded(name, max(scans, key=lambda scan: len(scan.points_m)).points_m.astype(np.float64), rings)
    if has_frames():
        for number in (0, 20, 39):
            yield _recorded(f"KITTI {number}", frame(number).astype(np.float64), 64)


def _recorded(name: str, points_m: Float64, rings: int) -> Recorded:
    points_m = points_m[np.linalg.norm(points_m, axis=1) > 0.9]
    elevation = np.degrees(np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1])))
    return Recorded(name, points_m, [float(e) for e in np.quantile(elevation, (np.arange(rings) + 0.5) / rings)])


@cache
def config() -> SupervisorConfig:
    """Unchanged configuration of the supervisor."""
    return parse(SupervisorConfig, read_yaml(CONFIGS / "stack/safety.yaml"), "stack/safety.yaml")


def vehicle_of(scan: Recorded) -> Vehicle:
    """The recording car of KITTI with the lidar in its middle."""
    known = car()
    lidar = known.sensors.lidar["top"].model_dump(exclude_none=True)
    lidar |= {"mount": {"xyz_m": (0.0, 0.0, scan.height_m)}, "elevation_deg": scan.elevation_deg, "columns": 1024}
    values = known.model_dump(exclude_none=True) | {"sensors": {"lidar": {"top": lidar}}}
    return parse(Vehicle, values, scan.name)


def found_by(
    vehicle: Vehicle, pipeline: Pipeline, points_m: Float64, place_m: tuple[float, float], rng: np.random.Generator
) -> Found:
    """Whether the supervisor confirms a return near a place after scans with noise of their own, and whether the lidar
    pipeline gives an obstacle there in the last."""
    source = LidarSource(
        "top", vehicle.sensors.lidar["top"], footprint_of(vehicle, None), config(), measures_ground=True
    )
    away_m = np.linalg.norm(points_m, axis=1)
    for k in range(SCANS):
        noisy = points_m * (1.0 + rng.normal(0.0, 0.4 * NOISE_M, len(points_m)) / away_m)[:, None]
        area = Box((-5.0, RANGE_M[1] + 6.0), (-6.0, 6.0))
        one = scan_of(noisy.astype(np.float32), START_NS + k * PERIOD_NS)
        source.update(one, np.zeros(3), Motion(0.0, 0.0), 0.0, area)
    _, obstacles, _ = pipeline.run(one, None, "top", 0)
    places = source.hits_odom_m[:, :2], obstacles.center_base_m[:, :2]
    confirmed, given = ((np.hypot(*(found - place_m).T) < NEAR_M).any() for found in places)
    return bool(confirmed), bool(given)


def trials(scan: Recorded, body: str, n: int, rng: np.random.Generator) -> Iterator[Outcome]:
    """Whether a body is found, and whether something is found at its place without it, at free places ahead."""
    vehicle, level_m = vehicle_of(scan), -scan.height_m
    pipeline = Pipeline(vehicle.sensors.lidar["top"], vehicle, None, configs()[0])
    done = 0
    for _ in range(TRIES * n):
        if done == n:
            return
        away, turn = rng.uniform(*RANGE_M), rng.uniform(-np.pi, np.pi)
        R = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
        points_m = scan.points_m @ R.T
        about = points_m[np.hypot(points_m[:, 0] - away, points_m[:, 1]) < FREE_M, 2]
        if len(about) < 8:
            continue
        foot_m = float(np.quantile(about, 0.1))
        if about.max() > foot_m + LOW_M or abs(foot_m - level_m) > 0.4:
            continue
        ranges = np.linalg.norm(points_m, axis=1)
        scene = Scene(
            points_m / ranges[:, None], ranges, np.zeros(3), np.array([away, 0.0, foot_m]), rng.uniform(-np.pi, np.pi)
        )
        own = box_ranges(scene, BODIES[body], 0.0, rng) if BODIES[body] else body_ranges(scene, (0.0, 0.0))
        seen = own < ranges
        if seen.sum() < max(LEAST_RETURNS, LEAST_SHARE * np.isfinite(own).sum()):
            continue
        with_body = scene.directions * np.where(seen, own + rng.normal(0.0, NOISE_M, len(own)), ranges)[:, None]
        yield tuple(found_by(vehicle, pipeline, one, (away, 0.0), rng) for one in (with_body, points_m))
        done += 1


def main() -> None:
    """Prints two lines per scan, supervisor and lidar pipeline: found and false of the trials with each body."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=15, help="places of each body in each scan")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"{'found (false) of ' + str(arguments.n):22s}" + "".join(f"{body:>18s}" for body in BODIES))
    for scan in recorded():
        lines = ["", ""]
        for body in BODIES:
            outcomes = list(trials(scan, body, arguments.n, np.random.default_rng(arguments.seed)))
            for by in range(2):
                found, false = (sum(one[k][by] for one in outcomes) for k in range(2))
                lines[by] += f"{f'{found} ({false}) of {len(outcomes)}':>18s}"
        for line, finder in zip(lines, ("supervisor", "pipeline"), strict=True):
            print(f"{scan.name:11s}{finder:11s}{line}", flush=True)


if __name__ == "__main__":
    main()
