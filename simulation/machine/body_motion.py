"""Motion of the body on its tyres: pitch and roll under acceleration, and shaking by the ground."""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64
from geometry.transforms import transform


class BodyMotionConfig(Config):
    """Body as a damped oscillator in pitch and roll on the tyres of a tractor without suspension."""

    frequency_hz: float = Field(gt=0.1, le=20.0, description="natural frequency")
    damping: float = Field(gt=0.01, le=1.0, description="share of critical damping")
    pitch_deg_per_mps2: float = Field(ge=0.0, le=5.0, description="under longitudinal acceleration")
    roll_deg_per_mps2: float = Field(ge=0.0, le=5.0, description="under lateral acceleration")
    shake_deg_per_mps: float = Field(ge=0.0, le=2.0, description="sigma of pitch and roll by the ground, per speed")

    @property
    def is_rigid(self) -> bool:
        """Whether the body does not move against its wheels."""
        return self.pitch_deg_per_mps2 == self.roll_deg_per_mps2 == self.shake_deg_per_mps == 0.0


class BodyMotion:
    """Pitch and roll of the body against the ground under its wheels."""

    def __init__(self, config: BodyMotionConfig, dt_s: float, random: np.random.Generator) -> None:
        self._config, self._dt_s, self._random = config, dt_s, random
        self._omega = 2.0 * math.pi * config.frequency_hz
        self._angle, self._rate = np.zeros(2), np.zeros(2)

    def step(self, T_map_base: Float64, speed_mps: float, forward_mps2: float, left_mps2: float) -> Float64:
        """Pose of the body (4, 4) after a time step; equals `T_map_base` of a rigid body."""
        config, dt, omega = self._config, self._dt_s, self._omega
        if config.is_rigid:
            return T_map_base
        # braking lowers the nose (pitch about y is positive nose down); a turn to the left rolls to the right
        target = np.radians([config.roll_deg_per_mps2 * left_mps2, -config.pitch_deg_per_mps2 * forward_mps2])
        # white acceleration whose response has the configured sigma (Gauss-Markov oscillator, second order)
        sigma = math.radians(config.shake_deg_per_mps) * abs(speed_mps)
        white = 2.0 * sigma * math.sqrt(config.damping * omega**3 / dt) * self._random.standard_normal(2)
        self._rate += dt * (omega**2 * (target - self._angle) - 2.0 * config.damping * omega * self._rate + white)
        self._angle += dt * self._rate
        return T_map_base @ transform((0.0, 0.0, 0.0), np.array([self._angle[0], self._angle[1], 0.0]))
