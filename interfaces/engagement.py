"""Who has the machine: from the safe command and what the steering answers to the phase the gateway is in.

RELEASED ──enabled──► OFFERING ──not limited──► ACTIVE ──steering gave up──► LOST
   ▲                   ▲   │                     │ │                          │
 manual            enabled │ not enabled         │ │ silence                  │ not enabled
   │                   │   ▼                     ▼ ▼                          ▼
   └─────────────── HOLDING ◄────fresh again─── SILENT                     HOLDING
"""

from dataclasses import dataclass
from enum import StrEnum

from interfaces.isobus import guidance
from messages.command import Mode, SafeCommand

STATUS_AGE_NS = 300_000_000
FRESH_TO_RECOVER = 8  # as many good ones in a row as a heartbeat needs to be believed again


class Phase(StrEnum):
    """What the gateway sends."""

    RELEASED = "released"
    HOLDING = "holding"
    OFFERING = "offering"
    ACTIVE = "active"
    LOST = "lost"
    SILENT = "silent"


@dataclass(frozen=True)
class Steering:
    """The steering's last word and when it came."""

    status: guidance.GuidanceStatus
    stamp_ns: int

    def is_given_up(self, now_ns: int) -> bool:
        """Whether it does not steer by our commands, as far as can be known."""
        status = self.status
        is_refused = status.limit in (guidance.LIMITED_BY_OPERATOR, guidance.NON_RECOVERABLE)
        is_out = status.exit_code not in (guidance.EXIT_CLEAR, guidance.EXIT_NOT_AVAILABLE)
        is_ready = status.is_steering_ready and not status.is_locked_out
        return is_refused or is_out or not is_ready or now_ns - self.stamp_ns > STATUS_AGE_NS

    def accepts(self, now_ns: int, offered_ns: int) -> bool:
        """Whether it answered an offer made at `offered_ns` by "not limited"."""
        is_answer = self.stamp_ns > offered_ns
        return is_answer and self.status.limit == guidance.NOT_LIMITED and not self.is_given_up(now_ns)


class Engagement:
    """The phase, step by step; silence of a supervisor that never spoke or had released the machine changes nothing."""

    def __init__(self) -> None:
        self.phase = Phase.RELEASED
        self.since_ns = 0
        self._fresh = 0
        self._stamp_ns = -1

    def step(self, now_ns: int, command: SafeCommand | None, steering: Steering) -> Phase:
        """The phase from now on; `command` is None when there is no fresh one."""
        phase = self._silenced() if command is None else self._commanded(now_ns, command, steering)
        if phase is not self.phase:
            self.phase, self.since_ns = phase, now_ns
        return phase

    def _silenced(self) -> Phase:
        self._fresh = 0
        return Phase.RELEASED if self.phase is Phase.RELEASED else Phase.SILENT

    def _commanded(self, now_ns: int, command: SafeCommand, steering: Steering) -> Phase:
        self._fresh += command.stamp_ns > self._stamp_ns
        self._stamp_ns = max(self._stamp_ns, command.stamp_ns)
        if command.mode is Mode.MANUAL:
            return Phase.RELEASED
        if self.phase is Phase.SILENT and self._fresh < FRESH_TO_RECOVER:
            return Phase.SILENT
        if not command.is_drive_enabled:
            return Phase.HOLDING
        return self._enabled(now_ns, steering)

    def _enabled(self, now_ns: int, steering: Steering) -> Phase:
        if self.phase is Phase.OFFERING:
            return Phase.ACTIVE if steering.accepts(now_ns, self.since_ns) else Phase.OFFERING
        if self.phase is Phase.ACTIVE:
            return Phase.LOST if steering.is_given_up(now_ns) else Phase.ACTIVE
        return Phase.LOST if self.phase is Phase.LOST else Phase.OFFERING
