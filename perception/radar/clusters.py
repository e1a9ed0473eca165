"""Clusters of radar detections: near in range and bearing, similar in speed along the line of sight."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64, Int64
from geometry.jit import kernel
from perception.radar.doppler import Echoes


class ClusterConfig(Config):
    """Joining distances of detections, and least cross-section of a target."""

    join_range_m: float = Field(gt=0.0, le=10.0)
    join_across_m: float = Field(gt=0.0, le=10.0)
    join_bearing_sigma: float = Field(ge=0.0, le=10.0, description="times the bearing's sigma, added across")
    join_doppler_mps: float = Field(gt=0.0, le=10.0)
    min_rcs_dbsm: float = Field(ge=-60.0, le=60.0, description="weaker detections are clutter")


@dataclass(frozen=True)
class Clusters:
    """K targets in `base`: centre (K, 2), nearest detection (K, 3), line of sight (K, 2), horizontal range (K,),
    speed over
    ground along it (K,), extent along and across it (K, 2), strongest cross-section (K,), number of detections (K,)."""

    p_m: Float64
    nearest_m: Float64
    line_of_sight: Float64
    range_m: Float64
    radial_mps: Float64
    extent_m: Float64
    rcs_dbsm: Float64
    count: Int64

    def __len__(self) -> int:
        return len(self.range_m)


def find_clusters(echoes: Echoes, azimuth_sigma_rad: float, config: ClusterConfig) -> Clusters:
    """Targets in one cycle, ordered by first detection; those below `min_rcs_dbsm` are left out."""
    label = np.full(len(echoes.range_m), -1, np.int64)
    k = _label(
        echoes.range_m, echoes.azimuth_rad, echoes.radial_mps, config.join_range_m, config.join_across_m,
        config.join_bearing_sigma * azimuth_sigma_rad, config.join_doppler_mps, label,
    )  # fmt: skip
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(k))
    strongest = np.maximum.reduceat(echoes.rcs_dbsm[order], starts) if k else np.zeros(0)
    return _describe(
        echoes, order, starts, strongest, np.flatnonzero(strongest >= config.min_rcs_dbsm).astype(np.int64)
    )


def _describe(echoes: Echoes, order: Int64, starts: Int64, strongest: Float64, kept: Int64) -> Clusters:
    """All clusters at once: the members of cluster k are `order[starts[k]:starts[k + 1]]`."""
    if len(starts) == 0:
        no_pair, none, no_int = np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.int64)
        return Clusters(no_pair, np.zeros((0, 3)), no_pair, none, none, no_pair, none, no_int)
    count = np.diff(np.append(starts, len(order)))
    # weighted by cross-section: strong echoes are the most accurate
    weight = 10.0 ** (0.1 * np.clip(echoes.rcs_dbsm[order], -40.0, 40.0))
    weight /= np.repeat(np.add.reduceat(weight, starts), count)
    p, range_m = echoes.p_base_m[order], echoes.range_m[order]
    line_of_sight = np.add.reduceat(weight[:, None] * echoes.line_of_sight[order], starts)
    line_of_sight /= np.hypot(line_of_sight[:, 0], line_of_sight[:, 1])[:, None]
    ahead = np.repeat(line_of_sight, count, axis=0)
    along, across = (p[:, :2] * ahead).sum(axis=1), p[:, 1] * ahead[:, 0] - p[:, 0] * ahead[:, 1]
    extent = [np.maximum.reduceat(x, starts) - np.minimum.reduceat(x, starts) for x in (along, across)]
    # sorted by range within each cluster: the first is the nearest
    nearest = np.lexsort((range_m, np.repeat(np.arange(len(starts)), count)))[starts]
    radial = np.add.reduceat(weight * echoes.radial_mps[order], starts)
    return Clusters(
        np.add.reduceat(weight[:, None] * p[:, :2], starts)[kept], p[nearest][kept], line_of_sight[kept],
        np.add.reduceat(weight * range_m, starts)[kept], radial[kept],
        np.stack(extent, axis=1)[kept], strongest[kept], count[kept].astype(np.int64),
    )  # fmt: skip


@kernel
def _label(
    range_m: Float64, azimuth: Float64, radial: Float64, join_range: float, join_across: float, bearing: float,
    join_doppler: float, label: Int64,
) -> int:  # fmt: skip
    """Connected components over all pairs; at most a few hundred detections."""
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
