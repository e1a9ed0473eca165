"""Tag smoother: position of a UWB tag from ranges to anchors, with odometry or constant velocity.

A causal fixed-lag smoother on numpy: every anchor has a slowly drifting scale and bias, too long ranges have less
weight (see `range_weight`), and an unknown initial heading is found by several windows in parallel.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from configs.strict import Config
from geometry.angles import wrap
from geometry.arrays import Float64
from localization.uwb.motion_models import ConstantVelocityModel, MotionModel, OdometryModel
from localization.uwb.window import (
    Ranges,
    RobustWeighting,
    Window,
    WindowModel,
    append,
    cost,
    covariance,
    drop_oldest,
    range_rows,
    range_weight,
    solve,
)
from messages.errors import FieldError

MAX_COST_EXCESS = 20.0  # of a start above the best one: likelihood ratio e^-20
SAME_SIGMAS = 2.0  # root mean square of the difference of two windows that have become one


class TagSmootherConfig(Config):
    """Initial values of the unknowns, their drift, and weights of ranges, for any radio."""

    range_sigma_m: float = Field(gt=0.0, le=5.0, description="initial value, then estimated from the residuals")
    range_sigma_min_m: float = Field(gt=0.0, le=5.0)
    sigma_memory: float = Field(ge=1.0, le=1e5, description="ranges over which sigma is estimated")
    long_sigmas: float = Field(gt=0.0, le=100.0, description="residual of a too long range with half weight")
    short_sigmas: float = Field(gt=0.0, le=100.0, description="the same of a too short range")
    scale_sigma: float = Field(ge=0.0, le=0.5, description="common to all anchors of one make")
    scale_each_sigma: float = Field(gt=0.0, le=0.5, description="of each anchor")
    scale_walk: float = Field(ge=0.0, le=0.1, description="per root second")
    bias_sigma_m: float = Field(ge=0.0, le=20.0, description="common to all anchors")
    bias_each_sigma_m: float = Field(gt=0.0, le=20.0, description="of each anchor")
    bias_walk_m: float = Field(ge=0.0, le=1.0, description="per root second")
    start_sigma_deg: float = Field(gt=0.0, le=90.0, description="of each heading that a start without one tries")
    wheel_scale_sigma: float = Field(gt=0.0, le=0.5)
    gyro_bias_sigma_rps: float = Field(gt=0.0, le=0.5)
    acceleration_m2_s3: float = Field(gt=0.0, le=100.0, description="density of white acceleration without odometry")
    keyframes: int = Field(ge=2, le=200, description="length of the window")
    iterations: int = Field(ge=1, le=10)


@dataclass(frozen=True)
class OdometryStep:
    """Odometry between two keyframes in the axes of the first, with standard deviations."""

    forward_m: float
    left_m: float
    turn_rad: float
    sigma_forward_m: float
    sigma_left_m: float
    sigma_turn_rad: float


@dataclass(frozen=True)
class TagState:
    """`x` is (x, y, yaw) with odometry, else (x, y, vx, vy), with its covariance; scale and bias by anchor row."""

    stamp_ns: int
    x: Float64
    covariance: Float64
    scale: Float64
    bias_m: Float64


class TagSmoother:
    """Smoother of one tag; anchors are {name: (x, y, z)} in `map`, the tag is `arm_m` (forward, left) from base."""

    def __init__(
        self,
        config: TagSmootherConfig,
        anchors: Mapping[str, Float64],
        height_m: float,
        arm_m: tuple[float, float] = (0.0, 0.0),
        has_odometry: bool = True,
    ) -> None:
        if not anchors:
            raise FieldError("anchors is {}: at least one is needed")
        if not has_odometry and any(arm_m):
            raise FieldError(f"arm_m is {arm_m}: must be (0, 0) without odometry, since there is no heading")
        self._config, self._rows = config, {name: row for row, name in enumerate(anchors)}
        motion: MotionModel = OdometryModel() if has_odometry else ConstantVelocityModel(config.acceleration_m2_s3)
        weighting = RobustWeighting(config.range_sigma_m, config.long_sigmas, config.short_sigmas)
        positions = np.array(list(anchors.values()), np.float64).reshape(-1, 3)
        self._model = WindowModel(motion, positions, np.array(arm_m), height_m, weighting)
        self._windows: list[Window] = []
        self._costs: list[float] = []
        self._stamps_ns: list[int] = []
        self.state: TagState | None = None

    @property
    def range_sigma_m(self) -> float:
        """Estimated standard deviation of ranges."""
        return self._model.weighting.sigma_m

    def start(self, stamp_ns: int, starts: Sequence[Float64], sigma: Float64) -> None:
        """Starts at several candidate keyframes `starts` of standard deviation `sigma`; ranges select the best one."""
        c, a = self._config, len(self._rows)
        first = [c.wheel_scale_sigma, c.gyro_bias_sigma_rps][: self._model.motion.extra]
        zero = np.zeros((len(first), len(first)))
        scale = shared_covariance(a, c.scale_sigma, c.scale_each_sigma)
        bias = shared_covariance(a, c.bias_sigma_m, c.bias_each_sigma_m)
        self._walk = block_diag(zero, shared_covariance(a, 0.0, c.scale_walk), shared_covariance(a, 0.0, c.bias_walk_m))
        prior = block_diag(np.diag(np.square(first)), scale, bias, np.diag(np.square(sigma)))
        none, width = Ranges(*(np.zeros(0, t) for t in (np.int64, np.int64, float, float))), 7 if first else 1
        common, information = np.zeros(len(self._walk)), np.linalg.inv(prior)
        self._windows = [
            Window(common, x[None], np.zeros((0, width)), none, information, np.concatenate([common, x]))
            for x in starts
        ]
        self._costs, self._stamps_ns = [0.0] * len(starts), [stamp_ns]

    def start_from_ranges(self, stamp_ns: int, names: Sequence[str], range_m: Float64, moved_m: float) -> bool:
        """Starts from ranges to at least three anchors, received within `moved_m` of motion, and from nothing else.

        Every position and heading that they leave is followed until `is_unique`. The ranges must not be added again.
        """
        new = self._known_ranges(names, range_m, np.zeros(len(names)))
        if len(np.unique(new.anchor)) < min(3, len(self._rows)):
            return False
        places, sigma_m = positions(self._model, new, self._config)
        sigma_m = math.hypot(sigma_m, moved_m)
        if not self._model.motion.extra:
            self.start(stamp_ns, [np.array([*p, 0.0, 0.0]) for p in places], np.array([sigma_m, sigma_m, 1.5, 1.5]))
            return True
        turn_deg = self._config.start_sigma_deg
        starts = [x for p in places for x in start_headings(float(p[0]), float(p[1]), round(360.0 / turn_deg))]
        self.start(stamp_ns, starts, np.array([sigma_m, sigma_m, math.radians(turn_deg)]))
        return True

    def add(
        self, stamp_ns: int, step: OdometryStep | None, names: Sequence[str], range_m: Float64,
        age_s: Float64 | None = None,
    ) -> TagState:  # fmt: skip
        """Adds a keyframe with the ranges since the last; skips unknown anchors and ranges not in (0, inf).

        `step` is needed with odometry; `age_s` (n,), from range to keyframe, is used without odometry only.
        """
        dt_s = (stamp_ns - self._stamps_ns[-1]) * 1e-9
        if dt_s <= 0.0:
            raise FieldError(f"stamp_ns is {stamp_ns}: not after the last keyframe at {self._stamps_ns[-1]}")
        row = np.array([dt_s]) if step is None else _row(step, dt_s)
        new = self._known_ranges(names, range_m, np.zeros(len(names)) if age_s is None else age_s)
        extended = [self._extend(i, row, new) for i in range(len(self._windows))]
        self._stamps_ns.append(stamp_ns)
        if len(self._stamps_ns) > self._config.keyframes:
            walk = self._walk * (self._stamps_ns[1] - self._stamps_ns[0]) * 1e-9
            del self._stamps_ns[0]
            extended = [drop_oldest(self._model, w, walk) for w in extended]
        self._windows = extended
        self._prune()
        self._estimate_sigma(len(new.range_m))
        self.state = self._read(stamp_ns)
        return self.state

    def _known_ranges(self, names: Sequence[str], range_m: Float64, age_s: Float64) -> Ranges:
        good = [i for i, n in enumerate(names) if n in self._rows and 0.0 < range_m[i] < np.inf]
        rows = np.array([self._rows[names[i]] for i in good], np.int64)
        return Ranges(np.zeros(len(good), np.int64), rows, np.asarray(range_m)[good], np.asarray(age_s)[good])

    def _extend(self, i: int, row: Float64, new: Ranges) -> Window:
        window, motion = self._windows[i], self._model.motion
        guess = motion.predict(window.x[-1], window.common[: motion.extra], row)
        window = append(window, guess, row, new)
        if len(self._windows) > 1:
            self._costs[i] += cost(self._model, window) - cost(self._model, self._windows[i])
        return solve(self._model, window, self._config.iterations)

    @property
    def is_unique(self) -> bool:
        """Whether one of the starts is left."""
        return len(self._windows) == 1

    def _prune(self) -> None:
        """Drops windows of too high cost and those that end where a better one does; the best comes first."""
        best = min(self._costs)
        order = sorted((c, i) for i, c in enumerate(self._costs) if c - best <= MAX_COST_EXCESS)
        kept: list[tuple[float, int]] = []
        for c, i in order if len(order) > 1 else ():
            size, window = self._model.motion.size, self._windows[i]
            information = np.linalg.inv(covariance(self._model, window)[-size:, -size:])
            others = [self._apart(self._windows[k].x[-1], window.x[-1]) for _, k in kept]
            if all(d @ information @ d > size * SAME_SIGMAS**2 for d in others):
                kept.append((c, i))
        kept = kept or order
        self._windows = [self._windows[i] for _, i in kept]
        self._costs = [c - best for c, _ in kept]

    def _apart(self, a: Float64, b: Float64) -> Float64:
        """Difference of two keyframes, of headings the smaller one."""
        d = a - b
        if self._model.motion.extra:
            d[2] = wrap(float(d[2]))
        return d

    def _estimate_sigma(self, count: int) -> None:
        """Expectation maximisation of the scale of a Student t over the residuals of the window, with fading memory."""
        c, weighting = self._config, self._model.weighting
        residual, _ = range_rows(self._model, self._windows[0])
        if not count or not len(residual):
            return
        mean = float(np.mean(range_weight(residual, weighting) * residual**2)) * weighting.sigma_m**2
        share = min(1.0, count / c.sigma_memory)
        sigma = float(np.sqrt((1.0 - share) * weighting.sigma_m**2 + share * mean))
        self._model = replace(self._model, weighting=replace(weighting, sigma_m=max(sigma, c.range_sigma_min_m)))

    def _read(self, stamp_ns: int) -> TagState:
        window, size, a = self._windows[0], self._model.motion.size, len(self._rows)
        anchor = window.common[self._model.motion.extra :]
        P = covariance(self._model, window)[-size:, -size:]
        return TagState(stamp_ns, window.x[-1], 0.5 * (P + P.T), 1.0 + anchor[:a], anchor[a:])


def _row(step: OdometryStep, dt_s: float) -> Float64:
    return np.array(
        [
            step.forward_m,
            step.left_m,
            step.turn_rad,
            dt_s,
            step.sigma_forward_m,
            step.sigma_left_m,
            step.sigma_turn_rad,
        ]
    )


def shared_covariance(count: int, common: float, each: float) -> Float64:
    """Covariance (count, count) of values with a common and an individual standard deviation."""
    return np.full((count, count), common**2) + np.eye(count) * each**2


def start_headings(x_m: float, y_m: float, count: int) -> list[Float64]:
    """Start keyframes at one position with `count` headings, for an unknown heading."""
    return [np.array([x_m, y_m, 2.0 * np.pi * i / count]) for i in range(count)]


def positions(model: WindowModel, ranges: Ranges, config: TagSmootherConfig) -> tuple[list[Float64], float]:
    """Positions (2,) that ranges leave with scale and bias unknown, best first, and the sigma of the best one.

    The minima of the robust cost about the anchors; those worse by `MAX_COST_EXCESS` are no candidates.
    """
    anchors = model.anchors_m[ranges.anchor]
    sigma = math.hypot(config.range_sigma_m, config.bias_each_sigma_m)
    priors = np.array([config.scale_sigma, config.bias_sigma_m])

    def residual(u: Float64) -> Float64:
        d = np.hypot(np.linalg.norm(u[:2] - anchors[:, :2], axis=1), model.height_m - anchors[:, 2])
        return np.concatenate([(ranges.range_m - (1.0 + u[2]) * d - u[3]) / sigma, u[2:] / priors])

    center, reach_m = np.mean(anchors[:, :2], axis=0), float(np.median(ranges.range_m))
    turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    guesses = [center, *(center + reach_m * np.array([np.cos(t), np.sin(t)]) for t in turns)]
    found = [least_squares(residual, np.array([*g, 0.0, 0.0]), loss="soft_l1") for g in guesses]
    found = sorted(found, key=lambda f: float(f.cost))
    kept: list[Float64] = []
    for f in found:
        if f.cost - found[0].cost <= MAX_COST_EXCESS and all(np.linalg.norm(f.x[:2] - k) > sigma for k in kept):
            kept.append(f.x[:2])
    jacobian = np.asarray(found[0].jac, np.float64)
    P = np.linalg.pinv(jacobian.T @ jacobian)
    return kept, math.sqrt(float(np.linalg.eigvalsh(P[:2, :2])[1]))
