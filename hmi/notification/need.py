"""Whether the machine stands and needs somebody, and since when."""

from dataclasses import dataclass

from hmi.drive_view.standing import UNCONFIRMED, Standing
from hmi.page_state import PageState
from messages.command import Mode, SupervisorState


@dataclass(frozen=True)
class Notification:
    """Content of a notification: which machine, when (local date and time), mode, cause and next step in words."""

    machine: str
    time: str
    mode: str
    cause: str
    next_step: str


class NeedWatch:
    """Finds the moment to call somebody: once for each time that the machine stands."""

    def __init__(self, after_s: float) -> None:
        self._after_s = after_s
        self._since_s: float | None = None
        self._is_told = False

    def is_due(self, state: PageState, now_s: float) -> bool:
        """Whether somebody has to be called now; `now_s` is a monotonic time."""
        if not needs_somebody(state):
            self._since_s, self._is_told = None, False
            return False
        self._since_s = now_s if self._since_s is None else self._since_s
        if self._is_told or now_s - self._since_s < self._after_s:
            return False
        self._is_told = True
        return True


def needs_somebody(state: PageState) -> bool:
    """A stop that does not end by itself: fault, emergency, obstacle, refilling, or silence of a begun mission."""
    supervisor = state.fresh("supervisor", SupervisorState)
    if supervisor is None:
        return state.is_begun
    if supervisor.mode is Mode.STANDBY and state.is_refilling:
        return True
    if supervisor.mode is Mode.STANDBY:
        return state.is_begun and supervisor.reason not in ("", str(Mode.STANDBY), UNCONFIRMED)
    return supervisor.mode in (Mode.FAULT_STOP, Mode.EMERGENCY_STOP, Mode.OBSTACLE_STOP)


def notification_of(machine: str, time: str, standing: Standing) -> Notification:
    """The notification of a moment, each text on one line."""
    texts = (machine, time, standing.mode, standing.cause, standing.next_step)
    return Notification(*(" ".join(one.split()) for one in texts))
