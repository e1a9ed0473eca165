"""Trajectory of a localized recording, and its files: TUM and GeoJSON."""

import json
import math
from array import array
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.geodesy import Datum
from geometry.transforms import quaternion_of
from messages.motion import MapPose

GAP_S = 0.5  # a longer time without a pose divides the line


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of base in `map` at increasing stamps (N,): T (N, 4, 4), horizontal covariance in `map` (N, 2, 2),
    protection level and accuracy (95 %) in metres (N,), and source of the position (N,)."""

    stamps_ns: Int64
    T_map_base: Float64
    covariance_m2: Float64
    level_m: Float64
    accuracy_m: Float64
    sources: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def parts(self) -> list[slice]:
        """Parts without a gap."""
        ends = np.flatnonzero(np.diff(self.stamps_ns) > GAP_S * 1e9) + 1
        bounds = [0, *ends.tolist(), len(self)]
        return [slice(a, b) for a, b in pairwise(bounds) if b > a]

    @property
    def placed_s(self) -> float:
        """Time with a position."""
        t = self.stamps_ns
        return float(sum((t[p.stop - 1] - t[p.start]) * 1e-9 for p in self.parts))


@dataclass
class TrajectoryRows:
    """Poses as they are received; those without a position are left out."""

    _stamps: "array[int]" = field(default_factory=lambda: array("q"))
    _values: "array[float]" = field(default_factory=lambda: array("d"))
    _sources: list[str] = field(default_factory=list)

    def add(self, pose: MapPose) -> None:
        """Appends a pose with a position, newer than the last."""
        if not pose.is_initialized or (self._stamps and pose.stamp_ns <= self._stamps[-1]):
            return
        R = pose.T_map_base[:3, :3]
        flat = (R @ pose.covariance[3:, 3:] @ R.T)[:2, :2]
        self._stamps.append(pose.stamp_ns)
        self._values.extend(pose.T_map_base.ravel().tolist())
        self._values.extend((*flat.ravel().tolist(), pose.protection_level_m, pose.accuracy_95_m))
        self._sources.append(pose.source.name.lower())

    def trajectory(self) -> Trajectory:
        """All poses."""
        rows = np.array(self._values, np.float64).reshape(-1, 22)
        return Trajectory(
            np.array(self._stamps, np.int64), rows[:, :16].reshape(-1, 4, 4), rows[:, 16:20].reshape(-1, 2, 2),
            rows[:, 20], rows[:, 21], tuple(self._sources),
        )  # fmt: skip


def tum(trajectory: Trajectory, datum: Datum) -> str:
    """Text in the TUM format: `stamp_s x y z qx qy qz qw` of base in `map`, with the datum of `map` as a comment."""
    place = f"{math.degrees(datum.latitude_rad):.10f} {math.degrees(datum.longitude_rad):.10f} {datum.height_m:.4f}"
    lines = [f"# datum {place}", "# stamp_s x_m y_m z_m qx qy qz qw"]
    for stamp_ns, T in zip(trajectory.stamps_ns.tolist(), trajectory.T_map_base, strict=True):
        numbers = " ".join(f"{v:.6f}" for v in (*T[:3, 3], *quaternion_of(T)))
        lines.append(f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} {numbers}")
    return "\n".join(lines) + "\n"


def geojson(trajectory: Trajectory, datum: Datum) -> str:
    """One line per part without a gap, WGS 84, with its stamps and largest protection level."""
    features = []
    for part in trajectory.parts:
        points = [datum.to_ellipsoid(*p.tolist()) for p in trajectory.T_map_base[part, :3, 3]]
        line = [[round(math.degrees(lon), 9), round(math.degrees(lat), 9), round(h, 3)] for lat, lon, h in points]
        stamps, level_m = trajectory.stamps_ns[part], float(np.max(trajectory.level_m[part]))
        kind = "LineString" if len(line) > 1 else "Point"
        properties = {
            "first_s": int(stamps[0]) * 1e-9, "last_s": int(stamps[-1]) * 1e-9,
            "protection_level_m": round(level_m, 3) if math.isfinite(level_m) else None,
        }  # fmt: skip
        geometry = {"type": kind, "coordinates": line if len(line) > 1 else line[0]}
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    return json.dumps({"type": "FeatureCollection", "features": features}) + "\n"
