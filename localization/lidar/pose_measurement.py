"""Poses in `map` that a lidar has found by its own map, on their way into the graph."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.transforms import Float64, invert, rotation_vector
from localization.dead_reckoning.dead_reckoning import PoseHistory
from messages.motion import LidarLocalization

KEEP = 20
PLANE = slice(2, 5)  # of rotation then translation: heading, x, y


class SightingConfig(Config):
    """When such a pose is believed, and how far."""

    gate_sigma: float = Field(gt=1.0, le=10.0)
    gate_floor_m: float = Field(gt=0.0, le=1.0, description="a difference that is never refused by sigma alone")
    gate_floor_deg: float = Field(gt=0.0, le=10.0)
    correlation_s: float = Field(ge=0.0, le=60.0, description="matches against one map share its errors for so long")
    slow_m: float = Field(ge=0.0, le=1.0, description="what averaging does not take away: survey and map")
    slow_deg: float = Field(ge=0.0, le=10.0)


@dataclass(frozen=True)
class Sighting:
    """A pose with its covariance (6, 6), rotation then translation, in its own axes."""

    T_map_base: Float64
    covariance: Float64


def is_sane(pose: LidarLocalization) -> bool:
    """Whether a pose may be looked at at all."""
    T, covariance = pose.T_map_base, pose.covariance
    shapes = T.shape == (4, 4) and covariance.shape == (6, 6)
    return pose.is_valid and shapes and bool(np.isfinite(T).all() and np.isfinite(covariance).all())


def agrees(seen: Sighting, T_map_base: Float64, covariance: Float64, config: SightingConfig) -> bool:
    """Whether heading and place lie near a predicted pose with its covariance (6, 6)."""
    off = invert(T_map_base) @ seen.T_map_base
    e = np.concatenate([rotation_vector(off[:3, :3]), off[:3, 3]])[PLANE]
    floor = np.array([math.radians(config.gate_floor_deg), config.gate_floor_m, config.gate_floor_m])
    S = (covariance + seen.covariance)[PLANE, PLANE] + np.diag((floor / config.gate_sigma) ** 2)
    return bool(e @ np.linalg.solve(S, e) <= config.gate_sigma**2)


class Sightings:
    """Holds poses until a keyframe takes them."""

    def __init__(self, config: SightingConfig) -> None:
        self._config = config
        self._waiting: deque[LidarLocalization] = deque(maxlen=KEEP)
        self._newest_ns: int | None = None

    def clear(self) -> None:
        """Forgets what waits."""
        self._waiting.clear()
        self._newest_ns = None

    def add(self, pose: LidarLocalization) -> None:
        """Takes the next one, unless it says itself that it is not to be used."""
        if is_sane(pose) and (self._newest_ns is None or pose.stamp_ns > self._newest_ns):
            self._waiting.append(pose)

    def take(self, stamp_ns: int, history: PoseHistory) -> list[Sighting]:
        """Those seen up to a time, moved on to it by dead reckoning."""
        now, out = history.at(stamp_ns), []
        while self._waiting and self._waiting[0].stamp_ns <= stamp_ns:
            pose = self._waiting.popleft()
            then = history.at(pose.stamp_ns)
            if now is not None and then is not None:
                moved = pose.T_map_base @ invert(then) @ now
                out.append(Sighting(moved, pose.covariance * self._growth(pose.stamp_ns)))
            self._newest_ns = pose.stamp_ns
        return out

    def _growth(self, stamp_ns: int) -> float:
        """By how much the variance must grow so that many of them say no more than there is to know."""
        apart_s = math.inf if self._newest_ns is None else (stamp_ns - self._newest_ns) * 1e-9
        return max(1.0, 2.0 * self._config.correlation_s / apart_s)
