"""UWB ranges on their way into the graph: checked, brought to a keyframe, and rid of what came round a corner."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Uwb
from geometry.transforms import Float64, apply, invert
from localization.dead_reckoning.dead_reckoning import PoseHistory
from localization.graph.uwb_factor import expected_ranges
from localization.uwb.tag_smoother import alike
from localization.uwb.window import Gauge, range_weight
from messages.message import Int64
from messages.sensors import UwbRanges

KEEP = 60


class RangingConfig(Config):
    """Weighing of ranges and what is known of their scale and bias before the first one; see `UwbConfig`."""

    sigma_factor: float = Field(ge=1.0, le=20.0, description="on the data sheet's sigma: errors that last for a while")
    late_sigmas: float = Field(gt=0.0, le=100.0, description="residual at which a range too long counts half")
    early_sigmas: float = Field(gt=0.0, le=100.0, description="the same for one too short")
    least_weight: float = Field(gt=0.0, le=1.0, description="a range that would count less is left out")
    scale_sigma: float = Field(ge=0.0, le=0.5, description="of all anchors together")
    scale_each_sigma: float = Field(gt=0.0, le=0.5)
    scale_walk: float = Field(gt=0.0, le=0.1, description="per root second")
    bias_sigma_m: float = Field(ge=0.0, le=20.0)
    bias_each_sigma_m: float = Field(gt=0.0, le=20.0)
    bias_walk_m: float = Field(gt=0.0, le=1.0, description="per root second")
    least_anchors: int = Field(ge=2, le=20, description="that must agree at one keyframe, or at the start")
    agreeing_share: float = Field(gt=0.0, le=1.0, description="of the anchors heard at the start")
    memory: int = Field(ge=1, le=1000, description="ranges of one anchor over which lateness is told from noise")
    silent_s: float = Field(gt=0.0, le=10.0, description="without agreeing ranges for longer UWB holds no position")


@dataclass(frozen=True)
class Heard:
    """n ranges brought to one time: pair of tag and anchor, anchor, arm (n, 3) from the body, metres and sigmas."""

    pairs: Int64
    rows: Int64
    arms_m: Float64
    range_m: Float64
    sigma_m: Float64

    def only(self, weight: Float64) -> "Heard":
        """Those with a weight above zero, their sigmas grown by it."""
        use = weight > 0.0
        sigma = self.sigma_m[use] / np.sqrt(weight[use])
        return Heard(self.pairs[use], self.rows[use], self.arms_m[use], self.range_m[use], sigma)


def consistent(residual_m: Float64, covariance: Float64, gauge: Gauge, least: float) -> Float64:
    """Weights (n,) of measured minus expected ranges with a joint covariance (n, n); 0 for those left out.

    Each is judged against all the others (Baarda's data snooping), the worst goes, and the rest is judged anew: a pose
    or a scale that is not known well moves all ranges together and condemns none of them.
    """
    use, weight = np.arange(len(residual_m)), np.zeros(len(residual_m))
    while len(use):
        information = np.linalg.inv(covariance[np.ix_(use, use)])
        off = (information @ residual_m[use]) / np.sqrt(np.diag(information))
        w = range_weight(off, gauge)
        worst = int(np.argmin(w))
        if w[worst] >= least:
            weight[use] = w
            return weight
        use = np.delete(use, worst)
    return weight


class Ranging:
    """Holds ranges until a keyframe takes them, and what the graph has learned of scale and bias by anchor."""

    def __init__(
        self, config: RangingConfig, tags: Mapping[str, Uwb], anchors: Mapping[str, tuple[float, float, float]]
    ) -> None:
        self.config, self._tags, self._number = config, tags, {tag: i for i, tag in enumerate(tags)}
        self.anchors_map_m = np.array(list(anchors.values()), np.float64).reshape(-1, 3)
        self._row = {name: i for i, name in enumerate(anchors)}
        self._waiting: deque[UwbRanges] = deque(maxlen=KEEP)
        self._gauge = Gauge(1.0, config.late_sigmas, config.early_sigmas)
        a = len(anchors)
        self.calibration = np.zeros(2 * a)
        self.calibration_covariance = np.zeros((2 * a, 2 * a))
        self.calibration_covariance[:a, :a] = alike(a, config.scale_sigma, config.scale_each_sigma)
        self.calibration_covariance[a:, a:] = alike(a, config.bias_sigma_m, config.bias_each_sigma_m)
        self.walk = np.repeat(np.square([config.scale_walk, config.bias_walk_m]), a)
        self._mean, self._count = np.zeros(a * len(tags)), np.zeros(a * len(tags))
        self.accepted_ns: int | None = None
        self.is_refusing = False

    def add(self, heard: UwbRanges) -> bool:
        """Takes what one tag heard; False when the message makes no sense."""
        if heard.tag not in self._tags or len(heard.anchors) != len(heard.range_m):
            return False
        self._waiting.append(heard)
        return True

    def clear(self) -> None:
        """Forgets what waits, as after a clock that jumped."""
        self._waiting.clear()
        self.accepted_ns = None

    def age_s(self, stamp_ns: int) -> float:
        """Age of the last ranges that agreed, infinite when there are none."""
        return math.inf if self.accepted_ns is None else max(0, stamp_ns - self.accepted_ns) * 1e-9

    def is_alive(self, stamp_ns: int) -> bool:
        """Whether enough ranges agreed a moment ago."""
        return self.age_s(stamp_ns) <= self.config.silent_s

    def begin(self, stamp_ns: int, heard: Heard, T_map_body: Float64) -> None:
        """Starts from a pose that has been compared with the mean of all ranges so far."""
        expected = expected_ranges(T_map_body, self.calibration, self.anchors_map_m, heard.arms_m, heard.rows)[0]
        self._mean[heard.pairs], self._count[heard.pairs] = heard.range_m - expected, self.config.memory
        self._waiting.clear()
        self.accepted_ns = stamp_ns

    def take(self, stamp_ns: int, history: PoseHistory, T_body_base: Float64) -> Heard | None:
        """What was heard up to a time, seen from the body then; None when nothing was."""
        now, parts = history.at(stamp_ns), []
        while self._waiting and self._waiting[0].stamp_ns <= stamp_ns:
            heard = self._waiting.popleft()
            then = history.at(heard.stamp_ns)
            if now is not None and then is not None:
                parts.append(self._brought(heard, T_body_base @ invert(now) @ then))
        return _joined(parts)

    def since(self, stamp_ns: int, T_body_base: Float64) -> Heard | None:
        """The mean of every pair of tag and anchor since a time at which the machine stood; nothing is taken away."""
        parts = [self._brought(h, T_body_base) for h in self._waiting if h.stamp_ns >= stamp_ns]
        heard = _joined(parts)
        if heard is None:
            return None
        pairs, first, count = np.unique(heard.pairs, return_index=True, return_counts=True)
        middle = np.array([np.median(heard.range_m[heard.pairs == pair]) for pair in pairs])
        sigma = heard.sigma_m[first] / np.sqrt(count)
        return Heard(pairs, heard.rows[first], heard.arms_m[first], middle, sigma)

    def _brought(self, heard: UwbRanges, T_body_then: Float64) -> Heard:
        tag = self._tags[heard.tag]
        low, high = tag.range_m
        good = [i for i, n in enumerate(heard.anchors) if n in self._row and low <= heard.range_m[i] <= high]
        arm = np.asarray(apply(T_body_then, np.array([tag.mount.xyz_m], np.float64)), np.float64)
        rows = np.array([self._row[heard.anchors[i]] for i in good], np.int64)
        sigma = np.full(len(good), tag.range_sigma_m * self.config.sigma_factor)
        pairs = rows + self._number[heard.tag] * len(self._row)
        return Heard(pairs, rows, np.repeat(arm, len(good), axis=0), np.asarray(heard.range_m, np.float64)[good], sigma)

    def judge(self, heard: Heard, T_map_body: Float64, covariance: Float64) -> Heard:
        """What agrees with a pose, known to a covariance (6, 6), and with itself: now, and in the mean of late.

        A small delay behind a wall hides in the noise of one range, but not in that of many; a large one shows at once
        and stays out of the mean.
        """
        expected, J, K = expected_ranges(T_map_body, self.calibration, self.anchors_map_m, heard.arms_m, heard.rows)
        residual, least = heard.range_m - expected, self.config.least_weight
        known = J @ covariance @ J.T + K @ self.calibration_covariance @ K.T
        weight = consistent(residual, known + np.diag(heard.sigma_m**2), self._gauge, least)
        for pair, r in zip(heard.pairs[weight > 0.0].tolist(), residual[weight > 0.0].tolist(), strict=True):
            self._count[pair] = min(self._count[pair] + 1.0, self.config.memory)
            self._mean[pair] += (r - self._mean[pair]) / self._count[pair]
        pairs, first, group = np.unique(heard.pairs, return_index=True, return_inverse=True)
        white = heard.sigma_m[first] ** 2 / np.maximum(self._count[pairs], 1.0)
        settled = known[np.ix_(first, first)] + np.diag(white)
        lasting = consistent(self._mean[pairs], settled, self._gauge, least)
        return heard.only(np.minimum(weight, lasting[group]))

    def accept(self, stamp_ns: int, heard: Heard, kept: Heard) -> bool:
        """Whether enough anchors agree to be used; counts as UWB's sign of life."""
        enough = len(np.unique(kept.rows)) >= min(self.config.least_anchors, len(self._row))
        if enough:
            self.accepted_ns = stamp_ns
        self.is_refusing = not enough and len(np.unique(heard.rows)) >= self.config.least_anchors
        return enough

    def disagreement(self, heard: Heard, T_map_body: Float64, covariance: Float64) -> str:
        """Why the mean of ranges at standstill does not confirm a pose, "" when it does."""
        self._count[:] = 0.0
        kept, there = self.judge(heard, T_map_body, covariance), len(np.unique(heard.rows))
        agreeing = len(np.unique(kept.rows))
        if agreeing >= self.config.least_anchors and agreeing >= self.config.agreeing_share * there:
            return ""
        return f"{agreeing} of {there} UWB anchors agree with the dock"


def _joined(parts: list[Heard]) -> Heard | None:
    parts = [p for p in parts if len(p.rows)]
    if not parts:
        return None
    columns = ([getattr(p, name) for p in parts] for name in Heard.__dataclass_fields__)
    return Heard(*(np.concatenate(c) for c in columns))
