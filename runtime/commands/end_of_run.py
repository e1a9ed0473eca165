"""When a simulated drive is over."""

from messages.command import Mode, SupervisorState
from messages.message import Envelope
from messages.plan import MissionState, MissionStatus
from messages.truth import TrueMachine

STANDING_MPS = 0.02
REST_S = 3.0  # a finished machine is watched this long
STUCK_S = 120.0  # nobody comes to help in simulation: a machine that stood this long will not go on
SLOWEST_MPS = 0.25  # a drive that is slower than this on the whole is given up
LATCHED = (Mode.FAULT_STOP, Mode.EMERGENCY_STOP)


class EndOfDrive:
    """A sink that notes when the mission has ended and the machine stands, or when nothing moves any more."""

    def __init__(self, length_m: float) -> None:
        self._limit_s = 600.0 + length_m / SLOWEST_MPS
        self._start_ns: int | None = None
        self._now_ns = 0
        self._moved_ns = 0
        self._is_over = False
        self._is_latched = False

    def __call__(self, envelope: Envelope) -> None:
        """Take note of a message."""
        message = envelope.message
        if self._start_ns is None:
            self._start_ns = self._moved_ns = envelope.receive_ns
        self._now_ns = envelope.receive_ns
        if isinstance(message, TrueMachine) and abs(message.speed_mps) > STANDING_MPS:
            self._moved_ns = envelope.receive_ns
        elif isinstance(message, MissionStatus):
            self._is_over = message.state in (MissionState.FINISHED, MissionState.ABORTED)
        elif isinstance(message, SupervisorState):
            self._is_latched = message.mode in LATCHED

    def is_reached(self) -> bool:
        """Whether there is nothing more to see."""
        if self._start_ns is None:
            return False
        still_s = (self._now_ns - self._moved_ns) * 1e-9
        rest_s = REST_S if self._is_over or self._is_latched else STUCK_S
        return still_s > rest_s or (self._now_ns - self._start_ns) * 1e-9 > self._limit_s
