"""Another sender on the bus while the entire stack drives: named within 200 ms, fault stop within S."""

import itertools
from typing import Any

import can
import pytest

from interfaces.isobus import guidance, speed
from interfaces.isobus.frame import encode_identifier
from messages.command import Mode, SignedOrder, SupervisorState
from messages.faults import Fault
from messages.message import Envelope
from messages.truth import TrueMachine
from runtime import assembly
from runtime.executor import Executor
from runtime.setup import load_setup
from tests.scenarios.forward import starting_early

CHANNEL = 910_000
FAST_MPS = 1.5


class Attack:
    """Sink and end condition: frames of the gateway's address from the moment at which the machine is fast."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self.now_ns, self._sent_ns = bus, 0, 0
        self.start_ns: int | None = None
        self.named_ns: dict[str, int] = {}
        self.truth: TrueMachine | None = None
        self.state: SupervisorState | None = None
        self.fastest_mps = self.allowed_m = 0.0
        self.start_m: Any = None
        self.orders: list[SignedOrder] = []

    def __call__(self, envelope: Envelope) -> None:
        self.now_ns, message = envelope.receive_ns, envelope.message
        if isinstance(message, TrueMachine):
            self.truth = message
        elif isinstance(message, SupervisorState):
            self.state = message
        elif isinstance(message, SignedOrder):
            self.orders.append(message)
        elif isinstance(message, Fault) and self.start_ns is not None and message.is_active:
            self.named_ns.setdefault(message.code, message.stamp_ns)

    def is_over(self) -> bool:
        if self.truth is None or self.state is None:
            return False
        if self.start_ns is None and self.truth.speed_mps > FAST_MPS:
            self.start_ns, self.allowed_m = self.now_ns, self.state.stopping_distance_m
            self.start_m = self.truth.T_map_base[:3, 3].copy()
        if self.start_ns is not None and self.now_ns - self._sent_ns >= 20_000_000:
            self._sent_ns = self.now_ns
            self.fastest_mps = max(self.fastest_mps, self.truth.speed_mps)
            command, curve = speed.encode_command(3.9), guidance.encode_command(0.2, True)
            for group, data in ((speed.COMMAND_GROUP, command), (guidance.COMMAND_GROUP, curve)):
                identifier = encode_identifier(3, group, 28, 240)
                self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=True))
        return self.start_ns is not None and abs(self.truth.speed_mps) < 0.01


def test_foreign_frames_while_driving(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assembly, "_CHANNELS", itertools.count(CHANNEL))
    setup = load_setup("line", None, None, None, 1)
    with (
        can.Bus(interface="virtual", channel=f"headland-{CHANNEL}") as bus,
        assembly.assemble(setup, starting_early("empty")) as (world, nodes),
    ):
        attack = Attack(bus)
        Executor(world, nodes, [attack]).run(attack.is_over)
    assert attack.start_ns is not None
    assert attack.named_ns["gateway.foreign_source"] - attack.start_ns <= 200_000_000
    assert attack.state is not None
    assert attack.truth is not None
    assert (attack.state.mode, attack.state.reason) == (Mode.FAULT_STOP, "gateway.foreign_source")
    travel_m = float(((attack.truth.T_map_base[:3, 3] - attack.start_m) ** 2).sum() ** 0.5)
    assert travel_m <= attack.allowed_m
    assert attack.fastest_mps < FAST_MPS + 0.3
    assert len(attack.orders) == 2  # confirmation and start
