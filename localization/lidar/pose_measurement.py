"""Pose measurements of lidar localization: validity, gate and propagation to keyframes."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64
from geometry.transforms import invert, rotation_vector
from localization.dead_reckoning.dead_reckoning import PoseHistory
from messages.motion import LidarLocalization

KEEP = 20
PLANE = slice(2, 5)  # of rotation then translation: heading, x, y


class PoseMeasurementConfig(Config):
    """Section `pose_measurement` of map alignment."""

    gate_sigma: float = Field(gt=1.0, le=10.0)
    gate_floor_m: float = Field(gt=0.0, le=1.0, description="smaller differences are never rejected by sigma alone")
    gate_floor_deg: float = Field(gt=0.0, le=10.0)
    correlation_s: float = Field(ge=0.0, le=60.0, description="of matches against one map")
    slow_m: float = Field(ge=0.0, le=1.0, description="error of survey and map, which does not average out")
    slow_deg: float = Field(ge=0.0, le=10.0)


@dataclass(frozen=True)
class PoseMeasurement:
    """A pose with covariance (6, 6), rotation then translation, in its own axes."""

    T_map_base: Float64
    covariance: Float64


def is_sane(pose: LidarLocalization) -> bool:
    """Whether a pose is valid and finite."""
    T, covariance = pose.T_map_base, pose.covariance
    shapes = T.shape == (4, 4) and covariance.shape == (6, 6)
    return pose.is_valid and shapes and bool(np.isfinite(T).all() and np.isfinite(covariance).all())


def agrees(measured: PoseMeasurement, T_map_base: Float64, covariance: Float64, config: PoseMeasurementConfig) -> bool:
    """Whether heading and position agree with a predicted pose with covariance (6, 6)."""
    error = invert(T_map_base) @ measured.T_map_base
    e = np.concatenate([rotation_vector(error[:3, :3]), error[:3, 3]])[PLANE]
    floor = np.array([math.radians(config.gate_floor_deg), config.gate_floor_m, config.gate_floor_m])
    S = (covariance + measured.covariance)[PLANE, PLANE] + np.diag((floor / config.gate_sigma) ** 2)
    return bool(e @ np.linalg.solve(S, e) <= config.gate_sigma**2)


class PoseMeasurements:
    """Queue of pose measurements until the next keyframe."""

    def __init__(self, config: PoseMeasurementConfig) -> None:
        self._config = config
        self._waiting: deque[LidarLocalization] = deque(maxlen=KEEP)
        self._newest_ns: int | None = None
        self.newest: LidarLocalization | None = None

    def clear(self) -> None:
        """Drops all queued poses."""
        self._waiting.clear()
        self._newest_ns = self.newest = None

    def add(self, pose: LidarLocalization) -> None:
        """Queues a pose if it is valid and newer than the last one taken; keeps the newest with its reason."""
        self.newest = pose
        if is_sane(pose) and (self._newest_ns is None or pose.stamp_ns > self._newest_ns):
            self._waiting.append(pose)

    def take(self, stamp_ns: int, history: PoseHistory) -> list[PoseMeasurement]:
        """Poses stamped up to a time, propagated to it by dead reckoning."""
        now, out = history.at(stamp_ns), []
        while self._waiting and self._waiting[0].stamp_ns <= stamp_ns:
            pose = self._waiting.popleft()
            then = history.at(pose.stamp_ns)
            if now is not None and then is not None:
                propagated = pose.T_map_base @ invert(then) @ now
                out.append(PoseMeasurement(propagated, pose.covariance * self._growth(pose.stamp_ns)))
            self._newest_ns = pose.stamp_ns
        return out

    def _growth(self, stamp_ns: int) -> float:
        """Factor on the variance for the time correlation of frequent measurements."""
        interval_s = math.inf if self._newest_ns is None else (stamp_ns - self._newest_ns) * 1e-9
        return max(1.0, 2.0 * self._config.correlation_s / interval_s)
