"""Detections of one target brought together: near in range and bearing, alike in speed along the line of sight."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from messages.message import Float64, Int64
from perception.kernels import kernel
from perception.radar.doppler import Echoes


class ClusterConfig(Config):
    """Which detections are one target, and from what cross-section a target counts."""

    join_range_m: float = Field(gt=0.0, le=10.0)
    join_across_m: float = Field(gt=0.0, le=10.0)
    join_bearing_sigma: float = Field(ge=0.0, le=10.0, description="times the bearing's sigma, added across")
    join_doppler_mps: float = Field(gt=0.0, le=10.0)
    least_rcs_dbsm: float = Field(ge=-60.0, le=60.0, description="weaker detections are clutter")


@dataclass(frozen=True)
class Clusters:
    """K targets in `base`: centre (K, 2), nearest detection (K, 3), line of sight (K, 2), level range (K,), speed over
    ground along it (K,), extent along and across it (K, 2), strongest cross-section (K,), number of detections (K,)."""

    p_m: Float64
    nearest_m: Float64
    sight: Float64
    range_m: Float64
    radial_mps: Float64
    extent_m: Float64
    rcs_dbsm: Float64
    count: Int64

    def __len__(self) -> int:
        return len(self.range_m)


def find_clusters(echoes: Echoes, azimuth_sigma_rad: float, config: ClusterConfig) -> Clusters:
    """Targets in one cycle, by their first detection; those that nowhere reach the least cross-section are left out."""
    label = np.full(len(echoes.range_m), -1, np.int64)
    k = _label(
        echoes.range_m, echoes.azimuth_rad, echoes.radial_mps, config.join_range_m, config.join_across_m,
        config.join_bearing_sigma * azimuth_sigma_rad, config.join_doppler_mps, label,
    )  # fmt: skip
    rows = [
        m for m in (np.flatnonzero(label == i) for i in range(k)) if echoes.rcs_dbsm[m].max() >= config.least_rcs_dbsm
    ]
    return _describe(echoes, rows)


def _describe(echoes: Echoes, rows: list[Int64]) -> Clusters:
    n = len(rows)
    out = Clusters(
        np.empty((n, 2)), np.empty((n, 3)), np.empty((n, 2)), np.empty(n), np.empty(n), np.empty((n, 2)), np.empty(n),
        np.array([len(m) for m in rows], np.int64),
    )  # fmt: skip
    for k, members in enumerate(rows):
        # strong echoes tell place and speed best
        weight = 10.0 ** (0.1 * np.clip(echoes.rcs_dbsm[members], -40.0, 40.0))
        weight /= weight.sum()
        sight = weight @ echoes.sight[members]
        sight /= np.hypot(*sight)
        p = echoes.p_base_m[members]
        along, across = p[:, :2] @ sight, p[:, :2] @ np.array([-sight[1], sight[0]])
        out.p_m[k], out.sight[k] = weight @ p[:, :2], sight
        out.nearest_m[k] = p[np.argmin(echoes.range_m[members])]
        out.range_m[k], out.radial_mps[k] = weight @ echoes.range_m[members], weight @ echoes.radial_mps[members]
        out.extent_m[k], out.rcs_dbsm[k] = (np.ptp(along), np.ptp(across)), echoes.rcs_dbsm[members].max()
    return out


@kernel
def _label(
    range_m: Float64, azimuth: Float64, radial: Float64, join_range: float, join_across: float, bearing: float,
    join_doppler: float, label: Int64,
) -> int:  # fmt: skip
    """Connected components; a few hundred detections at most, so every pair is looked at."""
    n, found = range_m.shape[0], 0
    stack = np.empty(n, np.int64)
    for start in range(n):
        if label[start] >= 0:
            continue
        label[start], stack[0], top = found, start, 1
        while top > 0:
            top -= 1
            i = stack[top]
            for j in range(n):
                if label[j] >= 0 or abs(radial[i] - radial[j]) > join_doppler:
                    continue
                along = (range_m[i] - range_m[j]) / join_range
                turn = (azimuth[i] - azimuth[j] + np.pi) % (2.0 * np.pi) - np.pi
                far = max(range_m[i], range_m[j])
                aside = far * turn / (join_across + bearing * far)
                if along * along + aside * aside <= 1.0:
                    label[j], stack[top] = found, j
                    top += 1
        found += 1
    return found
