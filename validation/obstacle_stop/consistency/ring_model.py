"""Rings of a lidar against its configuration: elevations of the returns, and their density on near ground.

The elevation of a ring is a constant of the device, so that the criteria need no statistics of the scene: a ring that
should meet near ground returns nothing only if the machine hides it, and then not in all directions.
"""

import math

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Float32, Float64, Int64
from geometry.jit import kernel
from messages.sensors import LidarScan
from validation.obstacle_stop.consistency.config import RingLimits
from validation.obstacle_stop.consistency.finding import Finding, not_checked

BIN_DEG = 0.1
BINS = 1800
SECTORS = 12
MAX_GROUND_M = 20.0  # horizontal range up to which ground is expected to return every beam
MIN_DOWN_DEG = 3.0


@kernel
def count_elevations(points_m: Float32, stride: int, counts: Int64, by_sector: Int64, lowest: int, highest: int) -> int:
    """Adds the returns of a scan by elevation (BINS) and, between two bins, by azimuth; returns their number."""
    number = 0
    for k in range(0, len(points_m), stride):
        x, y, z = points_m[k]
        flat = math.sqrt(x * x + y * y)
        if flat + abs(z) < 0.3 or not math.isfinite(flat + z):
            continue
        bin_ = min(int((math.degrees(math.atan2(z, flat)) + 90.0) / BIN_DEG), BINS - 1)
        counts[bin_] += 1
        number += 1
        if lowest <= bin_ < highest:
            by_sector[int((math.atan2(y, x) + math.pi) * (SECTORS / (2.0 * math.pi))) % SECTORS] += 1
    return number


class RingModel:
    """Call `add` with scans of one lidar; `findings` compares their elevations with the configured ones."""

    def __init__(self, name: str, lidar: Lidar) -> None:
        self._name = name
        self._table = np.sort(np.array(lidar.elevation_deg))
        self._lidar = lidar
        self._counts = np.zeros(BINS, np.int64)
        self._density: list[float] = []
        self._scans = 0
        self._differing: tuple[int, float] | None = None
        mount_m = float(lidar.mount.T_base_sensor[2, 3])
        down = [e for e in self._table if e < -MIN_DOWN_DEG and mount_m < MAX_GROUND_M * math.tan(math.radians(-e))]
        self._on_ground = np.array(down) if mount_m > 0.2 else np.zeros(0)

    def add(self, scan: LidarScan, stride: int) -> None:
        """Counts the returns of one scan."""
        self._scans += 1
        if scan.ranges_mm.size:
            self._compare(np.degrees(np.sort(scan.elevation_rad)))
        by_sector = np.zeros(SECTORS, np.int64)
        low, high = (
            (self._on_ground[0] - 1.0, self._on_ground[-1] + 0.5 * self._spacing(self._on_ground[-1]))
            if len(self._on_ground)
            else (0.0, 0.0)
        )
        edges = [int((e + 90.0) / BIN_DEG) for e in (low, high)]
        count_elevations(scan.points_m, stride, self._counts, by_sector, edges[0], edges[1])
        if len(self._on_ground):
            per_sector = len(self._on_ground) * self._lidar.columns * 360.0 / self._lidar.field_of_view_deg / SECTORS
            best = np.sort(by_sector)[-max(1, int(SECTORS * self._lidar.field_of_view_deg / 360.0 / 2)) :]
            self._density.append(float(np.median(best)) * stride / per_sector)

    def _compare(self, elevations_deg: Float64) -> None:
        same = len(elevations_deg) == len(self._table)
        away = float(np.abs(elevations_deg - self._table).max()) if same else math.nan
        if not same or not away <= self._differing_limit():
            self._differing = (len(elevations_deg), away)

    def _differing_limit(self) -> float:
        return 0.5 * float(np.diff(self._table).min()) if len(self._table) > 1 else 0.5

    def _spacing(self, elevation_deg: float) -> float:
        away = np.abs(self._table - elevation_deg)
        return float(away[away > 1e-6].min(initial=2.0))

    def findings(self, limits: RingLimits) -> list[Finding]:
        """Contradictions of the returns and the configured rings."""
        if self._counts.sum() < 1000:
            return [not_checked(f"rings of lidar {self._name}", f"{self._counts.sum()} returns")]
        return [*self._table_findings(), *self._outside(limits), *self._missing(limits), *self._off_table(limits)]

    def _table_findings(self) -> list[Finding]:
        if self._differing is None:
            return []
        count, away = self._differing
        text = f"lidar {self._name}: its scans have {count} rings, its configuration {len(self._table)}"
        if count == len(self._table):
            text = (
                f"lidar {self._name}: the elevations of its rings differ from the configured ones by up to {away:.2f}°"
            )
        numbers = {"rings": float(count), "configured_rings": float(len(self._table))}
        return [Finding("ring_table", text, numbers, True)]

    def _outside(self, limits: RingLimits) -> list[Finding]:
        """Returns at elevations without any ring."""
        margin = limits.elevation_deg
        low, high = self._table[0] - margin, self._table[-1] + margin
        middle = (np.arange(BINS) + 0.5) * BIN_DEG - 90.0
        share = float(self._counts[(middle < low) | (middle > high)].sum() / self._counts.sum())
        if share <= limits.max_share_outside:
            return []
        text = (
            f"lidar {self._name}: {100 * share:.1f} % of the returns lie more than {margin:.0f}° outside of its rings "
            f"({self._table[0]:+.1f}° to {self._table[-1]:+.1f}°): the elevations are not those of this device"
        )
        return [Finding("rings_outside", text, {"share_outside": share}, True)]

    def _missing(self, limits: RingLimits) -> list[Finding]:
        """Rings without returns on near ground, and too few returns there."""
        if not len(self._on_ground) or len(self._on_ground) < 3:
            reason = "fewer than three rings meet the ground within 20 m"
            return [not_checked(f"number of rings of lidar {self._name}", reason)]
        middle = (np.arange(BINS) + 0.5) * BIN_DEG - 90.0
        is_found = self._counts > 0.02 * self._counts.sum() / len(self._table) * BIN_DEG
        found = middle[is_found]
        gaps = [float(np.abs(found - e).min()) > self._reach(e) for e in self._on_ground]
        numbers = {
            "missing_rings": float(sum(gaps)), "rings_on_ground": float(len(gaps)),
            "density": float(np.median(self._density)),
        }  # fmt: skip
        if sum(gaps) > limits.max_missing_share * len(gaps):
            text = (
                f"lidar {self._name}: {sum(gaps)} of the {len(gaps)} rings that meet near ground return nothing in "
                f"{self._scans} scans: rings are missing, or the elevations are not those of this device"
            )
            return [Finding("rings_missing", text, numbers, True)]
        if numbers["density"] < limits.min_density:
            text = (
                f"lidar {self._name}: near ground returns {100 * numbers['density']:.0f} % of the beams of its "
                f"{len(gaps)} rings x {self._lidar.columns} columns: rings or columns are missing"
            )
            return [Finding("rings_missing", text, numbers, True)]
        return []

    def _reach(self, elevation_deg: float) -> float:
        return max(0.5 * self._spacing(elevation_deg), BIN_DEG)

    def _off_table(self, limits: RingLimits) -> list[Finding]:
        """Sharp rings in the returns that lie between the configured ones (lists of points only resolve wide rings)."""
        spacing = float(np.median(np.diff(self._table))) if len(self._table) > 1 else 0.0
        if spacing < 10.0 * BIN_DEG or self._differing is not None:
            return []
        middle = (np.arange(BINS) + 0.5) * BIN_DEG - 90.0
        away = np.abs(middle[:, None] - self._table[None]).min(axis=1)
        near = float(self._counts[away <= limits.elevation_share * spacing].sum() / self._counts.sum())
        used = np.sort(self._counts)[::-1]
        sharp = float(used[: 3 * len(self._table)].sum() / self._counts.sum())
        if sharp < 0.9 or near >= limits.min_share_on_rings:
            return []
        text = (
            f"lidar {self._name}: only {100 * near:.0f} % of the returns lie on a configured ring, although they form "
            "rings: the elevations are not those of this device"
        )
        return [Finding("ring_table", text, {"share_on_rings": near, "share_on_sharp_rings": sharp}, True)]
