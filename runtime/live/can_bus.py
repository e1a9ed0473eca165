"""CAN buses by name: `loopback` (multicast that does not leave this computer) or INTERFACE:CHANNEL of python-can."""

import contextlib
import secrets
import select
import socket
import struct
import time
from collections.abc import Callable

import can

from messages.errors import HeadlandError

LOOPBACK = "loopback"
PROTOCOL_ERROR = 0x08  # error class of SocketCAN, here for a datagram that is not a frame
NOT_CONFINED = ("udp_multicast", "virtual")  # to every network; to one process
SO_TIMESTAMPNS = 35  # of Linux: time of reception by the kernel
_HOST = "127.0.0.1"
_TIME = struct.Struct("@ll")
_FRAME = struct.Struct("<IB3x8s")  # identifier, length, data: as struct can_frame of Linux
_IDENTIFIER_MAX = (1 << 29) - 1


class LoopbackBus(can.BusABC):
    """Frames as UDP multicast on the loopback interface; own frames are not received.

    The sending socket has a port of its own, by which own frames are known. A datagram that is not a frame is received
    as an error frame. Raises OSError if group and port cannot be opened.
    """

    def __init__(self, group: str, port: int) -> None:
        self.channel_info = f"{LOOPBACK}:{group}:{port}"
        self.listener: Callable[[can.Message], None] | None = None
        self._target = (group, port)
        self._receiver, self._sender = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        try:
            self._open(group, port)
        except OSError:
            self._close()
            raise
        super().__init__(group)

    def _open(self, group: str, port: int) -> None:
        host = socket.inet_aton(_HOST)
        self._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._receiver.bind((group, port))  # to the group: no datagram to another address is received
        self._receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + host)
        self._sender.bind((_HOST, 0))
        self._sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, host)
        self._sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        self._own = self._sender.getsockname()
        self._receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        for opened in (self._receiver, self._sender):
            opened.setblocking(False)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends one frame; raises CanOperationError."""
        try:
            self._sender.sendto(_FRAME.pack(msg.arbitration_id, len(msg.data), bytes(msg.data)), self._target)
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: {error}") from error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Next frame of another sender, or None within `timeout` (s); raises CanOperationError."""
        try:
            while True:
                with contextlib.suppress(BlockingIOError):
                    data, more, _, sender = self._receiver.recvmsg(64, socket.CMSG_SPACE(_TIME.size))
                    if sender == self._own:
                        continue
                    seconds, nanoseconds = _TIME.unpack(more[0][2])
                    return self._received(data, seconds + nanoseconds * 1e-9)
                if timeout == 0 or not select.select([self._receiver], [], [], timeout)[0]:
                    return None
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: {error}") from error

    def _received(self, data: bytes, time_s: float) -> can.Message:
        frame = message_of(data, time_s)
        if self.listener is not None:
            self.listener(frame)
        return frame

    def shutdown(self) -> None:
        """Closes the bus."""
        super().shutdown()
        self._close()

    def _close(self) -> None:
        self._receiver.close()
        self._sender.close()


class PunctualBus(can.BusABC):
    """Bus for a simulated machine that may be late: it receives a frame once its time is that of the arrival.

    `until_s` is the time of the machine, as of `time.time()`.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self.channel_info = bus.channel_info
        self.until_s = 0.0
        self._bus = bus
        self._next: can.Message | None = None
        super().__init__(bus.channel_info)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends one frame; raises CanError."""
        self._bus.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Next frame that has arrived by `until_s`, or None; one from the future, after a step of the clock, is due."""
        if self._next is None:
            self._next = self._bus.recv(0)
        if self._next is None or self.until_s < self._next.timestamp <= time.time():
            return None
        found, self._next = self._next, None
        return found

    def shutdown(self) -> None:
        """Closes the bus."""
        super().shutdown()
        self._bus.shutdown()


def message_of(data: bytes, time_s: float) -> can.Message:
    """Frame of a datagram; an error frame if it is none."""
    identifier, length, content = _FRAME.unpack(data) if len(data) == _FRAME.size else (0, 9, b"")
    if length > 8 or identifier > _IDENTIFIER_MAX:
        return can.Message(time_s, PROTOCOL_ERROR, is_error_frame=True)
    return can.Message(time_s, identifier, data=content[:length], is_extended_id=True)


def named_bus(text: str) -> str:
    """Value of `--bus` with a group and a free port of its own for `loopback` without them; raises HeadlandError."""
    interface, _, channel = text.partition(":")
    if text == LOOPBACK:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((_HOST, 0))
            port = probe.getsockname()[1]
        return f"{LOOPBACK}:239.74.{secrets.randbelow(256)}.{secrets.randbelow(256)}:{port}"
    if not channel or interface in NOT_CONFINED or interface not in (LOOPBACK, *can.VALID_INTERFACES):
        raise HeadlandError(f"--bus {text}: loopback, loopback:GROUP:PORT, or INTERFACE:CHANNEL such as socketcan:can0")
    return text


def open_bus(name: str) -> can.BusABC:
    """Opens a bus by the name that `named_bus` returns; raises HeadlandError."""
    interface, _, channel = name.partition(":")
    try:
        if interface == LOOPBACK:
            group, _, port = channel.partition(":")
            return LoopbackBus(group, int(port))
        return can.Bus(interface=interface, channel=channel)
    except (can.CanError, OSError, OverflowError, ImportError, ValueError) as error:
        raise HeadlandError(f"CAN bus {name} cannot be opened ({error})") from error
