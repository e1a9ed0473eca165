"""Synthetic UWB, lidar and GNSS measurements in the shed of the demo farm, independent of the simulator."""

import dataclasses
import functools
import math

import numpy as np
import shapely

from configs.site import Shed, Site
from configs.strict import find, load
from configs.vehicle import ImplementFile, Mount, Uwb, Vehicle
from geometry.transforms import invert
from messages.perception import LidarGround
from messages.sensors import LidarScan, UwbRanges
from tests.localization.synthetic_drive import START_NS, SensorErrors, Truth, drive, tractor

TAG = "roof"


@functools.cache
def shed() -> Shed:
    found = load(Site, find("sites", "demo")).shed
    assert found is not None
    return found


@functools.cache
def tagged() -> Vehicle:
    """The tractor with a UWB tag on its roof."""
    v = tractor()
    tag = Uwb(mount=Mount(xyz_m=(0.2, 0.5, 2.95)), rate_hz=10, range_sigma_m=0.07, range_m=(0.2, 60.0))
    return v.model_copy(update={"sensors": v.sensors.model_copy(update={"uwb": {TAG: tag}})})


@functools.cache
def harrow():
    return load(ImplementFile, find("implements", "harrow_6m")).implement


@dataclasses.dataclass(frozen=True)
class UwbErrors:
    """Errors of the ranges."""

    sigma_m: float = 0.07
    scale: float = 0.01
    bias_m: float = 0.05
    reflected_ratio: float = 0.15
    reflection_m: tuple[float, float] = (0.3, 1.0)
    blocked_anchors: tuple[str, ...] = ()


def ranges(truth: Truth, uwb_errors: UwbErrors = UwbErrors(), seed: int = 1) -> list:
    """Ranges at 10 Hz as (arrival, topic, message); some are reflected for about 1 s, `blocked_anchors` always."""
    rng, names = np.random.default_rng(seed + 500), list(shed().anchors)
    where = np.array([shed().anchors[n] for n in names])
    scale = 1.0 + uwb_errors.scale + rng.normal(0, 0.0005, len(names))
    bias = uwb_errors.bias_m + rng.normal(0, 0.04, len(names))
    delay, out = np.zeros(len(names)), []
    arm = np.append(tagged().sensors.uwb[TAG].mount.xyz_m, 1.0)
    for stamp_ns in range(START_NS + 50_000_000, START_NS + int((len(truth.T_map_base) - 2) * 2e6), 100_000_000):
        tag = (truth.at(stamp_ns) @ arm)[:3]
        change = rng.random(len(names)) < 0.1
        reflects = np.array(
            [rng.random() < uwb_errors.reflected_ratio or n in uwb_errors.blocked_anchors for n in names]
        )
        delay = np.where(change, np.where(reflects, rng.uniform(*uwb_errors.reflection_m, len(names)), 0.0), delay)
        delay = np.where(
            [n in uwb_errors.blocked_anchors for n in names], np.maximum(delay, uwb_errors.reflection_m[0]), delay
        )
        d = scale * np.linalg.norm(where - tag, axis=1) + bias + delay + rng.normal(0, uwb_errors.sigma_m, len(names))
        message = UwbRanges(stamp_ns, TAG, tuple(names), d, np.ones(len(names)))
        out.append((stamp_ns + 5_000_000, f"uwb/{TAG}", message))
    return out


def is_open(truth: Truth, stamp_ns: int, margin_m: float = 1.0) -> bool:
    """Whether the antenna is in the open."""
    x, y, _ = truth.at(stamp_ns)[:3, 3] + truth.at(stamp_ns)[:3, :3] @ np.array([0.6, 0.0, 3.05])
    corners = np.array(shed().outline_m)
    low, high = corners.min(axis=0) - margin_m, corners.max(axis=0) + margin_m
    return not (low[0] < x < high[0] and low[1] < y < high[1])


def messages(truth: Truth, uwb_errors: UwbErrors | None = UwbErrors(), seed: int = 1) -> list:
    """All messages except of lidars, without fixes under the roof."""
    kept = [m for m in truth.messages if m[1] != "gnss/main" or is_open(truth, m[2].stamp_ns)]
    return sorted(kept + (ranges(truth, uwb_errors, seed) if uwb_errors is not None else []), key=lambda m: m[0])


def out_and_back_drive(dock, drive_s: float = 32.0, seed: int = 1, speed_mps: float = 0.5) -> Truth:
    """From a dock straight out into the yard, and back in reverse."""
    sensor_errors = SensorErrors(
        seed=seed, slip=0.005, slip_swing=0.0, slip_per_force=0.05, soil_side=0.001, furrow_m=0.0
    )
    v, part_s = speed_mps, drive_s / 2
    legs = [(5.0, 0.0, 0.0), (part_s, v, 0.0), (part_s, v, 0.08), (2.0, 0.0, 0.0)]
    legs += [(part_s, -v, 0.08), (part_s, -v, 0.0), (3.0, 0.0, 0.0)]
    pose = (dock.x_m, dock.y_m, math.radians(dock.heading_deg))
    return drive(sum(leg[0] for leg in legs), legs=legs, sensor_errors=sensor_errors, begin=pose, is_flat=True)


@functools.cache
def _walls() -> tuple[np.ndarray, np.ndarray]:
    """Faces as segments (M, 2, 2), 7.5 cm to either side of the center line of each wall, and posts (K, 3)."""
    walls = shapely.union_all([shapely.LineString(w).buffer(0.075, cap_style="flat") for w in shed().walls_m])
    ring = np.array(walls.exterior.coords)
    posts = np.array([[*p.at_m, p.radius_m] for p in shed().posts])
    extra = np.array([[20.0, -30.0, 0.1], [16.0, -28.0, 0.1], [30.0, -40.0, 0.15], [26.0, -50.0, 0.15]])
    return np.stack([ring[:-1], ring[1:]], axis=1), np.vstack([posts, extra])


def simulate_scan(truth: Truth, stamp_ns: int, sensor: str, rng: np.random.Generator) -> tuple[LidarScan, LidarGround]:
    """Scan of shed and posts: every beam from the lidar's pose within the sweep to the first surface."""
    lidar = tagged().sensors.lidar[sensor]
    columns = lidar.columns // 2
    fov = math.radians(lidar.field_of_view_deg)
    azimuth = fov * ((np.arange(columns) + 0.5) / columns - 0.5)
    offset = (np.arange(columns) + 1.0) / columns / lidar.rate_hz - 1.0 / lidar.rate_hz
    T_end, T_start = truth.at(stamp_ns), truth.at(stamp_ns - round(1e9 / lidar.rate_hz))
    share = -offset * lidar.rate_hz
    T_lidar = T_end @ lidar.mount.T_base_sensor
    yaw = math.atan2(T_lidar[1, 0], T_lidar[0, 0])
    back = invert(T_end) @ T_start
    turn = math.atan2(back[1, 0], back[0, 0])
    origin = T_lidar[:2, 3] + share[:, None] * (T_start - T_end)[:2, 3]
    angle = yaw + azimuth + share * turn
    d = _cast(origin, np.column_stack([np.cos(angle), np.sin(angle)]))
    elevation = np.radians([e for e in lidar.elevation_deg if -30 < e < 10])
    flat, el = np.meshgrid(d, elevation)
    z = T_lidar[2, 3] + np.where(np.isfinite(flat), flat, 0.0) * np.tan(el)
    hit = np.isfinite(flat) & (z > 0.2) & (z < 4.0)
    r = flat[hit] / np.cos(el[hit]) + rng.normal(0, 0.015, int(hit.sum()))
    az = np.broadcast_to(azimuth, flat.shape)[hit]
    p = np.column_stack([np.cos(el[hit]) * np.cos(az), np.cos(el[hit]) * np.sin(az), np.sin(el[hit])]) * r[:, None]
    empty = np.zeros(0)
    when = np.broadcast_to(offset, flat.shape)[hit].astype(np.float32)
    scan = LidarScan(
        stamp_ns, np.zeros((0, 0), np.uint16), empty, empty.copy(), p.astype(np.float32), np.zeros(0, np.uint8), when
    )
    return scan, LidarGround(stamp_ns, stamp_ns, np.ones(len(p), np.uint8), np.array([0.0, 0.0, 1.0, 0.0]))


def _cast(origin: np.ndarray, along: np.ndarray) -> np.ndarray:
    faces, posts = _walls()
    best = np.full(len(origin), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for a, b in faces:
            e, q = b - a, a - origin
            cross = along[:, 0] * e[1] - along[:, 1] * e[0]
            t = (q[:, 0] * e[1] - q[:, 1] * e[0]) / cross
            u = (q[:, 0] * along[:, 1] - q[:, 1] * along[:, 0]) / cross
            best = np.where((t > 0) & (u >= 0) & (u <= 1), np.minimum(best, t), best)
        for x, y, r in posts:
            q = np.array([x, y]) - origin
            mid = np.einsum("ni,ni->n", q, along)
            gap = r * r - (np.einsum("ni,ni->n", q, q) - mid * mid)
            t = mid - np.sqrt(gap)
            best = np.where((gap > 0) & (t > 0), np.minimum(best, t), best)
    return np.where(best < 45.0, best, np.inf)
