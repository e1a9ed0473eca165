"""Console output of a drive: task, speed, and each stop with its reason."""

import time
from typing import TextIO

from messages.command import Mode, SupervisorState
from messages.faults import Fault
from messages.message import Envelope
from messages.motion import Odometry
from messages.plan import MissionStatus

LINE_EVERY_S = 10.0  # of simulated time


class Progress:
    """Sink that prints a line every ten simulated seconds and at each change of mode or fault."""

    def __init__(self, streams: tuple[TextIO, ...]) -> None:
        self._streams = streams
        self._start_ns: int | None = None
        self._wall_s = time.monotonic()
        self._next_s = 0.0
        self._mode: Mode | None = None
        self._speed_kmh = 0.0
        self._status: MissionStatus | None = None

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        if self._start_ns is None:
            self._start_ns = envelope.receive_ns
        t_s = (envelope.receive_ns - self._start_ns) * 1e-9
        message = envelope.message
        if isinstance(message, Odometry):
            self._speed_kmh = 3.6 * message.speed_mps
        elif isinstance(message, SupervisorState):
            self._mode_changed(t_s, message)
        elif isinstance(message, Fault):
            self._print(
                t_s,
                f"{'fault' if message.is_active else 'cleared'}: {message.code} ({message.source}) {message.text_en}",
            )
        elif isinstance(message, MissionStatus):
            self._status = message
            if t_s >= self._next_s:
                self._next_s += LINE_EVERY_S
                self._print_task(t_s, message)

    def _mode_changed(self, t_s: float, state: SupervisorState) -> None:
        if state.mode is self._mode:
            return
        self._mode = state.mode
        reason = (
            f": {state.reason}, {state.obstacle_class.value} at {state.clearance_m:.1f} m"
            if state.triggering_points_base_m.size
            else ""
        )
        self._print(t_s, state.mode.value.replace("_", " ") + (reason or (f": {state.reason}" if state.reason else "")))

    def _print_task(self, t_s: float, status: MissionStatus) -> None:
        share = 100.0 * status.driven_m / status.total_m if status.total_m else 0.0
        line = f" {status.line}" if status.line >= 0 else ""
        pace = t_s / max(time.monotonic() - self._wall_s, 1e-3)
        self._print(
            t_s,
            f"{share:3.0f} %  {status.section_type.value}{line}  {self._speed_kmh:4.1f} km/h  ({pace:.1f}x real time)",
        )

    def _print(self, t_s: float, text: str) -> None:
        for stream in self._streams:
            stream.write(f"{t_s:7.1f} s  {text}\n")
            stream.flush()
