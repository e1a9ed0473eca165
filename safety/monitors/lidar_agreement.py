"""Lidar agreement: a lidar whose ground lies elsewhere than that of the others measures wrongly.

Lidars that see the same place at the same time find its ground at the same height, whatever the shape of the ground.
The lowest return of each cell is compared: plants, dust and objects change single cells, not the median over them. The
wheels stand on the ground too: no lidar may find it far above or below them. A contradiction of twice the limit counts
after half the time: what is far off needs no second look, but more than one scan.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from geometry.arrays import median
from safety.config import LidarAgreementConfig
from safety.monitors.sensors import SensorFailure
from safety.sources.lidar import LidarSource

ROUNDING_S = 1e-9


class LidarAgreement:
    """Compares the ground heights of every two lidars; call `update` after each new scan."""

    def __init__(self, config: LidarAgreementConfig) -> None:
        self._config = config
        self._evidence_s: dict[str, float] = {}  # time of contradiction, weighted with its size
        self._now_ns = 0

    def update(self, lidars: Sequence[LidarSource]) -> None:
        """Compares the last scans of all lidars."""
        sizes = {one.name: self._above_wheels(one) for one in lidars}
        for one, other in combinations(lidars, 2):
            if (size := self._difference(one, other)) is not None:
                sizes[one.name].append(size)
                sizes[other.name].append(size)
        before_ns, self._now_ns = self._now_ns, max((one.stamp_ns or 0 for one in lidars), default=0)
        interval_s = max(0, self._now_ns - before_ns) * 1e-9
        before, self._evidence_s = self._evidence_s, {}
        for name, found in sizes.items():
            if (size := _contradiction(found)) > 1.0:
                weight = min(size, self._config.hold_s / self._config.min_hold_s)
                self._evidence_s[name] = before[name] + weight * interval_s if name in before else 0.0

    def failures(self, lidars: Sequence[LidarSource], direction: int) -> tuple[SensorFailure, ...]:
        """Failures of the lidars that cover a direction of travel."""
        contradicted = [name for name, held_s in self._evidence_s.items() if held_s >= self._config.hold_s - ROUNDING_S]
        names = ", ".join(f"lidar/{name}" for name in contradicted)
        failures = []
        for one in lidars:
            if not one.covers(direction):
                continue
            topic = f"lidar/{one.name}"
            if one.has_other_rings:
                text = f"{topic} has another number of rings than configured"
                failures.append(SensorFailure("lidar", f"{topic}.foreign", text))
            if one.name in contradicted:
                text = f"the ground of {names} lies elsewhere than that of the other lidars"
                failures.append(SensorFailure("lidar", f"{topic}.contradicted", text))
        return tuple(failures)

    def _above_wheels(self, one: LidarSource) -> list[float]:
        """Distance of the ground from the wheels over the limit, where it is above it: nearer says nothing."""
        height_m = one.ground.height_m
        size = abs(median(height_m)) / self._config.max_height_m if len(height_m) >= self._config.min_cells else 0.0
        return [size] if size > 1.0 else []

    def _difference(self, one: LidarSource, other: LidarSource) -> float | None:
        """Difference of two grounds over the limit; None without enough common cells of the same time."""
        config = self._config
        if one.stamp_ns is None or other.stamp_ns is None:
            return None
        if abs(one.stamp_ns - other.stamp_ns) > config.max_interval_s * 1e9:
            return None
        common, first, second = np.intersect1d(
            one.ground.cells, other.ground.cells, assume_unique=True, return_indices=True
        )
        if len(common) < config.min_cells:
            return None
        difference_m = median(one.ground.height_m[first] - other.ground.height_m[second])
        return abs(difference_m) / config.max_difference_m


def _contradiction(sizes: list[float]) -> float:
    """The smallest of the differences above 1 if they are the most, else 0."""
    above = [size for size in sizes if size > 1.0]
    return min(above) if 2 * len(above) > len(sizes) else 0.0
