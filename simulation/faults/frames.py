"""CAN frames of a faulty device, changed between the machine's bus and the gateway."""

from collections import deque
from typing import Any

import can
import numpy as np
from cantools.database.can import Database, Message

from messages.errors import ConfigError
from simulation.faults.config import FaultKind, FieldErrors
from simulation.faults.injection import FaultInjection
from simulation.faults.measurement import Corruption
from simulation.faults.stream import FaultStream
from simulation.machine.ecu_checks import xbr_checksum

PREFIX = "can/"
MAX_AGE_NS = 300_000_000  # time-out of speeds and heartbeat (ISO 11783-7)
GUARD_SIGNALS = ("Counter", "Checksum")


class FaultyBus:
    """The gateway's bus with faults: frames of faulty devices are changed, delayed or dropped."""

    def __init__(self, bus: can.BusABC, injection: FaultInjection, database: Database) -> None:
        self._bus, self._injection, self._database = bus, injection, database
        self._streams: dict[tuple[int, FaultKind], FaultStream[can.Message]] = {}
        self._ready: deque[can.Message] = deque()
        self._later: list[tuple[int, can.Message]] = []

    def send(self, msg: can.Message) -> None:
        """Passes frames of the gateway unchanged."""
        self._bus.send(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next received frame."""
        while (frame := self._bus.recv(0)) is not None:
            self._receive(frame)
        now_ns = self._injection.now_ns
        self._ready.extend(frame for due_ns, frame in self._later if due_ns <= now_ns)
        self._later = [(due_ns, frame) for due_ns, frame in self._later if due_ns > now_ns]
        return self._ready.popleft() if self._ready else None

    def _receive(self, frame: can.Message) -> None:
        try:
            message = self._database.get_message_by_frame_id(frame.arbitration_id)
        except KeyError:
            self._ready.append(frame)
            return
        kinds = self._injection.active_kinds(PREFIX + message.name)
        if not kinds:
            self._ready.append(frame)
            return
        self._injection.faulty_items[PREFIX + message.name] += 1
        group = frame.data[0] if message.is_multiplexed() and frame.data else 0  # each group has its own counter
        key = (frame.arbitration_id << 8 | group, kinds[0])
        if key not in self._streams:
            self._streams[key] = self._stream(message, kinds[0])
        self._later += self._streams[key].apply(self._injection.now_ns, frame)

    def _stream(self, message: Message, kind: FaultKind) -> FaultStream[can.Message]:
        errors = self._injection.config.frames.get(message.name)
        if errors is None:
            raise ConfigError(f"faults.yaml: frames has no {message.name!r}")
        plausible = self._injection.config.plausible
        wrong = Corruption(kind, plausible, self._injection.generator(f"{PREFIX}{message.name}"))
        return FaultStream(
            kind,
            MAX_AGE_NS,
            plausible.replay_s,
            lambda last, new: with_data(
                new, with_checksum(message, _with_counter(message, bytes(last.data), bytes(new.data)))
            ),
            lambda frame, since_s: with_data(frame, corrupt(message, bytes(frame.data), errors, wrong, since_s)),
        )


def corrupt(message: Message, data: bytes, errors: dict[str, FieldErrors], wrong: Corruption, since_s: float) -> bytes:
    """The frame with corrupted signals and a valid checksum; `garbage` is random bytes."""
    if wrong.kind is FaultKind.GARBAGE:
        return wrong.random.bytes(len(data))
    raw: dict[str, Any] = dict(message.decode(data, decode_choices=False, scaling=False))  # type: ignore[arg-type]
    for name in [name for name in errors if name in raw]:
        signal = message.get_signal_by_name(name)
        ones = (1 << signal.length) - 1
        if wrong.kind is FaultKind.NAN:
            raw[name] = ones
            continue
        factor, offset = float(signal.scale), float(signal.offset)
        value = float(wrong.values(np.array([raw[name] * factor + offset]), errors[name], since_s)[0])
        highest = (0xFB << (signal.length - 8)) - 1 if signal.length >= 8 else ones
        raw[name] = int(np.clip(round((value - offset) / factor), 0, highest))
    return with_checksum(message, message.encode(raw, scaling=False, padding=True, strict=False))


def with_checksum(message: Message, data: bytes) -> bytes:
    """The frame with a valid checksum, where it has one."""
    if GUARD_SIGNALS[1] not in {signal.name for signal in message.signals}:
        return data
    return data[:7] + bytes([data[7] & 0x0F | xbr_checksum(message.frame_id, data) << 4])


def _with_counter(message: Message, last: bytes, new: bytes) -> bytes:
    """The content of `last` with the counter of `new`, where there is one."""
    has_counter = GUARD_SIGNALS[0] in {signal.name for signal in message.signals}
    return last[:7] + new[7:] if has_counter else last


def with_data(frame: can.Message, data: bytes) -> can.Message:
    """The frame with other content."""
    return can.Message(timestamp=frame.timestamp, arbitration_id=frame.arbitration_id, data=data, is_extended_id=True)
