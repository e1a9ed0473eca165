"""Whether the truth fits the returns: only a shift that fits markedly better shows a fault of the truth.

Each true box that should hold returns (by its range, size and the rays of the lidar) is scored at its place and at
shifts of all boxes in place, yaw and time. An object without returns scores zero everywhere: it is missed by the
sensor, which is no fault of the truth. A single standing object can coincide with any unlabelled thing, so that a
finding needs agreement of most objects at the same shift, and agreement by chance must be improbable. The share of
places within the search range at which an object fits at least as well is the chance that it does so at a random one;
the product of these shares over the objects that a shift improves, times the number of distinct shifts that are tried,
is the expected number of such shifts by chance. An object that moves fits nothing that stands, and seldom another one
that moves alike.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Bool, Float32, Float64
from geometry.pose2 import to_frame
from validation.obstacle_stop.boxes import Box
from validation.obstacle_stop.consistency.config import TruthLimits
from validation.obstacle_stop.consistency.finding import Finding, not_checked
from validation.obstacle_stop.consistency.truth_kernels import foot_m, points_around, score_at, scores_of_shifts
from validation.obstacle_stop.consistency.truth_shifts import Shifts, TrueBoxes

MAX_RANGE_M = 40.0
MAX_OBJECTS = 500  # bounds the memory; the first ones of a long log suffice
MIN_FRAMES = 3
INFORMATIVE = 0.4  # best score from which an object holds returns at some shift
MOVED_M = 2.0
MIN_VOTE = 0.1  # change of the score that matters
MIN_SHIFT_M = 0.4
DISTINCT_M = 0.8  # places closer than this are not independent
SAME_SCORE = 0.02
ALIKE = 0.03  # things within the search range that move as a moving object does, at a constant displacement


@dataclass
class _Object:
    """Sums of one object over frames: scores, scores without shift in the same frames, frames, extent in odom."""

    score: Float32
    unshifted: Float32
    frames: Float32
    low_m: Float64 = field(default_factory=lambda: np.full(2, np.inf))
    high_m: Float64 = field(default_factory=lambda: np.full(2, -np.inf))

    @property
    def is_moving(self) -> bool:
        return bool(np.hypot(*(self.high_m - self.low_m)) > MOVED_M)


@dataclass(frozen=True, eq=False)
class _Sample:
    stamp_ns: int
    points_m: Float32
    keep: int
    lidar: Lidar
    pose: Float64 | None
    truth_yaw_rad: float  # of the axes of the displacements in base


class TruthFit:
    """Call `add` with reduced scans and `advance` as truth arrives; `findings` names the better shift, if any."""

    def __init__(self, truth: TrueBoxes, limits: TruthLimits, max_age_s: float) -> None:
        self._truth, self._limits = truth, limits
        self._max_age_ns = round(max_age_s * 1e9)
        self._shifts = Shifts.of(limits, truth.has_machine)
        self._waiting: deque[_Sample] = deque()
        self._objects: dict[int, _Object] = {}
        self._scanned = 0

    def add(self, stamp_ns: int, points_m: Float32, keep: int, lidar: Lidar, pose: Float64 | None) -> None:
        """A scan, of which every `keep`-th return is given, and the pose of base in odom."""
        self._waiting.append(_Sample(stamp_ns, points_m, keep, lidar, pose, self._truth.yaw_at(stamp_ns)))

    def advance(self, is_end: bool = False) -> None:
        """Scores the scans for which the truth of all delays has arrived."""
        ahead_ns = round(self._limits.search_s * 1e9)
        while self._waiting and (is_end or self._waiting[0].stamp_ns + ahead_ns <= self._truth.latest_ns):
            self._score(self._waiting.popleft())

    def _score(self, sample: _Sample) -> None:
        boxes = self._truth.at(sample.stamp_ns, sample.stamp_ns, self._max_age_ns)
        expected = {i: self._expected_returns(box, sample) for i, box in boxes.items()}
        boxes = {i: box for i, box in boxes.items() if expected[i] >= self._limits.min_returns}
        if not boxes:
            return
        self._scanned += 1
        late = [
            self._truth.at(sample.stamp_ns + shift, sample.stamp_ns + round(d * 1e9), self._max_age_ns)
            for is_both in ((True, False) if self._shifts.has_objects_late else (True,))
            for d in self._shifts.delays_s.tolist()
            for shift in (round(d * 1e9) if is_both else 0,)
        ]
        for i, box in boxes.items():
            if i in self._objects or len(self._objects) < MAX_OBJECTS:
                self._score_object(sample, box, [boxes_then.get(i) for boxes_then in late], expected[i])

    def _score_object(self, sample: _Sample, box: Box, late: list[Box | None], expected: float) -> None:
        needed = min(max(0.2 * expected, 3.0), 20.0)
        size = 0.5 * float(np.hypot(*box.size_m[:2]))
        x, y = box.center_m[:2]
        lowest = min(foot_m(one) for one in (box, *late) if one is not None)
        wide = points_around(sample.points_m, x, y, 1.5 * self._limits.search_m + size, lowest)
        c, s = math.cos(sample.truth_yaw_rad), math.sin(sample.truth_yaw_rad)
        shifts = self._shifts.places_m @ np.array([[c, s], [-s, c]])
        places = scores_of_shifts(wide, box.center_m, box.size_m, box.yaw_rad, needed, shifts)
        others: list[float] = []
        for yaw in self._shifts.yaws_rad.tolist():
            origin = sample.lidar.mount.T_base_sensor[:2, 3]
            center = np.append(
                to_frame(np.array([*origin, yaw]), (box.center_m[:2] - origin)[None])[0], box.center_m[2]
            )
            others.append(score_at(wide, center, box.size_m, box.yaw_rad + yaw, needed))
        others.append(self._score_mirrored(sample, box, needed))
        for then in late:
            if then is None:
                others.append(math.nan)
                continue
            about = wide
            if np.hypot(*(then.center_m[:2] - box.center_m[:2])) > self._limits.search_m:
                about = points_around(sample.points_m, then.center_m[0], then.center_m[1], size + 1.0, lowest)
            others.append(score_at(about, then.center_m, then.size_m, then.yaw_rad, needed))
        zero_image, zero = (
            float(places[self._shifts.zero]),
            score_at(wide, box.center_m, box.size_m, box.yaw_rad, needed),
        )
        unshifted = np.concatenate([np.full(len(places), zero_image), np.full(len(others), zero)])
        self._accumulate(sample, box, np.concatenate([places, others]), unshifted)

    def _score_mirrored(self, sample: _Sample, box: Box, needed: float) -> float:
        """Score with left and right of the sensor swapped; as it is where that changes little."""
        across_m = 2.0 * float(box.center_m[1] - sample.lidar.mount.T_base_sensor[1, 3])
        center = box.center_m - np.array([0.0, across_m, 0.0])
        reach = 0.5 * float(np.hypot(*box.size_m[:2])) + 1.0
        about = points_around(sample.points_m, center[0], center[1], reach, foot_m(box))
        return score_at(about, center, box.size_m, -box.yaw_rad, needed)

    def _accumulate(self, sample: _Sample, box: Box, scores: Float64, unshifted: Float64) -> None:
        mine = self._objects.setdefault(box.id, _Object(*np.zeros((3, len(self._shifts)), np.float32)))
        is_known = np.isfinite(scores)
        mine.score += np.where(is_known, scores, 0.0).astype(np.float32)
        mine.unshifted += np.where(is_known, unshifted, 0.0).astype(np.float32)
        mine.frames += is_known
        if sample.pose is not None:
            place = to_frame(sample.pose, box.center_m[None, :2])[0]
            mine.low_m, mine.high_m = np.minimum(mine.low_m, place), np.maximum(mine.high_m, place)

    def _expected_returns(self, box: Box, sample: _Sample) -> float:
        """Returns that the rays of the lidar give for an unhidden box, of those kept."""
        T, lidar = sample.lidar.mount.T_base_sensor, sample.lidar
        d = T[:3, :3].T @ (box.center_m - T[:3, 3])
        range_m = float(np.hypot(d[0], d[1]))
        half_view = math.radians(0.5 * lidar.field_of_view_deg)
        if not 2.0 < range_m < min(MAX_RANGE_M, lidar.range_m[1]) or abs(math.atan2(d[1], d[0])) > half_view:
            return 0.0
        top, bottom = (math.degrees(math.atan2(d[2] + s * 0.5 * box.size_m[2], range_m)) for s in (1.0, -0.6))
        rings = sum(bottom < e < top for e in lidar.elevation_deg)
        width = min(float(box.size_m[:2].min()), 2.0) / range_m
        return rings * width / math.radians(lidar.field_of_view_deg) * lidar.columns / sample.keep

    def findings(self) -> list[Finding]:
        """The shift that fits markedly better, or why none can be found."""
        self.advance(is_end=True)
        objects = [o for o in self._objects.values() if o.frames[self._shifts.zero] >= MIN_FRAMES]
        numbers = {"objects": float(len(objects)), "scans": float(self._scanned)}
        if not objects:
            reason = f"no object in {MIN_FRAMES} scans where the lidar should see it"
            return [not_checked("place and time of the truth", reason, numbers)]
        with np.errstate(divide="ignore", invalid="ignore"):
            means = np.array([o.score / o.frames for o in objects])
            unshifted = np.array([o.unshifted / o.frames for o in objects])
        # a delay known in a few frames only is not compared
        is_enough = np.array([o.frames >= 0.3 * o.frames.max() for o in objects])
        means, unshifted = np.where(is_enough, means, np.nan), np.where(is_enough, unshifted, np.nan)
        numbers["objects_with_returns"] = float((np.nanmax(means, axis=1) >= INFORMATIVE).sum())
        if not numbers["objects_with_returns"]:
            reason = f"none of {len(objects)} objects holds returns at any shift"
            return [not_checked("place and time of the truth", reason, numbers)]
        return self._better(means, unshifted, np.array([o.is_moving for o in objects]), numbers)

    def _better(self, means: Float64, unshifted: Float64, is_moving: Bool, numbers: dict[str, float]) -> list[Finding]:
        """Objects vote for a shift or against it by their gain; one whose score hardly changes does not vote."""
        limits = self._limits
        known = np.isfinite(means)
        gains, scores = np.where(known, means - unshifted, 0.0), np.where(known, means, 0.0)
        does_vote, agrees = np.abs(gains) > MIN_VOTE, (gains > MIN_VOTE) & (scores >= INFORMATIVE)
        votes = np.maximum(does_vote.sum(axis=0), 1)
        gain = np.where(does_vote, gains, 0.0).sum(axis=0) / votes
        score = np.where(does_vote, scores, 0.0).sum(axis=0) / votes
        is_better = (score >= limits.min_score) & (gain >= limits.min_gain)
        is_better &= agrees.sum(axis=0) >= limits.min_share * votes
        # standing objects that the sensor misses coincide with many things; one that moves does not
        do_hold = (scores >= INFORMATIVE).sum(axis=0) >= limits.min_share * known.sum(axis=0)
        is_better &= do_hold | agrees[is_moving].any(axis=0)
        is_better &= self._by_chance(scores, agrees, is_moving) <= limits.max_by_chance
        is_better &= np.where(does_vote, gains, 0.0).sum(axis=0) >= 2.0 * limits.min_gain
        is_better &= np.array([self._size_m(k) >= MIN_SHIFT_M for k in range(len(score))])
        if not is_better.any():
            return []
        total = np.where(is_better, gains.sum(axis=0), -1.0)
        best = int(np.argmax(total))
        kinds = [self._best_of(kind, total) for kind in ("place", "yaw", "mirror", "time", "objects_time")]
        alike = [k for k in kinds if k is not None and total[k] > 0.85 * total[best]]
        texts = " or ".join(self._text_of(k) for k in sorted(alike, key=lambda k: -total[k]))
        numbers = numbers | {"score": float(score[best]), "score_unshifted": float(score[best] - gain[best])}
        for k in alike:
            kind, a, b = self._shifts.size_of(k)
            numbers |= {"place": {"shift_x_m": -a, "shift_y_m": -b}, "yaw": {"turn_deg": -a}, "mirror": {},
                        "time": {"delay_s": a}, "objects_time": {"objects_delay_s": a}}[kind]  # fmt: skip
        plural = "" if votes[best] == 1 else "s"
        text = (
            f"the truth does not fit the returns: they fit markedly better if it is {texts} (share of returns at the "
            f"faces of {votes[best]} object{plural} {100 * numbers['score']:.0f} % instead of "
            f"{100 * numbers['score_unshifted']:.0f} %)"
        )
        return [Finding("truth_shifted", text, numbers, True)]

    def _by_chance(self, scores: Float64, agrees: Bool, is_moving: Bool) -> Float64:
        """Expected number of shifts of the same kind at which the objects that agree fit as well by chance (S,).

        An object that fits as well without shift is no evidence for one.
        """
        wide = slice(self._shifts.first_wide, len(self._shifts.places_m))
        places, alike = self._shifts.places_m[wide], ALIKE / self._tries(0)
        out = np.array([self._tries(k) for k in range(scores.shape[1])])
        for row, does_agree, moves in zip(scores, agrees, is_moving, strict=True):
            mine = row[wide]
            if moves:  # its own returns are all at the best place
                apart = np.hypot(*(places - places[np.argmax(mine)]).T)
                mine = mine[apart > 2.0 * DISTINCT_M]
            share = 1.0 - np.searchsorted(np.sort(mine), row - SAME_SCORE) / len(mine)
            least = alike if moves else 1.0 / len(mine)
            out *= np.where(does_agree, np.maximum(share, least), 1.0)
        return out

    def _tries(self, k: int) -> float:
        kind = self._shifts.size_of(k)[0]
        if kind == "place":
            return (2.0 * self._limits.search_m / DISTINCT_M) ** 2
        return float({"yaw": len(self._shifts.yaws_rad), "mirror": 1}.get(kind, len(self._shifts.delays_s)))

    def _size_m(self, k: int) -> float:
        kind, a, b = self._shifts.size_of(k)
        return math.hypot(a, b) if kind == "place" else (1.0 if abs(a) > 1e-6 else 0.0)

    def _best_of(self, kind: str, gain: Float64) -> int | None:
        mine = [k for k in range(len(gain)) if gain[k] > 0.0 and self._shifts.size_of(k)[0] == kind]
        return max(mine, key=lambda k: float(gain[k]), default=None)

    def _text_of(self, k: int) -> str:
        """Error of the truth: the opposite of the displacement that corrects it."""
        kind, a, b = self._shifts.size_of(k)
        if kind == "place":
            axes = "along x and y of map" if self._truth.has_machine else "along and across (left positive)"
            return f"{-a:+.2f} m and {-b:+.2f} m {axes} out of place"
        if kind == "yaw":
            return f"turned by {-a:+.1f}°"
        if kind == "mirror":
            return "mirrored: left and right are swapped"
        what = "its objects are " if kind == "objects_time" else ""
        return f"{what}{abs(a):.1f} s {'late' if a > 0 else 'early'} against the scans"
