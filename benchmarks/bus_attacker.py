"""Attacker of `benchmarks.bus_attacks`: a process of its own that sends datagrams to the bus and to the order port.

Standard input: one JSON object per line. `{"attack": NAME, "seed": N}` begins an attack, `{"tick": K}` sends the frames
of one period of 20 ms, `{"datagrams": [BASE64, ...]}` sends orders. Each line is answered by "." when all is sent.
"""

import base64
import fcntl
import json
import socket
import struct
import sys
from collections.abc import Callable, Iterator

import can
import numpy as np

from interfaces.isobus import brake, cab, guidance, heartbeat, implement, speed
from interfaces.isobus.checksum import protect
from interfaces.isobus.frame import encode_identifier
from runtime.live.can_bus import LoopbackBus

GATEWAY, TRACTOR, STRANGER = 28, 240, 99
TICKS_PER_S = 50
RATES = (10, 20, 50, 100, 200)  # frames per second and message
Frame = tuple[int, bytes]
Attack = Callable[[int], list[Frame]]


def named(group: int, source: int, destination: int = 255) -> int:
    """Identifier of a message."""
    return encode_identifier(3, group, source, destination)


class Attacker:
    """What can be sent; `heard` are the newest frames of the others on the bus."""

    def __init__(self, bus: LoopbackBus) -> None:
        self._bus, self.heard = bus, list[Frame]()
        self._random = np.random.default_rng()
        self._count = 0

    def begin(self, name: str, seed: int) -> Attack:
        """The attack of a name, drawn by the seed."""
        self._random = np.random.default_rng(seed)
        return {"spoof": self._spoof, "replay": self._replay, "flood": self._flood, "bus_off": self._bus_off}[name]()

    def send(self, frames: list[Frame]) -> None:
        """Sends frames, or datagrams that are none (identifier -1)."""
        for identifier, data in frames:
            if identifier < 0:
                self._bus._sender.sendto(data, self._bus._target)
            else:
                self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=True))

    def listen(self) -> None:
        """Reads what the others sent."""
        while (frame := self._bus.recv(0)) is not None:
            self.heard.append((frame.arbitration_id, bytes(frame.data)))
        self.heard = self.heard[-400:]

    def _paced(self, make: Callable[[], list[Frame]]) -> Attack:
        """The frames of `make` at a rate that is drawn, at the first tick in any case."""
        per_s = int(self._random.choice(RATES))

        def frames(tick: int) -> list[Frame]:
            due = (tick + 1) * per_s // TICKS_PER_S - tick * per_s // TICKS_PER_S if tick else max(1, per_s // 50)
            return [frame for _ in range(due) for frame in make()]

        return frames

    def _spoof(self) -> Attack:
        value = float(self._random.uniform(1.0, 8.0))
        curve = float(self._random.uniform(-0.2, 0.2))
        status = guidance.encode_command(curve, True)[:2] + b"\x04\x00\x00\xff\xff\xff"
        fast, turned = speed.encode_command(value), guidance.encode_command(curve, True)
        lowered = implement.encode_commands(0.0, 540.0, True)
        makes: list[Callable[[], list[Frame]]] = [
            lambda: [(named(speed.COMMAND_GROUP, GATEWAY), fast)],
            lambda: [(named(guidance.COMMAND_GROUP, GATEWAY, TRACTOR), turned)],
            lambda: [(named(implement.COMMAND_GROUP, GATEWAY), lowered)],
            lambda: self._whole_gateway(fast, turned, lowered),
            lambda: [(named(speed.COMMAND_GROUP, STRANGER), fast)],
            lambda: [(named(guidance.COMMAND_GROUP, STRANGER, TRACTOR), turned)],
            lambda: [(named(implement.COMMAND_GROUP, STRANGER), lowered)],
            lambda: [(named(speed.WHEEL_GROUP, TRACTOR), speed.encode_command(0.1 * value))],
            lambda: [(named(guidance.STATUS_GROUP, TRACTOR, GATEWAY), status)],
            lambda: [(named(implement.REAR_HITCH_GROUP, TRACTOR), bytes([125, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF]))],
            lambda: [(named(heartbeat.GROUP, TRACTOR), bytes([self._next() % heartbeat.COUNTS]))],
        ]
        return self._paced(makes[int(self._random.integers(len(makes)))])

    def _whole_gateway(self, fast: bytes, turned: bytes, lowered: bytes) -> list[Frame]:
        """Everything the gateway sends, with valid counters, checksums and heartbeat: drive on, brakes off."""
        count, request, drive = self._next(), named(brake.GROUP, GATEWAY, TRACTOR), named(cab.GROUP, GATEWAY, TRACTOR)
        return [
            (request, protect(request, brake.encode_request(0.0), count)),
            (drive, protect(drive, cab.encode_auxiliary(True, False, False, True, None), count)),
            (named(speed.COMMAND_GROUP, GATEWAY), fast),
            (named(guidance.COMMAND_GROUP, GATEWAY, TRACTOR), turned),
            (named(implement.COMMAND_GROUP, GATEWAY), lowered),
            (named(heartbeat.GROUP, GATEWAY), bytes([count % heartbeat.COUNTS])),
        ]

    def _next(self) -> int:
        self._count += 1
        return self._count

    def _replay(self) -> Attack:
        """Frames of the gateway or the tractor as they were heard, in their order."""
        source = GATEWAY if self._random.random() < 0.5 else TRACTOR
        recorded = [frame for frame in self.heard if frame[0] & 0xFF == source]
        frames: Iterator[Frame] = iter(recorded * 100)
        return self._paced(lambda: [next(frames)])

    def _flood(self) -> Attack:
        count, is_junk = int(self._random.integers(50, 200)), self._random.random() < 0.3

        def frames(tick: int) -> list[Frame]:
            if is_junk:
                return [(-1, self._random.bytes(int(self._random.integers(1, 60)))) for _ in range(count)]
            groups = self._random.integers(0xFF00, 0xFFFF, count)
            return [(named(int(g), int(g) % 27), self._random.bytes(8)) for g in groups]

        return frames

    def _bus_off(self) -> Attack:
        def frames(tick: int) -> list[Frame]:
            if tick == 0:
                set_loopback(is_up=False)
            return []

        return frames


def set_loopback(is_up: bool) -> None:
    """Takes the loopback interface of this network namespace down or up."""
    get_flags, set_flags, up = 0x8913, 0x8914, 1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        flags = struct.unpack("16sH", fcntl.ioctl(control, get_flags, struct.pack("16sH14x", b"lo", 0))[:18])[1]
        fcntl.ioctl(control, set_flags, struct.pack("16sH14x", b"lo", flags | up if is_up else flags & ~up))


def main() -> None:
    """Arguments: group and port of the bus, order port."""
    group, port, order_port = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    attacker, attack = Attacker(LoopbackBus(group, port)), None
    orders = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for line in sys.stdin:
        asked = json.loads(line)
        attacker.listen()
        if "attack" in asked:
            attack = attacker.begin(asked["attack"], asked["seed"])
        elif "tick" in asked and attack is not None:
            attacker.send(attack(asked["tick"]))
        elif "up" in asked:
            set_loopback(is_up=True)
        for text in asked.get("datagrams", []):
            orders.sendto(base64.b64decode(text), ("127.0.0.1", order_port))
        sys.stdout.write(".\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
