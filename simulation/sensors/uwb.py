"""UWB tag model: ranges to the anchors with non-line-of-sight (NLOS) bias, scale and bias of the radios."""

import math
from collections.abc import Mapping

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Uwb
from geometry.arrays import Float64
from messages.message import Message
from messages.sensors import UwbRanges
from simulation.environment.scenery import by_kind
from simulation.sensors.sensor import WorldState, period_ns_of

CLEAR_M = 0.3  # distance within which an anchor's own wall or mast is ignored
IS_THIN = by_kind(dict.fromkeys(("post", "mast", "fence", "gate", "crop"), 1.0)) > 0.0


class UwbConfig(Config):
    """Errors of the radios."""

    latency_s: float = Field(ge=0.0, le=0.5)
    scale_sigma: float = Field(ge=0.0, le=0.1, description="common to all ranges of a tag")
    bias_sigma_m: float = Field(ge=0.0, le=1.0, description="per anchor, constant")
    nlos_thin_bias_m: float = Field(ge=0.0, le=5.0, description="mean, behind a post")
    nlos_thick_bias_m: float = Field(ge=0.0, le=5.0, description="mean, behind a wall or vehicle")
    nlos_correlation_s: float = Field(gt=0.0, le=60.0, description="correlation time of the bias")
    dropout_probability: float = Field(ge=0.0, le=0.9, description="of a range in line of sight")
    nlos_thick_dropout_probability: float = Field(ge=0.0, le=0.99, description="of a range behind a wall")


class UwbModel:
    """One tag; `quality` is the power share of the first path, 1 in line of sight."""

    def __init__(
        self, name: str, uwb: Uwb, anchors: Mapping[str, tuple[float, float, float]], config: UwbConfig,
        random: np.random.Generator,
    ) -> None:  # fmt: skip
        self.topic = f"uwb/{name}"
        self.period_ns = period_ns_of(uwb.rate_hz)
        self.latency_ns = round(config.latency_s * 1e9)
        self._tag, self._uwb, self._config, self._random = name, uwb, config, random
        self._names = tuple(anchors)
        self._anchors_m = np.array([anchors[n] for n in self._names], np.float64).reshape(-1, 3)
        self._scale = 1.0 + config.scale_sigma * float(random.standard_normal())
        self._bias_m = config.bias_sigma_m * random.standard_normal(len(self._names))
        self._nlos_state = random.standard_normal(len(self._names))

    def sample(self, state: WorldState) -> Message:
        """The ranges received now."""
        config, random, n = self._config, self._random, len(self._names)
        tag = (state.poses.steps_ago(0) @ self._uwb.mount.T_base_sensor)[:3, 3]
        to = self._anchors_m - tag
        true_m = np.linalg.norm(to, axis=1)
        obstruction = self._obstructions(state, tag, to, true_m)  # 0 line of sight, 1 thin, 2 thick
        keep = math.exp(-self.period_ns * 1e-9 / config.nlos_correlation_s)
        self._nlos_state = keep * self._nlos_state + math.sqrt(1.0 - keep * keep) * random.standard_normal(n)
        nlos_bias = np.array([0.0, config.nlos_thin_bias_m, config.nlos_thick_bias_m])[obstruction] * np.exp(
            0.5 * self._nlos_state
        )
        spread = self._uwb.range_sigma_m * np.array([1.0, 1.5, 2.5])[obstruction] * random.standard_normal(n)
        range_m = self._scale * true_m + self._bias_m + nlos_bias + spread
        quality = np.array([0.9, 0.6, 0.3])[obstruction] + 0.05 * random.standard_normal(n)
        lost = np.array(
            [config.dropout_probability, config.dropout_probability, config.nlos_thick_dropout_probability]
        )[obstruction]
        low, high = self._uwb.range_m
        received = np.flatnonzero((random.random(n) >= lost) & (range_m >= low) & (range_m <= high))
        names = tuple(self._names[k] for k in received)
        return UwbRanges(state.stamp_ns, self._tag, names, range_m[received], np.clip(quality[received], 0.0, 1.0))

    def _obstructions(
        self, state: WorldState, tag: Float64, to: Float64, true_m: Float64
    ) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Obstruction of each range, (N,): rays from the anchor past its own wall, and actors as spheres."""
        u = to / np.maximum(true_m, 1e-6)[:, None]
        start = self._anchors_m - CLEAR_M * u
        rays = np.hstack([start, -u]).astype(np.float32)
        distance, kind, _ = state.scene.static.cast_surface(rays)
        obstruction = np.where(distance < true_m - 2.0 * CLEAR_M, np.where(IS_THIN[kind], 1, 2), 0)
        for actor in state.scene.actors:
            center, radius = actor.ball_m
            for k in range(len(true_m)):
                if obstruction[k] == 0 and intersects_ball(center, 0.7 * radius, tag, self._anchors_m[k]):
                    obstruction[k] = 2 if radius > 1.5 else 1
        return np.asarray(obstruction, np.int64)


def intersects_ball(center_m: Float64, radius_m: float, a_m: Float64, b_m: Float64) -> bool:
    """True if the line from a to b passes through a sphere."""
    line = b_m - a_m
    share = float(np.clip((center_m - a_m) @ line / max(float(line @ line), 1e-9), 0.0, 1.0))
    return float(np.linalg.norm(a_m + share * line - center_m)) < radius_m
