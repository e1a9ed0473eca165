"""Order gate of a setup."""

from pathlib import Path

from interfaces.orders.gate import OrderGate
from interfaces.orders.port import OrderPort
from interfaces.orders.sequence import SequenceStore
from interfaces.orders.verifier import OrderVerifier
from runtime.setup import Setup


def order_gate(setup: Setup, folder: Path | None = None, port: OrderPort | None = None) -> OrderGate:
    """Gate for the orders of a topic and of `port`; `folder` keeps the sequence numbers over restarts."""
    config, max_shift_m = setup.stack.interfaces.orders, setup.stack.planning.mission.max_shift_m
    verifier = OrderVerifier(setup.machine_id, setup.session, config, SequenceStore(folder))
    return OrderGate(setup.machine_id, setup.session, verifier, config.report_s, max_shift_m, port)
