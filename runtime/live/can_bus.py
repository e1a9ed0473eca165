"""CAN bus of one process: drops echoes of its own frames and invalid datagrams."""

from collections import deque
from collections.abc import Callable

import can

ECHOES = 400


class SharedBus(can.BusABC):
    """CAN bus over a network; invalid datagrams are counted and dropped."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__(bus.channel_info)
        self.dropped = 0
        self.listener: Callable[[can.Message], None] | None = None
        self._bus = bus
        self._sent: deque[tuple[int, bytes]] = deque(maxlen=ECHOES)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends one frame; raises CanError."""
        self._sent.append((msg.arbitration_id, bytes(msg.data)))
        self._bus.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Next frame of another sender, or None within `timeout` (s)."""
        while True:
            try:
                frame = self._bus.recv(timeout)
            except can.CanOperationError:
                self.dropped += 1
                continue
            if frame is None:
                return None
            sent = (frame.arbitration_id, bytes(frame.data))
            if sent not in self._sent:
                if self.listener is not None:
                    self.listener(frame)
                return frame
            self._sent.remove(sent)

    def shutdown(self) -> None:
        """Closes the bus."""
        super().shutdown()
        self._bus.shutdown()
