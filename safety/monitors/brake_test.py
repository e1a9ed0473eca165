"""The brake is tried once, before the first metre: creep, brake, and stand within the stopping distance.

CREEP ──fast enough──► BRAKE ──stands in time──► PASSED
  ▲                      │ └────still rolling──► FAILED (emergency stop; tried again after a reset)
  └───driving ends───────┘
"""

from enum import IntEnum

from configs.vehicle import kmh
from messages.command import Mode
from safety.config import SafetyConfig
from safety.stopping_distance import stopping_distance


class Phase(IntEnum):
    """How far the trial has come."""

    CREEP = 0
    BRAKE = 1
    PASSED = 2
    FAILED = 3


class BrakeTest:
    """Follows the trial step by step."""

    def __init__(self, config: SafetyConfig) -> None:
        self.phase = Phase.CREEP
        self._config = config
        self._brake_mps = kmh(config.brake_test.brake_kmh)
        self._left_m = 0.0
        self._driven_m = 0.0

    def update(self, mode: Mode, speed_mps: float | None, driven_m: float) -> Phase:
        """The phase now; `driven_m` is the way driven so far."""
        if self.phase is Phase.PASSED or speed_mps is None:
            return self.phase
        if mode is not Mode.AUTOMATIC:
            self.phase = Phase.CREEP
        elif self.phase is Phase.CREEP and abs(speed_mps) >= self._brake_mps:
            self.phase, self._driven_m = Phase.BRAKE, driven_m
            self._left_m = stopping_distance(abs(speed_mps), self._config.braking.flat)
        elif self.phase is Phase.BRAKE:
            self.phase = self._judge(abs(speed_mps), driven_m - self._driven_m)
        return self.phase

    def _judge(self, speed_mps: float, distance_m: float) -> Phase:
        if distance_m > self._left_m:
            return Phase.FAILED
        return Phase.PASSED if speed_mps <= self._config.modes.standstill_mps else Phase.BRAKE
