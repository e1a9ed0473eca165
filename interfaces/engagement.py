"""Engagement of the gateway: phases by safe command and state of the steering.

RELEASED ──enabled──► OFFERING ──not limited──► ACTIVE ──disengaged────────► LOST
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
FRESH_TO_RECOVER = 8  # consecutive fresh commands, as for a heartbeat


class Phase(StrEnum):
    """Phase of the gateway, which selects the commands sent."""

    RELEASED = "released"
    HOLDING = "holding"
    OFFERING = "offering"
    ACTIVE = "active"
    LOST = "lost"
    SILENT = "silent"


@dataclass(frozen=True)
class Steering:
    """Last status of the steering and its time of reception."""

    status: guidance.GuidanceStatus
    stamp_ns: int

    def is_disengaged(self, now_ns: int) -> bool:
        """Whether the steering does not follow commands: refused, exited, not ready, locked out or timed out."""
        status = self.status
        is_refused = status.limit in (guidance.LIMITED_BY_OPERATOR, guidance.NON_RECOVERABLE)
        is_out = status.exit_code not in (guidance.EXIT_CLEAR, guidance.EXIT_NOT_AVAILABLE)
        is_ready = status.is_steering_ready and not status.is_locked_out
        return is_refused or is_out or not is_ready or now_ns - self.stamp_ns > STATUS_AGE_NS

    def accepts(self, now_ns: int, offered_ns: int) -> bool:
        """Whether it answered the offer made at `offered_ns` with "not limited"."""
        is_answer = self.stamp_ns > offered_ns
        return is_answer and self.status.limit == guidance.NOT_LIMITED and not self.is_disengaged(now_ns)


class Engagement:
    """State machine of the phases; a missing safe command in RELEASED changes nothing."""

    def __init__(self) -> None:
        self.phase = Phase.RELEASED
        self.since_ns = 0
        self._fresh = 0
        self._stamp_ns = -1

    def step(self, now_ns: int, command: SafeCommand | None, steering: Steering) -> Phase:
        """New phase; `command` is None without a fresh safe command."""
        phase = self._without_command() if command is None else self._commanded(now_ns, command, steering)
        if phase is not self.phase:
            self.phase, self.since_ns = phase, now_ns
        return phase

    def _without_command(self) -> Phase:
        self._fresh = 0
        return Phase.RELEASED if self.phase is Phase.RELEASED else Phase.SILENT

    def _commanded(self, now_ns: int, command: SafeCommand, steering: Steering) -> Phase:
        self._fresh += command.stamp_ns > self._stamp_ns
        self._stamp_ns = max(self._stamp_ns, command.stamp_ns)
        if command.mode is Mode.MANUAL and command.deceleration_mps2 == 0.0:
            return Phase.RELEASED  # a driver controls the machine; the brake holds one with an empty seat
        if self.phase is Phase.SILENT and self._fresh < FRESH_TO_RECOVER:
            return Phase.SILENT
        if not command.is_drive_enabled:
            return Phase.HOLDING
        return self._enabled(now_ns, steering)

    def _enabled(self, now_ns: int, steering: Steering) -> Phase:
        if self.phase is Phase.OFFERING:
            return Phase.ACTIVE if steering.accepts(now_ns, self.since_ns) else Phase.OFFERING
        if self.phase is Phase.ACTIVE:
            return Phase.LOST if steering.is_disengaged(now_ns) else Phase.ACTIVE
        return Phase.LOST if self.phase is Phase.LOST else Phase.OFFERING
