"""Ray-cast scans of simple scenes: level, sloping or furrowed ground with upright boxes."""

import numpy as np

from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import Lidar, Vehicle
from messages.motion import Odometry
from messages.sensors import LidarScan
from perception.fusion.tracks import TrackerConfig
from perception.lidar.obstacles import LidarConfig

SECTION = read_yaml(CONFIGS / "stack/perception.yaml")
LIDAR_CONFIG = parse(LidarConfig, SECTION["lidar"], "stack/perception.yaml: lidar")
TRACKER_CONFIG = parse(TrackerConfig, SECTION["tracker"], "stack/perception.yaml: tracker")
VEHICLE = load(Vehicle, find("machines", "tractor_e"))
FRONT = VEHICLE.sensors.lidar["front"]


class Feed:
    """Inbox with given messages: all new, none stale."""

    def __init__(self, **topics):
        self.topics = {name.replace("__", "/"): m if isinstance(m, tuple) else (m,) for name, m in topics.items()}

    def last(self, topic, kind):
        return self.topics.get(topic, (None,))[-1]

    latest = last

    def all(self, topic, kind):
        return self.topics.get(topic, ())

    def at(self, topic, kind, stamp_ns):
        return self.last(topic, kind)


def odometry(stamp_ns, T=None, speed=0.0, yaw_rate=0.0):
    T = np.eye(4) if T is None else T
    return Odometry(stamp_ns, T, speed, 0.0, 0.0, yaw_rate, 0.0, np.eye(6))


def beams(lidar: Lidar):
    """Directions (R, C, 3) in base and the origin (3,)."""
    el = np.radians(np.array(lidar.elevation_deg))[:, None]
    half = np.radians(lidar.field_of_view_deg) / 2
    az = np.linspace(half, -half, lidar.columns, endpoint=False)[None, :]
    d = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el) * np.ones_like(az)], axis=2)
    T = lidar.mount.T_base_sensor
    return d @ T[:3, :3].T, T[:3, 3], el[:, 0], az[0]


def box(x, y, length, width, height, low=0.0):
    """Corners (2, 3) of an upright box on level ground."""
    return np.array([[x - length / 2, y - width / 2, low], [x + length / 2, y + width / 2, low + height]])


def person(x, y):
    return box(x, y, 0.3, 0.5, 1.75)


def cast(boxes=(), lidar=FRONT, slope=(0.0, 0.0), furrow_m=0.0, noise_m=0.015, seed=0, stamp_ns=10**9, extra=None):
    """A scan; `slope` is dz/dx and dz/dy of the ground, `furrow_m` the amplitude of waves 0.75 m apart across x."""
    d, origin, el, az = beams(lidar)
    rng = np.random.default_rng(seed)
    t = _ground(d, origin, slope, furrow_m)
    for corners in boxes:
        lift = slope[0] * corners[:, 0].mean() + slope[1] * corners[:, 1].mean()
        t = np.minimum(t, _box(d, origin, corners + np.array([0.0, 0.0, lift])))
    t = t + rng.normal(0.0, noise_m, t.shape) if noise_m else t
    t = np.where((t > lidar.range_m[0]) & (t < lidar.range_m[1]), t, 0.0)
    mm = np.round(t * 1000).astype(np.uint16)
    if extra is not None:
        mm = extra(mm, rng)
    none = np.zeros(0, np.float32)
    return LidarScan(stamp_ns, mm, el.copy(), az.copy(), np.zeros((0, 3), np.float32), np.zeros(0, np.uint8), none)


def _ground(d, origin, slope, furrow_m):
    fall = d[..., 2] - slope[0] * d[..., 0] - slope[1] * d[..., 1]
    above = origin[2] - slope[0] * origin[0] - slope[1] * origin[1]
    with np.errstate(divide="ignore"):
        t = np.where(fall < 0, above / -fall, np.inf)
    for _ in range(3 if furrow_m else 0):
        y = origin[1] + d[..., 1] * np.where(np.isfinite(t), t, 0.0)
        bump = furrow_m * np.sin(2 * np.pi * y / 0.75)
        with np.errstate(divide="ignore"):
            t = np.where(fall < 0, (above - bump) / -fall, np.inf)
    return t


def _box(d, origin, corners):
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (corners[0] - origin) / d, (corners[1] - origin) / d
    near, far = np.fmin(a, b).max(axis=2), np.fmax(a, b).min(axis=2)
    return np.where((near <= far) & (near > 0), near, np.inf)


def listed(scan: LidarScan, share=1.0, seed=0):
    """The scan as an unordered list, thinned to a share."""
    rng = np.random.default_rng(seed)
    points = scan.points_m[rng.permutation(len(scan.points_m))]
    points = points[: int(share * len(points))].copy()
    none = np.zeros(0, np.float64)
    return LidarScan(
        scan.stamp_ns, np.zeros((0, 0), np.uint16), none, none, points, np.zeros(0, np.uint8), np.zeros(0, np.float32)
    )
