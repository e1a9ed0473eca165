"""Synthetic hedges, posts and trunks as points in `map`, and scans of them by a rotating lidar."""

import numpy as np
from scipy.spatial.transform import Rotation

from geometry.transforms import invert
from messages.perception import LidarGround
from messages.sensors import LidarScan
from tests.localization.synthetic_drive import START_NS, Truth, tractor


def yard(seed: int = 5) -> np.ndarray:
    """About 12 000 points within 60 m of the start: two crossing hedges, posts and trunks."""
    rng = np.random.default_rng(seed)
    hedge = np.column_stack([rng.uniform(-40, 130, 5000), 32 + rng.normal(0, 0.1, 5000), rng.uniform(0.4, 2.0, 5000)])
    across = np.column_stack([75 + rng.normal(0, 0.1, 3000), rng.uniform(-60, 60, 3000), rng.uniform(0.4, 2.0, 3000)])
    foot = rng.uniform([-30, -50], [110, 28], (60, 2))
    turn = rng.uniform(0, 2 * np.pi, (60, 70))
    posts = np.stack(
        [foot[:, :1] + 0.15 * np.cos(turn), foot[:, 1:] + 0.15 * np.sin(turn), rng.uniform(0.4, 3, (60, 70))], -1
    )
    return np.concatenate([hedge, across, posts.reshape(-1, 3)])


def corridor() -> np.ndarray:
    """A single straight hedge: motion along it is unobservable."""
    rng = np.random.default_rng(7)
    return np.column_stack(
        [rng.uniform(-300, 300, 60000), 8 + rng.normal(0, 0.03, 60000), rng.uniform(0.4, 2.0, 60000)]
    )


def scan(truth: Truth, stamp_ns: int, world: np.ndarray, rng: np.random.Generator) -> tuple[LidarScan, LidarGround]:
    """The sweep that ends at a stamp: each point is measured from the pose at the time of its beam."""
    T_base_lidar = tractor().sensors.lidar["front"].mount.T_base_sensor
    T_end = truth.at(stamp_ns) @ T_base_lidar
    T_start = truth.at(stamp_ns - 100_000_000) @ T_base_lidar
    in_lidar = (world - T_end[:3, 3]) @ T_end[:3, :3]
    share = np.arctan2(in_lidar[:, 1], in_lidar[:, 0]) / (2 * np.pi) - 0.5  # of the sweep, before its end
    turn = Rotation.from_matrix(T_end[:3, :3].T @ T_start[:3, :3]).as_rotvec()
    R = Rotation.from_matrix(T_end[:3, :3]) * Rotation.from_rotvec(-share[:, None] * turn)
    origin = T_end[:3, 3] - share[:, None] * (T_start[:3, 3] - T_end[:3, 3])
    p = R.inv().apply(world - origin) + rng.normal(0, 0.015, world.shape)
    near = np.linalg.norm(p, axis=1) < 55
    p, offset = p[near].astype(np.float32), (share[near] * 0.1).astype(np.float32)
    empty = np.zeros(0)
    message = LidarScan(stamp_ns, np.zeros((0, 0), np.uint16), empty, empty.copy(), p, np.zeros(0, np.uint8), offset)
    return message, LidarGround(stamp_ns, stamp_ns, np.ones(len(p), np.uint8), np.array([0.0, 0.0, 1.0, 0.0]))


def relative(truth: Truth, start_ns: int, end_ns: int) -> np.ndarray:
    """True motion of base."""
    return invert(truth.at(start_ns)) @ truth.at(end_ns)


def scan_times(seconds: float) -> range:
    return range(START_NS + 200_000_000, START_NS + int(seconds * 1e9) - 200_000_000, 100_000_000)
