"""Brake proof test (IEC 61508), once before the first metre: creep, brake, standstill within the stopping distance.

CREEP ──test speed──► BRAKE ──standstill within S──► PASSED
  ▲                     │ └──────────beyond S──────► FAILED (emergency stop; repeated after a reset)
  └──end of automatic───┘

Until the brake acts the machine gains speed towards that of the test: S is that of the highest speed up to this one.
"""

from enum import IntEnum

from configs.vehicle import kmh
from messages.command import Mode
from safety.config import SafetyConfig
from safety.stopping_distance import Braking, stopping_distance


class Phase(IntEnum):
    """Phase of the proof test."""

    CREEP = 0
    BRAKE = 1
    PASSED = 2
    FAILED = 3


class BrakeTest:
    """Keeps the phase of the proof test."""

    def __init__(self, config: SafetyConfig) -> None:
        self.phase = Phase.CREEP
        self._config = config
        self._brake_mps, self._test_mps = kmh(config.brake_test.brake_kmh), kmh(config.brake_test.speed_kmh)
        self._highest_mps = 0.0
        self._started_at_m = 0.0

    def update(self, mode: Mode, speed_mps: float | None, driven_m: float, braking: Braking) -> Phase:
        """Phase now; `driven_m` is the total distance driven, `braking` that on this grade."""
        if self.phase is Phase.PASSED or speed_mps is None:
            return self.phase
        if mode is not Mode.AUTOMATIC:
            self.phase = Phase.CREEP
        elif self.phase is Phase.CREEP and abs(speed_mps) >= self._brake_mps:
            self.phase, self._started_at_m, self._highest_mps = Phase.BRAKE, driven_m, abs(speed_mps)
        elif self.phase is Phase.BRAKE:
            self.phase = self._result(abs(speed_mps), driven_m - self._started_at_m, braking)
        return self.phase

    def _result(self, speed_mps: float, distance_m: float, braking: Braking) -> Phase:
        self._highest_mps = max(self._highest_mps, min(speed_mps, self._test_mps))
        if distance_m > stopping_distance(self._highest_mps, braking):
            return Phase.FAILED
        return Phase.PASSED if speed_mps <= self._config.modes.standstill_mps else Phase.BRAKE
