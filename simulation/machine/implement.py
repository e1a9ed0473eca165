"""Implement: hitch, power take-off, draft, heading and covered ground."""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import MountedImplement, TrailedImplement
from geometry.arrays import Float64
from simulation.machine.steering import clamp, follow_lag

WORKING_BELOW = 0.1  # hitch: 0 lowest, 1 highest
RAISED_ABOVE = 0.95  # hitch: folding is allowed above
RADPS_PER_RPM = 2.0 * math.pi / 60.0


class ImplementConfig(Config):
    """Draft of the implement, and the power take-off."""

    draft_n_per_m: float = Field(ge=0.0, le=20000.0, description="draft per working width")
    max_draft_n: float = Field(
        ge=0.0, le=100000.0, description="a wide implement works less deep, so that it is pulled"
    )
    draft_sigma: float = Field(ge=0.0, le=1.0, description="relative standard deviation")
    draft_correlation_s: float = Field(gt=0.0, le=60.0, description="correlation time of the soil's variation")
    pto_rpm: float = Field(gt=0.0, le=2000.0)
    pto_lag_s: float = Field(ge=0.0, le=10.0)


class AttachedImplement:
    """Hitch, shaft, folding wings and, on a drawbar, the implement's own heading."""

    def __init__(
        self, implement: MountedImplement | TrailedImplement, config: ImplementConfig, yaw_rad: float, is_folded: bool,
        dt_s: float, random: np.random.Generator,
    ) -> None:  # fmt: skip
        self.hitch = 1.0
        self.pto_radps = 0.0
        self.yaw_rad = yaw_rad
        self.implement = implement
        self.fold = float(is_folded and can_fold(implement))
        self._config, self._dt_s, self._random = config, dt_s, random
        self._draft_change = 0.0

    @property
    def is_working(self) -> bool:
        """True if the tools are in the ground."""
        return self.hitch < WORKING_BELOW

    def step(self, hitch_target: float | None, is_pto_on: bool) -> None:
        """Moves hitch and shaft for one time step; None holds the hitch."""
        if hitch_target is not None:
            self.hitch = step_hitch(self.hitch, hitch_target, self.implement.lift_s, self.implement.lower_s, self._dt_s)
        target = self._config.pto_rpm * RADPS_PER_RPM if is_pto_on and self.implement.uses_pto else 0.0
        self.pto_radps = follow_lag(self.pto_radps, target, self._config.pto_lag_s, self._dt_s)
        share = math.exp(-self._dt_s / self._config.draft_correlation_s)
        white = float(self._random.standard_normal()) * self._config.draft_sigma
        self._draft_change = share * self._draft_change + math.sqrt(1.0 - share * share) * white

    def step_fold(self, is_folded: bool) -> None:
        """Folds or unfolds for one time step; only raised, and if the implement folds."""
        if isinstance(self.implement, MountedImplement) and self.implement.fold and self.hitch > RAISED_ABOVE:
            change = self._dt_s / max(self.implement.fold.duration_s, self._dt_s)
            self.fold += clamp(float(is_folded) - self.fold, -change, change)

    @property
    def current(self) -> MountedImplement | TrailedImplement:
        """The implement with its present width."""
        return at_fold(self.implement, self.fold)

    def draft_n(self) -> float:
        """Draft against the motion."""
        if not self.is_working:
            return 0.0
        mean_n = min(self._config.draft_n_per_m * self.implement.working_width_m, self._config.max_draft_n)
        return mean_n * max(0.0, 1.0 + self._draft_change)

    def follow(self, yaw_rad: float, speed_mps: float, lateral_mps: float, yaw_rate_radps: float) -> None:
        """Heading: that of the machine, or trailing on a drawbar."""
        if isinstance(self.implement, MountedImplement):
            self.yaw_rad = yaw_rad
            return
        side = lateral_mps + yaw_rate_radps * self.implement.hitch_m
        angle = yaw_rad - self.yaw_rad
        cross = speed_mps * math.sin(angle) + side * math.cos(angle)
        self.yaw_rad += cross / self.implement.axle_length_m * self._dt_s


def can_fold(implement: MountedImplement | TrailedImplement) -> bool:
    """Whether it has wings that turn."""
    return isinstance(implement, MountedImplement) and implement.fold is not None


def at_fold(implement: MountedImplement | TrailedImplement, fold: float) -> MountedImplement | TrailedImplement:
    """The implement with its width between working (0) and transport (1)."""
    if fold <= 0.0 or implement.folded is implement:
        return implement
    width_m = (1.0 - fold) * implement.width_m + fold * implement.folded.width_m
    return implement.model_copy(update={"width_m": width_m})


def step_hitch(hitch: float, target: float, lift_s: float, lower_s: float, dt_s: float) -> float:
    """Hitch position after a time step: full stroke in `lift_s` up and `lower_s` down."""
    return hitch + clamp(target - hitch, -dt_s / lower_s, dt_s / lift_s)


def working_point_m(
    implement: MountedImplement | TrailedImplement, base: tuple[float, float, float], yaw_rad: float
) -> Float64:
    """The working point in `map`, (2,), for base at (x, y, yaw) and the implement's own heading."""
    reach = implement.working_point_m if isinstance(implement, MountedImplement) else -implement.working_length_m
    return origin_m(implement, base) + reach * np.array([math.cos(yaw_rad), math.sin(yaw_rad)])


def origin_m(implement: MountedImplement | TrailedImplement, base: tuple[float, float, float]) -> Float64:
    """The implement's pivot in `map`: base if mounted, else the hitch."""
    x, y, yaw = base
    hitch = 0.0 if isinstance(implement, MountedImplement) else implement.hitch_m
    return np.array([x + hitch * math.cos(yaw), y + hitch * math.sin(yaw)])


def extent_m(implement: MountedImplement | TrailedImplement) -> tuple[float, float]:
    """Front and rear end along the implement's x from its origin."""
    if isinstance(implement, MountedImplement):
        return implement.front_end_m, implement.rear_end_m
    behind = implement.total_length_m - implement.working_length_m
    return -(implement.working_length_m - behind), -implement.total_length_m
