"""Range gate: checks UWB ranges, propagates them to a keyframe and rejects reflected ranges."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Uwb
from geometry.arrays import Float64, Int64
from geometry.transforms import apply, invert
from localization.dead_reckoning.dead_reckoning import PoseHistory
from localization.graph.uwb_factor import expected_ranges
from localization.uwb.tag_smoother import shared_covariance
from localization.uwb.window import RobustWeighting, range_weight
from messages.sensors import UwbRanges

KEEP = 60


class RangeGateConfig(Config):
    """Section `range_gate` of map alignment: weights of ranges, prior of scale and bias; see `TagSmootherConfig`."""

    sigma_factor: float = Field(ge=1.0, le=20.0, description="on the data sheet's sigma, for correlated errors")
    long_sigmas: float = Field(gt=0.0, le=100.0, description="residual of a too long range with half weight")
    short_sigmas: float = Field(gt=0.0, le=100.0, description="the same of a too short range")
    min_weight: float = Field(gt=0.0, le=1.0, description="ranges with less are rejected")
    scale_sigma: float = Field(ge=0.0, le=0.5, description="common to all anchors")
    scale_each_sigma: float = Field(gt=0.0, le=0.5)
    scale_walk: float = Field(gt=0.0, le=0.1, description="per root second")
    bias_sigma_m: float = Field(ge=0.0, le=20.0)
    bias_each_sigma_m: float = Field(gt=0.0, le=20.0)
    bias_walk_m: float = Field(gt=0.0, le=1.0, description="per root second")
    min_anchors: int = Field(ge=2, le=20, description="that must be consistent at a keyframe or at the start")
    min_agreeing_ratio: float = Field(gt=0.0, le=1.0, description="of the anchors received at the start")
    averaged_ranges: int = Field(ge=1, le=1000, description="over which the mean residual of an anchor is taken")
    timeout_s: float = Field(gt=0.0, le=10.0, description="without consistent ranges, after which UWB is inactive")


@dataclass(frozen=True)
class RangeBatch:
    """n ranges at one time: pair of tag and anchor, anchor, lever arm (n, 3) in the body, range and sigma."""

    pairs: Int64
    rows: Int64
    arms_m: Float64
    range_m: Float64
    sigma_m: Float64

    def weighted(self, weight: Float64) -> "RangeBatch":
        """Ranges with a weight above zero, their sigmas increased by it."""
        use = weight > 0.0
        sigma = self.sigma_m[use] / np.sqrt(weight[use])
        return RangeBatch(self.pairs[use], self.rows[use], self.arms_m[use], self.range_m[use], sigma)


def consistent(residual_m: Float64, covariance: Float64, weighting: RobustWeighting, min_weight: float) -> Float64:
    """Weights (n,) of measured minus expected ranges with a joint covariance (n, n); 0 for rejected ones.

    Each range is tested against all others (Baarda's data snooping), the worst is removed, and the rest is tested
    again: an uncertain pose or scale shifts all ranges together and causes no rejection.
    """
    use, weight = np.arange(len(residual_m)), np.zeros(len(residual_m))
    while len(use):
        information = np.linalg.inv(covariance[np.ix_(use, use)])
        off = (information @ residual_m[use]) / np.sqrt(np.diag(information))
        w = range_weight(off, weighting)
        worst = int(np.argmin(w))
        if w[worst] >= min_weight:
            weight[use] = w
            return weight
        use = np.delete(use, worst)
    return weight


class RangeGate:
    """Queue and gate of ranges, with the estimated scale and bias of every anchor."""

    def __init__(
        self, config: RangeGateConfig, tags: Mapping[str, Uwb], anchors: Mapping[str, tuple[float, float, float]]
    ) -> None:
        self.config, self._tags, self._number = config, tags, {tag: i for i, tag in enumerate(tags)}
        self.anchors_map_m = np.array(list(anchors.values()), np.float64).reshape(-1, 3)
        self._row = {name: i for i, name in enumerate(anchors)}
        self._queue: deque[UwbRanges] = deque(maxlen=KEEP)
        self._weighting = RobustWeighting(1.0, config.long_sigmas, config.short_sigmas)
        a = len(anchors)
        self.calibration = np.zeros(2 * a)
        self.calibration_covariance = np.zeros((2 * a, 2 * a))
        self.calibration_covariance[:a, :a] = shared_covariance(a, config.scale_sigma, config.scale_each_sigma)
        self.calibration_covariance[a:, a:] = shared_covariance(a, config.bias_sigma_m, config.bias_each_sigma_m)
        self.walk = np.repeat(np.square([config.scale_walk, config.bias_walk_m]), a)
        self._mean, self._count = np.zeros(a * len(tags)), np.zeros(a * len(tags))
        self.accepted_ns: int | None = None
        self.is_rejecting = False

    def add(self, ranges: UwbRanges) -> bool:
        """Queues the ranges of one tag; False when the message is inconsistent."""
        if ranges.tag not in self._tags or len(ranges.anchors) != len(ranges.range_m):
            return False
        self._queue.append(ranges)
        return True

    def clear(self) -> None:
        """Drops queued ranges, after a gap or clock jump."""
        self._queue.clear()
        self.accepted_ns = None

    def age_s(self, stamp_ns: int) -> float:
        """Age of the last consistent ranges, infinite without any."""
        return math.inf if self.accepted_ns is None else max(0, stamp_ns - self.accepted_ns) * 1e-9

    def is_active(self, stamp_ns: int) -> bool:
        """Whether consistent ranges are recent."""
        return self.age_s(stamp_ns) <= self.config.timeout_s

    def start(self, stamp_ns: int, batch: RangeBatch, T_map_body: Float64) -> None:
        """Starts from a pose confirmed by the mean of all ranges so far."""
        expected = expected_ranges(T_map_body, self.calibration, self.anchors_map_m, batch.arms_m, batch.rows)[0]
        self._mean[batch.pairs], self._count[batch.pairs] = batch.range_m - expected, self.config.averaged_ranges
        self._queue.clear()
        self.accepted_ns = stamp_ns

    def take(self, stamp_ns: int, history: PoseHistory, T_body_base: Float64) -> RangeBatch | None:
        """Ranges up to a time, with lever arms from the body then; None without ranges."""
        now, parts = history.at(stamp_ns), []
        while self._queue and self._queue[0].stamp_ns <= stamp_ns:
            ranges = self._queue.popleft()
            then = history.at(ranges.stamp_ns)
            if now is not None and then is not None:
                parts.append(self._batch(ranges, T_body_base @ invert(now) @ then))
        return _joined(parts)

    def mean_since(self, stamp_ns: int, T_body_base: Float64) -> RangeBatch | None:
        """Median of every pair of tag and anchor since a stamp at standstill; the queue is kept."""
        parts = [self._batch(ranges, T_body_base) for ranges in self._queue if ranges.stamp_ns >= stamp_ns]
        batch = _joined(parts)
        if batch is None:
            return None
        pairs, first, count = np.unique(batch.pairs, return_index=True, return_counts=True)
        median = np.array([np.median(batch.range_m[batch.pairs == pair]) for pair in pairs])
        sigma = batch.sigma_m[first] / np.sqrt(count)
        return RangeBatch(pairs, batch.rows[first], batch.arms_m[first], median, sigma)

    def _batch(self, ranges: UwbRanges, T_body_then: Float64) -> RangeBatch:
        tag = self._tags[ranges.tag]
        low, high = tag.range_m
        good = [i for i, n in enumerate(ranges.anchors) if n in self._row and low <= ranges.range_m[i] <= high]
        arm = np.asarray(apply(T_body_then, np.array([tag.mount.xyz_m], np.float64)), np.float64)
        rows = np.array([self._row[ranges.anchors[i]] for i in good], np.int64)
        sigma = np.full(len(good), tag.range_sigma_m * self.config.sigma_factor)
        pairs = rows + self._number[ranges.tag] * len(self._row)
        range_m = np.asarray(ranges.range_m, np.float64)[good]
        return RangeBatch(pairs, rows, np.repeat(arm, len(good), axis=0), range_m, sigma)

    def evaluate(self, batch: RangeBatch, T_map_body: Float64, covariance: Float64) -> RangeBatch:
        """Ranges consistent with a pose of covariance (6, 6) and with each other, singly and in the recent mean.

        A small delay behind a wall is below the noise of one range, but not of their mean; a large one is rejected at
        once and stays out of the mean.
        """
        expected, J, K = expected_ranges(T_map_body, self.calibration, self.anchors_map_m, batch.arms_m, batch.rows)
        residual, min_weight = batch.range_m - expected, self.config.min_weight
        predicted = J @ covariance @ J.T + K @ self.calibration_covariance @ K.T
        weight = consistent(residual, predicted + np.diag(batch.sigma_m**2), self._weighting, min_weight)
        for pair, r in zip(batch.pairs[weight > 0.0].tolist(), residual[weight > 0.0].tolist(), strict=True):
            self._count[pair] = min(self._count[pair] + 1.0, self.config.averaged_ranges)
            self._mean[pair] += (r - self._mean[pair]) / self._count[pair]
        pairs, first, group = np.unique(batch.pairs, return_index=True, return_inverse=True)
        white = batch.sigma_m[first] ** 2 / np.maximum(self._count[pairs], 1.0)
        of_mean = predicted[np.ix_(first, first)] + np.diag(white)
        lasting = consistent(self._mean[pairs], of_mean, self._weighting, min_weight)
        return batch.weighted(np.minimum(weight, lasting[group]))

    def accept(self, stamp_ns: int, batch: RangeBatch, kept: RangeBatch) -> bool:
        """Whether enough anchors are consistent; if so, UWB is active from this stamp."""
        is_enough = len(np.unique(kept.rows)) >= min(self.config.min_anchors, len(self._row))
        if is_enough:
            self.accepted_ns = stamp_ns
        self.is_rejecting = not is_enough and len(np.unique(batch.rows)) >= self.config.min_anchors
        return is_enough

    def disagreement(self, batch: RangeBatch, T_map_body: Float64, covariance: Float64) -> str:
        """Reason why the mean ranges at standstill do not confirm a pose, "" when they do."""
        self._count[:] = 0.0
        kept, received = self.evaluate(batch, T_map_body, covariance), len(np.unique(batch.rows))
        agreeing = len(np.unique(kept.rows))
        if agreeing >= self.config.min_anchors and agreeing >= self.config.min_agreeing_ratio * received:
            return ""
        return f"{agreeing} of {received} UWB anchors agree with the dock"


def _joined(parts: list[RangeBatch]) -> RangeBatch | None:
    parts = [p for p in parts if len(p.rows)]
    if not parts:
        return None
    columns = ([getattr(p, name) for p in parts] for name in RangeBatch.__dataclass_fields__)
    return RangeBatch(*(np.concatenate(c) for c in columns))
