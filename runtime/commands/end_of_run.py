"""End condition of a simulated drive."""

from messages.command import Mode, SupervisorState
from messages.message import Envelope
from messages.plan import MissionState, MissionStatus
from messages.truth import TrueMachine

STANDING_MPS = 0.02
REST_S = 3.0  # standstill after the end of the mission
STUCK_S = 120.0  # standstill that ends an unfinished drive; the simulated operator does not intervene
MIN_MEAN_SPEED_MPS = 0.25  # slower drives are aborted
USUAL_MEAN_SPEED_MPS = 1.6  # of the demo, stops included
LATCHED = (Mode.FAULT_STOP, Mode.EMERGENCY_STOP)


def expected_s(length_m: float, limit_s: float | None) -> float:
    """Usual duration of a drive along a planned path (s)."""
    usual_s = length_m / USUAL_MEAN_SPEED_MPS
    return usual_s if limit_s is None else min(usual_s, limit_s)


class EndOfDrive:
    """Sink that detects the end of the mission at standstill, or a stuck machine; `length_m` is the planned path.

    `limit_s` ends the drive in any case.
    """

    def __init__(self, length_m: float, limit_s: float | None = None) -> None:
        self._limit_s = 600.0 + length_m / MIN_MEAN_SPEED_MPS if limit_s is None else limit_s
        self._start_ns: int | None = None
        self._now_ns = 0
        self._moved_ns = 0
        self._has_ended = False
        self._is_latched = False

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        message = envelope.message
        if self._start_ns is None:
            self._start_ns = self._moved_ns = envelope.receive_ns
        self._now_ns = envelope.receive_ns
        if isinstance(message, TrueMachine) and abs(message.speed_mps) > STANDING_MPS:
            self._moved_ns = envelope.receive_ns
        elif isinstance(message, MissionStatus):
            self._has_ended = message.state in (MissionState.FINISHED, MissionState.ABORTED)
        elif isinstance(message, SupervisorState):
            self._is_latched = message.mode in LATCHED

    def is_reached(self) -> bool:
        """Whether the drive has ended."""
        if self._start_ns is None:
            return False
        standstill_s = (self._now_ns - self._moved_ns) * 1e-9
        rest_s = REST_S if self._has_ended or self._is_latched else STUCK_S
        return standstill_s > rest_s or (self._now_ns - self._start_ns) * 1e-9 > self._limit_s
