"""Log of `live`: thinned for viewers over the whole drive, and complete in a log of its own around each event."""

from collections import deque
from pathlib import Path

from datasets.disk import MB
from datasets.log import LogConfig, LogWriter
from datasets.viewer import Viewer
from messages.command import Mode, SupervisorState
from messages.faults import Fault, Response
from messages.message import Envelope
from messages.topics import spec_of
from runtime.live.thinned_log_config import ThinnedLogConfig

THINNED = "thinned"  # name of the metadata of such a log
STOPS = (Mode.OBSTACLE_STOP, Mode.FAULT_STOP, Mode.EMERGENCY_STOP)
STOPPING = (Response.CONTROLLED_STOP, Response.EMERGENCY_STOP)
NO_IMAGES_S = 60.0  # period of the images for viewers in logs of events, which have the images themselves
BACKLOG_STEP = 4  # messages written per received one while the seconds before an event are written


class ThinnedLog:
    """Sink that writes the thinned log, and `events/N-CODE.mcap` for each stop and each fault that demands one.

    `event_viewer` is the viewer of the event logs. Raises LogError as LogWriter does.
    """

    def __init__(
        self, log: LogWriter, folder: Path, config: ThinnedLogConfig, log_config: LogConfig, event_viewer: Viewer | None
    ) -> None:
        self._log, self._folder, self._config, self._log_config = log, folder, config, log_config
        self._viewer = event_viewer
        self._before_ns, self._after_ns = round(config.before_s * 1e9), round(config.after_s * 1e9)
        self._max_bytes = round(config.event_mb * MB) - 3 * log_config.chunk_kib * 1024  # what is not written yet
        self._ring: deque[Envelope] = deque()
        self._written_ns: dict[str, int] = {}
        self._mode: Mode | None = None
        self._event: LogWriter | None = None
        self._event_end_ns = 0
        self.events = 0

    def __call__(self, envelope: Envelope) -> None:
        """Writes a message to the thinned log, if it is not left out, and to the log of an event."""
        if self._is_kept(envelope):
            self._log.write(envelope)
        else:
            self._log.show(envelope)
        code = self._event_of(envelope)
        if code and self._event is None:
            self._begin(code, envelope.receive_ns)
        if spec_of(envelope.topic).is_logged:
            self._ring.append(envelope)
        if self._event is not None:
            self._write_event(self._event, envelope.receive_ns)
        else:
            self._forget(envelope.receive_ns)

    def close(self) -> None:
        """Writes the rest of an event and closes its log."""
        if self._event is not None:
            while self._ring:
                self._event.write(self._ring.popleft())
            self._event.close()
            self._event = None

    def _is_kept(self, envelope: Envelope) -> bool:
        """Whether the thinned log has the message: of a kept kind, and the first one in its period."""
        kind = envelope.topic.partition("/")[0]
        if kind in self._config.left_out:
            return False
        period_s = self._config.period_s.get(kind)
        if period_s is None:
            return True
        last_ns = self._written_ns.get(envelope.topic)
        if last_ns is not None and 0 <= envelope.receive_ns - last_ns < period_s * 1e9:
            return False
        self._written_ns[envelope.topic] = envelope.receive_ns
        return True

    def _event_of(self, envelope: Envelope) -> str:
        """Code of the event that begins with a message, or ""."""
        message = envelope.message
        if isinstance(message, SupervisorState):
            before, self._mode = self._mode, message.mode
            is_new = message.mode in STOPS and before not in (None, message.mode)
            return (message.reason or message.mode.value) if is_new else ""
        if isinstance(message, Fault) and message.is_active and message.response in STOPPING:
            return message.code
        return ""

    def _begin(self, code: str, now_ns: int) -> None:
        self.events += 1
        name = "".join(c if c.isalnum() or c in "._-" else "-" for c in code)[:60]
        self._folder.mkdir(exist_ok=True)
        path = self._folder / f"{self.events:04d}-{name}.mcap"
        metadata = {name: values for name, values in self._log.metadata.items() if name != THINNED}
        self._event = LogWriter(path, metadata | {"event": {"code": code}}, self._log_config, self._viewer)
        self._event_end_ns = now_ns + self._after_ns

    def _write_event(self, event: LogWriter, now_ns: int) -> None:
        for _ in range(min(BACKLOG_STEP, len(self._ring))):
            event.write(self._ring.popleft())
        is_over = now_ns > self._event_end_ns and not self._ring
        if is_over or event.size_bytes > self._max_bytes:
            event.close()
            self._event = None
            self._ring.clear()

    def _forget(self, now_ns: int) -> None:
        while self._ring and not 0 <= now_ns - self._ring[0].receive_ns <= self._before_ns:
            self._ring.popleft()
