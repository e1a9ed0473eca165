"""Orders of the page at a real order gate: accepted, refused with the reason, unanswered; and its key file."""

import socket
import stat
import time
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from hmi.diagnosis.audit import audit_rows
from hmi.diagnosis.self_test import TESTED, SelfTest
from hmi.orders import OrderSender, SentOrder, outcome, own_key, public_key_of, read_key
from hmi.page_state import PageState
from hmi.texts import texts_of
from interfaces.orders.config import OrderKey, OrdersConfig
from interfaces.orders.gate import OrderGate
from interfaces.orders.port import OrderPort
from interfaces.orders.sequence import SequenceStore
from interfaces.orders.verifier import OrderVerifier
from messages.command import OrderStatus
from messages.errors import HeadlandError
from messages.message import Envelope
from tests.hmi.drive_messages import EmptyInbox, demo_scene

NOW_NS = 1_000_000_000_000


class Machine:
    """An order gate and the page state of its messages."""

    def __init__(self, key: Ed25519PrivateKey, session: str = "one") -> None:
        known = OrderKey(public_key=public_key_of(key).hex(), authority="operator", orders=("start", "pause"))
        config = OrdersConfig(keys={"page": known}, max_per_s=5, max_validity_s=60.0, max_delay_s=3.0, report_s=0.5)
        self.port = OrderPort(0)
        verifier = OrderVerifier("tractor-1", session, config, SequenceStore(None))
        self.gate = OrderGate("tractor-1", session, verifier, 0.5, 0.1, self.port)
        self.state = PageState(demo_scene(), 0.25)
        self.sender = OrderSender(key, "operator", self.port.number)
        self.step(NOW_NS)

    def step(self, now_ns: int) -> None:
        time.sleep(0.02)  # for the datagrams
        found = self.gate.step(now_ns, EmptyInbox())
        self.state.take(now_ns, [Envelope(topic, 0, now_ns, message) for topic, message in found])

    def send(self, order: str, now_ns: int, valid_s: float = 5.0, session: str | None = None) -> SentOrder:
        status = self.state.newest("order_status", OrderStatus)
        assert status is not None
        sent_for = OrderStatus(status.stamp_ns, status.machine, session or status.session, 0, status.refused)
        return self.sender.send(order, sent_for, now_ns, valid_s)


@pytest.fixture
def key() -> Ed25519PrivateKey:
    return Ed25519PrivateKey.generate()


def test_order_is_accepted(key: Ed25519PrivateKey) -> None:
    machine = Machine(key)
    sent = machine.send("start", NOW_NS)
    assert outcome(sent, machine.state) is None
    machine.step(NOW_NS + 10_000_000)
    assert outcome(sent, machine.state) == "accepted"
    machine.port.close()


@pytest.mark.parametrize(
    ("order", "now_ns", "valid_s", "session", "reason"),
    [
        ("reset", NOW_NS, 5.0, None, "not_permitted"),
        ("start", NOW_NS - 10_000_000_000, 5.0, None, "stale"),
        ("start", NOW_NS, 61.0, None, "stale"),
        ("start", NOW_NS, 5.0, "an earlier start", "wrong_session"),
    ],
)
def test_refusal_is_shown_with_its_reason(
    key: Ed25519PrivateKey, order: str, now_ns: int, valid_s: float, session: str | None, reason: str
) -> None:
    machine = Machine(key)
    sent = machine.send(order, now_ns, valid_s, session)
    machine.step(NOW_NS + 10_000_000)
    assert outcome(sent, machine.state) == reason
    machine.port.close()


def test_order_of_an_unknown_key_is_refused(key: Ed25519PrivateKey) -> None:
    machine = Machine(key)
    machine.sender = OrderSender(Ed25519PrivateKey.generate(), "operator", machine.port.number)
    sent = machine.send("start", NOW_NS)
    machine.step(NOW_NS + 10_000_000)
    assert outcome(sent, machine.state) == "unknown_key"
    machine.port.close()


def test_silence_is_shown_after_a_second(key: Ed25519PrivateKey) -> None:
    machine = Machine(key)
    sent = machine.send("start", NOW_NS)
    machine.state.take(NOW_NS + 1_000_000_000, [])
    assert outcome(sent, machine.state) is None
    machine.state.take(NOW_NS + 1_000_000_001, [])
    assert outcome(sent, machine.state) == "unanswered"
    machine.port.close()


def test_numbers_rise_when_the_clock_does_not(key: Ed25519PrivateKey) -> None:
    machine = Machine(key)
    numbers = [machine.send("pause", now_ns).sequence for now_ns in (NOW_NS, NOW_NS, NOW_NS - 5, NOW_NS + 9)]
    assert numbers == [NOW_NS, NOW_NS + 1, NOW_NS + 2, NOW_NS + 9]
    machine.port.close()


def test_key_is_made_once_for_its_owner_alone(tmp_path: Path) -> None:
    path = tmp_path / "state" / "key.pem"
    first = public_key_of(own_key(path))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert public_key_of(own_key(path)) == first


@pytest.mark.parametrize("content", [b"", b"no key", b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n"])
def test_damaged_key_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "key.pem"
    path.write_bytes(content)
    with pytest.raises(HeadlandError, match=r"key\.pem: no private key"):
        read_key(path)
    with pytest.raises(HeadlandError, match="no private key"):
        own_key(path)
    assert path.read_bytes() == content


def test_a_thousand_forged_orders_are_counted_and_shown(key: Ed25519PrivateKey) -> None:
    """Nothing of it is accepted; the table of the diagnosis view has each reason with its number."""
    machine = Machine(key)
    machine.send("start", NOW_NS)
    machine.step(NOW_NS + 10_000_000)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    payload = b'{"machine": "tractor-1"}'
    forged, unknown = bytes(64) + public_key_of(key) + payload, bytes(64) + bytes(32) + payload
    for k in range(1000):
        link.sendto(forged if k % 2 else unknown, ("127.0.0.1", machine.port.number))
        if k % 8 == 7:  # more at once are refused as too many
            machine.step(NOW_NS + 20_000_000 + k * 1_000_000)
    link.close()
    machine.step(NOW_NS + 2_000_000_000)
    rows = audit_rows(machine.state, texts_of("en"))
    counts = {cell if isinstance(cell, str) else cell["text"]: int(number) for cell, number in rows}
    assert counts["Accepted"] == 1
    assert counts["Refused: signature wrong"] == counts["Refused: key not known to the machine"] == 500


def test_self_test_tells_of_each_control_whether_the_machine_takes_it(key: Ed25519PrivateKey) -> None:
    """This key may start and pause; a gate that takes five orders in a second refuses none for their number."""
    machine, test = Machine(key), SelfTest()
    test.begin()
    for k in range(1, 80):
        test.step(machine.state, machine.sender, 5.0)
        machine.step(NOW_NS + k * 100_000_000)
    expected = {order: "accepted" if order in ("start", "pause") else "not_permitted" for order in TESTED}
    assert test.results == expected
    status = machine.state.newest("order_status", OrderStatus)
    assert status is not None
    assert status.accepted == 0
    machine.port.close()


def test_self_test_of_a_silent_machine_has_no_answer(key: Ed25519PrivateKey) -> None:
    machine, test = Machine(key), SelfTest()
    machine.state.take(NOW_NS + 10_000_000_000, [])
    test.begin()
    for _ in TESTED:
        test.step(machine.state, machine.sender, 5.0)
    assert set(test.results.values()) == {"unanswered"}
    machine.port.close()
