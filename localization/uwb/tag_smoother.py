"""Where a tag is from ranges to anchors by name, fused with odometry, or with constant velocity where there is none.

A causal fixed-lag smoother on numpy: every anchor has a scale and a bias that drift slowly, ranges that are too long
weigh less (see `range_weight`), and an unknown heading at the start is found by several windows side by side.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy.linalg import block_diag

from configs.strict import Config
from geometry.transforms import Float64
from localization.uwb.motion_models import Motion, Odometry, Velocity
from localization.uwb.window import (
    Gauge,
    Ranges,
    Scene,
    Window,
    append,
    cost,
    covariance,
    drop_oldest,
    range_rows,
    range_weight,
    solve,
)
from messages.errors import FieldError

GIVE_UP = 20.0  # a start whose cost is this much above the best is e^-20 as likely


class UwbConfig(Config):
    """One tuning for every radio: first values of the unknowns, their drift, and the weighing of ranges."""

    range_sigma_m: float = Field(gt=0.0, le=5.0, description="first guess; learned from the residuals afterwards")
    range_sigma_min_m: float = Field(gt=0.0, le=5.0)
    sigma_memory: float = Field(ge=1.0, le=1e5, description="ranges over which sigma is learned")
    late_sigmas: float = Field(gt=0.0, le=100.0, description="residual at which a range too long counts half")
    early_sigmas: float = Field(gt=0.0, le=100.0, description="the same for one too short")
    scale_sigma: float = Field(ge=0.0, le=0.5, description="of all anchors together: the same make of radio")
    scale_each_sigma: float = Field(gt=0.0, le=0.5, description="of each beside the others")
    scale_walk: float = Field(ge=0.0, le=0.1, description="per root second")
    bias_sigma_m: float = Field(ge=0.0, le=20.0, description="of all anchors together")
    bias_each_sigma_m: float = Field(gt=0.0, le=20.0, description="of each beside the others")
    bias_walk_m: float = Field(ge=0.0, le=1.0, description="per root second")
    wheel_scale_sigma: float = Field(gt=0.0, le=0.5)
    gyro_bias_sigma_rps: float = Field(gt=0.0, le=0.5)
    acceleration_m2_s3: float = Field(gt=0.0, le=100.0, description="density of white acceleration without odometry")
    keyframes: int = Field(ge=2, le=200, description="length of the window")
    iterations: int = Field(ge=1, le=10)


@dataclass(frozen=True)
class Step:
    """Odometry between two keyframes in the axes of the first, with its standard deviations."""

    forward_m: float
    left_m: float
    turn_rad: float
    sigma_forward_m: float
    sigma_left_m: float
    sigma_turn_rad: float


@dataclass(frozen=True)
class UwbState:
    """`x` is (x, y, yaw) with odometry, else (x, y, vx, vy), with its covariance; scale and bias by anchor row."""

    stamp_ns: int
    x: Float64
    covariance: Float64
    scale: Float64
    bias_m: Float64


class UwbLocalizer:
    """The filter for one tag; anchors are {name: (x, y, z)} in `map`, the tag stands `arm_m` ahead and left of base."""

    def __init__(
        self,
        config: UwbConfig,
        anchors: Mapping[str, Float64],
        height_m: float,
        arm_m: tuple[float, float] = (0.0, 0.0),
        has_odometry: bool = True,
    ) -> None:
        if not anchors:
            raise FieldError("anchors is {}: at least one is needed")
        if not has_odometry and any(arm_m):
            raise FieldError(f"arm_m is {arm_m}: must be (0, 0) without odometry, for there is no heading")
        self._config, self._rows = config, {name: row for row, name in enumerate(anchors)}
        motion: Motion = Odometry() if has_odometry else Velocity(config.acceleration_m2_s3)
        gauge = Gauge(config.range_sigma_m, config.late_sigmas, config.early_sigmas)
        where = np.array(list(anchors.values()), np.float64).reshape(-1, 3)
        self._scene = Scene(motion, where, np.array(arm_m), height_m, gauge)
        self._windows: list[Window] = []
        self._burden: list[float] = []
        self._stamps_ns: list[int] = []
        self.state: UwbState | None = None

    @property
    def range_sigma_m(self) -> float:
        """The spread of ranges as learned so far."""
        return self._scene.gauge.sigma_m

    def start(self, stamp_ns: int, starts: Sequence[Float64], sigma: Float64) -> None:
        """Begins at the likeliest of `starts` (each a keyframe), known to `sigma`; later ranges tell which it was."""
        c, a = self._config, len(self._rows)
        first = [c.wheel_scale_sigma, c.gyro_bias_sigma_rps][: self._scene.motion.extra]
        zero = np.zeros((len(first), len(first)))
        scale, bias = alike(a, c.scale_sigma, c.scale_each_sigma), alike(a, c.bias_sigma_m, c.bias_each_sigma_m)
        self._walk = block_diag(zero, alike(a, 0.0, c.scale_walk), alike(a, 0.0, c.bias_walk_m))
        known = block_diag(np.diag(np.square(first)), scale, bias, np.diag(np.square(sigma)))
        none, width = Ranges(*(np.zeros(0, t) for t in (np.int64, np.int64, float, float))), 7 if first else 1
        common, information = np.zeros(len(self._walk)), np.linalg.inv(known)
        self._windows = [
            Window(common, x[None], np.zeros((0, width)), none, information, np.concatenate([common, x]))
            for x in starts
        ]
        self._burden, self._stamps_ns = [0.0] * len(starts), [stamp_ns]

    def add(
        self, stamp_ns: int, step: Step | None, names: Sequence[str], range_m: Float64, age_s: Float64 | None = None
    ) -> UwbState:
        """One keyframe with the ranges heard since the last; unknown anchors and ranges not in (0, inf) are left out.

        `step` is needed with odometry; `age_s` (how long before the keyframe a range was taken) only counts without.
        """
        dt_s = (stamp_ns - self._stamps_ns[-1]) * 1e-9
        if dt_s <= 0.0:
            raise FieldError(f"stamp_ns is {stamp_ns}: not after the last keyframe at {self._stamps_ns[-1]}")
        row = np.array([dt_s]) if step is None else _row(step, dt_s)
        new = self._heard(names, range_m, np.zeros(len(names)) if age_s is None else age_s)
        grown = [self._grow(i, row, new) for i in range(len(self._windows))]
        self._stamps_ns.append(stamp_ns)
        if len(self._stamps_ns) > self._config.keyframes:
            walk = self._walk * (self._stamps_ns[1] - self._stamps_ns[0]) * 1e-9
            del self._stamps_ns[0]
            grown = [drop_oldest(self._scene, w, walk) for w in grown]
        self._windows = grown
        self._choose()
        self._learn_sigma(len(new.range_m))
        self.state = self._read(stamp_ns)
        return self.state

    def _heard(self, names: Sequence[str], range_m: Float64, age_s: Float64) -> Ranges:
        good = [i for i, n in enumerate(names) if n in self._rows and 0.0 < range_m[i] < np.inf]
        rows = np.array([self._rows[names[i]] for i in good], np.int64)
        return Ranges(np.zeros(len(good), np.int64), rows, np.asarray(range_m)[good], np.asarray(age_s)[good])

    def _grow(self, i: int, row: Float64, new: Ranges) -> Window:
        window, motion = self._windows[i], self._scene.motion
        guess = motion.predict(window.x[-1], window.common[: motion.extra], row)
        window = append(window, guess, row, new)
        if len(self._windows) > 1:
            self._burden[i] += cost(self._scene, window) - cost(self._scene, self._windows[i])
        return solve(self._scene, window, self._config.iterations)

    def _choose(self) -> None:
        """Drops what is clearly worse than the best; the best stands first."""
        best = min(self._burden)
        kept = sorted(((b, i) for i, b in enumerate(self._burden) if b - best <= GIVE_UP), key=lambda pair: pair)
        self._windows = [self._windows[i] for _, i in kept]
        self._burden = [b - best for b, _ in kept]

    def _learn_sigma(self, count: int) -> None:
        """Expectation and maximisation for the scale of a Student t over the window's residuals, slowly forgetting."""
        c, gauge = self._config, self._scene.gauge
        residual, _ = range_rows(self._scene, self._windows[0])
        if not count or not len(residual):
            return
        mean = float(np.mean(range_weight(residual, gauge) * residual**2)) * gauge.sigma_m**2
        share = min(1.0, count / c.sigma_memory)
        sigma = float(np.sqrt((1.0 - share) * gauge.sigma_m**2 + share * mean))
        self._scene = replace(self._scene, gauge=replace(gauge, sigma_m=max(sigma, c.range_sigma_min_m)))

    def _read(self, stamp_ns: int) -> UwbState:
        window, size, a = self._windows[0], self._scene.motion.size, len(self._rows)
        anchor = window.common[self._scene.motion.extra :]
        P = covariance(self._scene, window)[-size:, -size:]
        return UwbState(stamp_ns, window.x[-1], 0.5 * (P + P.T), 1.0 + anchor[:a], anchor[a:])


def _row(step: Step, dt_s: float) -> Float64:
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


def alike(count: int, common: float, each: float) -> Float64:
    """Covariance of `count` equal things: standard deviations of what they share and of what is each one's own."""
    return np.full((count, count), common**2) + np.eye(count) * each**2


def headings(x_m: float, y_m: float, count: int) -> list[Float64]:
    """Starts at one place looking to `count` sides, for a start without a known heading."""
    return [np.array([x_m, y_m, 2.0 * np.pi * i / count]) for i in range(count)]
