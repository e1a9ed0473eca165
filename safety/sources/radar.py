"""Radar source: detections repeated at one position in several cycles are hits.

A single detection is often clutter: it must exceed a cross-section, and others near it must occur in several of the
last cycles. Moving detections may be weaker; static ones count only as far as the bearing separates lanes.
"""

import math
from collections import deque
from itertools import pairwise

import numpy as np

from configs.vehicle import Radar
from geometry.arrays import Float64
from geometry.pose2 import to_frame
from messages.motion import Odometry
from messages.sensors import RadarScan
from safety.config import RadarConfig
from safety.zones.footprint import Footprint, is_own

NONE = np.empty((0, 5))


class RadarSource:
    """Processes the cycles of one radar; `hits` (N, 4): x, y, z in odom, lateral deviation of the bearing (m)."""

    def __init__(
        self, name: str, radar: Radar, height_m: tuple[float, float], mask_m: float, config: RadarConfig
    ) -> None:
        self.name = name
        self.stamp_ns: int | None = None
        self.hits: Float64 = np.empty((0, 4))
        self._radar, self._config = radar, config
        self._low_m, self._high_m = height_m
        self._mask_m = mask_m
        self._T = radar.mount.T_base_sensor
        self._cycles: deque[tuple[int, Float64]] = deque(maxlen=config.cycles)
        self._last: RadarScan | None = None
        self._equal_scans = 0

    @property
    def is_frozen(self) -> bool:
        """Whether the last cycles are identical."""
        return self._equal_scans >= self._config.frozen_cycles

    def forget(self) -> None:
        """Drops what was detected."""
        self._cycles.clear()
        self.hits = np.empty((0, 4))

    def update(self, scan: RadarScan, pose_odom: Float64, odom: Odometry, footprint: Footprint) -> None:
        """Processes a cycle; `pose_odom` (3,) is base at its stamp."""
        self._equal_scans = self._equal_scans + 1 if is_same(scan, self._last) else 0
        self._last, self.stamp_ns = scan, scan.stamp_ns
        base, radial, rcs = usable_detections(scan, self._radar, self._T, odom)
        is_moving = np.abs(radial) >= self._config.moving_mps
        range_m = np.hypot(*(base[:, :2] - self._T[:2, 3]).T)
        min_rcs = np.where(is_moving, self._config.moving_rcs_dbsm, self._config.static_rcs_dbsm)
        cap = np.where(is_moving, self._config.moving_cap_m, self._config.static_cap_m)
        counts = (rcs >= min_rcs) & (range_m <= cap) & (base[:, 2] >= self._low_m) & (base[:, 2] <= self._high_m)
        counts[counts] = ~is_own(base[counts].T, footprint, odom.curvature_radpm, self._mask_m)
        positions = np.column_stack([to_frame(pose_odom, base[:, :2]), base[:, 2], is_moving, range_m])[counts]
        self._cycles.append((scan.stamp_ns, positions))
        self.hits = confirmed([p for ns, p in self._cycles if scan.stamp_ns - ns <= self._config.memory_s * 1e9],
                              self._config, math.radians(self._radar.azimuth_sigma_deg))  # fmt: skip


def confirmed(cycles: list[Float64], config: RadarConfig, sigma_rad: float) -> Float64:
    """Mean positions (N, 4: `RadarSource.hits`) detected in enough cycles (M, 5: x, y, z, is moving, range each)."""
    every = np.concatenate([NONE, *cycles])
    if len(every) == 0:
        return np.empty((0, 4))
    x, y = every[:, 0], every[:, 1]
    near = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2 <= config.association_m**2
    ends = np.cumsum([0, *(len(cycle) for cycle in cycles)])
    seen = sum(near[:, a:b].any(axis=1).astype(np.int64) for a, b in pairwise(ends))
    needed = np.where(every[:, 3] > 0.0, config.moving_cycles, config.static_cycles)
    is_hit = seen >= needed
    count = near[is_hit].sum(axis=1)
    mean = near[is_hit].astype(np.float64) @ every[:, :3] / np.maximum(count, 1)[:, None]
    return np.column_stack([mean, sigma_rad * every[is_hit, 4] / np.sqrt(np.maximum(count, 1))])


def usable_detections(scan: RadarScan, radar: Radar, T: Float64, odom: Odometry) -> tuple[Float64, Float64, Float64]:
    """Usable detections: positions (N, 3) in base, radial speed over ground (N,), cross-section (N,)."""
    arrays = (scan.range_m, scan.azimuth_rad, scan.elevation_rad, scan.doppler_mps, scan.rcs_dbsm)
    if any(a.shape != (len(scan.range_m),) for a in arrays):
        return np.empty((0, 3)), np.empty(0), np.empty(0)
    range_m, azimuth, elevation, doppler, rcs = np.array(arrays, np.float64)
    use = np.isfinite(range_m + azimuth + doppler + rcs) & (range_m >= radar.range_m[0]) & (range_m <= radar.range_m[1])
    use &= np.abs(azimuth) <= math.radians(0.5 * radar.field_of_view_deg)
    azimuth, elevation = azimuth[use], np.nan_to_num(elevation[use], nan=0.0, posinf=0.0, neginf=0.0)
    flat = np.cos(elevation)
    lines = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]) @ T[:3, :3].T
    turn = odom.yaw_rate_radps
    own = np.array([odom.speed_mps - turn * T[1, 3], odom.lateral_mps + turn * T[0, 3], 0.0])
    return T[:3, 3] + lines * range_m[use, None], doppler[use] + lines @ own, rcs[use]


def is_same(scan: RadarScan, before: RadarScan | None) -> bool:
    """Whether a cycle repeats the previous detections bit for bit; an empty cycle does not."""
    if before is None or len(scan.range_m) == 0:
        return False
    return np.array_equal(scan.range_m, before.range_m) and np.array_equal(scan.doppler_mps, before.doppler_mps)
