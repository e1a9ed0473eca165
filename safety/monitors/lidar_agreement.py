"""Lidar agreement: a lidar whose ground lies elsewhere than that of the others measures wrongly.

Lidars that see the same place at the same time find its ground at the same height, whatever the shape of the ground.
The lowest return of each cell is compared: plants, dust and objects change single cells, not the median over them. The
wheels stand on the ground too: no lidar may find it far above or below them.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from geometry.arrays import median
from safety.config import LidarAgreementConfig
from safety.monitors.sensors import SensorFailure
from safety.sources.lidar import LidarSource


class LidarAgreement:
    """Compares the ground heights of every two lidars; call `update` after each new scan."""

    def __init__(self, config: LidarAgreementConfig) -> None:
        self._config = config
        self._since_ns: dict[str, int] = {}
        self._now_ns = 0

    def update(self, lidars: Sequence[LidarSource]) -> None:
        """Compares the last scans of all lidars."""
        far_m = self._config.max_height_m
        agreed = {one.name: [False] * (self._distance_from_wheels_m(one) > far_m) for one in lidars}
        for one, other in combinations(lidars, 2):
            if (found := self._do_agree(one, other)) is not None:
                agreed[one.name].append(found)
                agreed[other.name].append(found)
        self._now_ns = max((one.stamp_ns for one in lidars if one.stamp_ns is not None), default=0)
        contradicted = [name for name, found in agreed.items() if found.count(False) > found.count(True)]
        self._since_ns = {name: self._since_ns.get(name, self._now_ns) for name in contradicted}

    def failures(self, lidars: Sequence[LidarSource], direction: int) -> tuple[SensorFailure, ...]:
        """Failures of the lidars that cover a direction of travel, the ground farthest from the wheels first."""
        hold_ns = round(self._config.hold_s * 1e9)
        contradicted = [name for name, ns in self._since_ns.items() if self._now_ns - ns >= hold_ns]
        names = ", ".join(f"lidar/{name}" for name in contradicted)
        failures = []
        for one in sorted(lidars, key=self._distance_from_wheels_m, reverse=True):
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

    def _distance_from_wheels_m(self, one: LidarSource) -> float:
        """Height of the ground of a lidar above or below the wheels, 0 with too few cells."""
        height_m = one.ground.height_m
        return abs(float(median(height_m))) if len(height_m) >= self._config.min_cells else 0.0

    def _do_agree(self, one: LidarSource, other: LidarSource) -> bool | None:
        """Whether the grounds of two lidars agree; None without enough common cells of the same time."""
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
        return abs(difference_m) <= config.max_difference_m
