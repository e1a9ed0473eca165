"""Console output of a drive: task, speed, and each stop with its reason."""

import time
from typing import TextIO

from messages.command import Mode, SupervisorState
from messages.faults import Fault
from messages.message import Envelope
from messages.motion import Odometry
from messages.plan import MissionStatus

LINE_EVERY_S = 10.0  # of simulated time
FIRST_DATA_S = 1.0  # within which every part has sent


class Progress:
    """Sink that prints a line every ten simulated seconds and at each change of mode or fault, with its reason.

    `notes` are printed at once. A stream that cannot be written any more is left out.
    """

    def __init__(self, streams: tuple[TextIO, ...], notes: tuple[str, ...] = ()) -> None:
        self._streams = list(streams)
        self._start_ns: int | None = None
        self._wall_s = time.monotonic()
        self._next_s = 0.0
        self._mode: Mode | None = None
        self._speed_kmh = 0.0
        self._status: MissionStatus | None = None
        self._texts: dict[str, str] = {}  # newest words of each rule code
        self._reported: set[str] = set()  # active faults of the parts; the supervisor repeats them as its alarms
        for text in notes:
            self._print(0.0, text)

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        if self._start_ns is None:
            self._start_ns = envelope.receive_ns
        t_s = (envelope.receive_ns - self._start_ns) * 1e-9
        message = envelope.message
        if isinstance(message, Odometry):
            self._speed_kmh = 3.6 * message.speed_mps
        elif isinstance(message, SupervisorState):
            self._texts |= {result.code: result.text for result in message.rules if result.text}
            self._mode_changed(t_s, message)
        elif isinstance(message, Fault):
            self._fault_changed(t_s, message)
        elif isinstance(message, MissionStatus):
            self._status = message
            if t_s >= self._next_s:
                self._next_s += LINE_EVERY_S
                self._print_task(t_s, message)

    def _mode_changed(self, t_s: float, state: SupervisorState) -> None:
        if state.mode is self._mode:
            return
        self._mode = state.mode
        words = [self._words(t_s, state)]
        if state.triggering_points_base_m.size:
            words.append(f"{state.obstacle_class.value} at {state.clearance_m:.1f} m")
        reason = ", ".join(filter(None, words))
        self._print(t_s, state.mode.value.replace("_", " ") + (f": {reason}" if reason else ""))

    def _words(self, t_s: float, state: SupervisorState) -> str:
        """The reason of a state in words, "" where the mode itself is the reason."""
        if state.reason in ("", state.mode.value):
            return ""
        if state.reason.endswith(".silent") and t_s < FIRST_DATA_S:
            return "waiting for the first data"
        return self._texts.get(state.reason, state.reason)

    def _fault_changed(self, t_s: float, fault: Fault) -> None:
        if fault.source == "supervisor" and fault.code in self._reported:
            return
        if fault.source != "supervisor":
            (self._reported.add if fault.is_active else self._reported.discard)(fault.code)
        self._print(t_s, f"{'fault' if fault.is_active else 'over'}: {fault.text_en} [{fault.source} {fault.code}]")

    def _print_task(self, t_s: float, status: MissionStatus) -> None:
        share = 100.0 * status.driven_m / status.total_m if status.total_m else 0.0
        line = f" {status.line}" if status.line >= 0 else ""
        pace = t_s / max(time.monotonic() - self._wall_s, 1e-3)
        self._print(
            t_s,
            f"{share:3.0f} %  {status.section_type.value}{line}  {self._speed_kmh:4.1f} km/h  ({pace:.1f}x real time)",
        )

    def _print(self, t_s: float, text: str) -> None:
        for stream in tuple(self._streams):
            try:
                stream.write(f"{t_s:7.1f} s  {text}\n")
                stream.flush()
            except OSError:  # full disk, closed terminal
                self._streams.remove(stream)
