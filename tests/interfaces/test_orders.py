"""Orders: only what a configured key signed for this machine, this session and this moment becomes a command."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.strict import parse
from interfaces.orders.config import ORDERS, OrdersConfig
from interfaces.orders.gate import FAULTS, LOST, MAX_VERIFIED, OrderGate
from interfaces.orders.port import OrderPort
from interfaces.orders.sequence import SequenceStore
from interfaces.orders.verifier import OrderVerifier, Reason
from messages.command import Mode, OperatorCommand, OperatorCommandKind, OrderStatus, SignedOrder, SupervisorState
from messages.errors import ConfigError, HeadlandError
from messages.faults import Fault, Response
from messages.plan import MissionState, MissionStatus, PathSectionType
from simulation.operator import SimulatedOperator, operator_key, public_bytes
from tests.hmi.drive_messages import mission, supervisor

NOW = 1_700_000_000_000_000_000
S = 1_000_000_000
PAGE, RADIO, STRANGER = (Ed25519PrivateKey.from_private_bytes(bytes([k]) * 32) for k in range(3))
KEYS = {
    "page": {"public_key": public_bytes(PAGE).hex(), "authority": "operator", "orders": list(ORDERS)},
    "radio": {
        "public_key": public_bytes(RADIO).hex(),
        "authority": "remote",
        "orders": ["pause", "resume"],
        "lost_operator_s": None,
    },
}
VALUES = {"keys": KEYS, "max_per_s": 5, "max_validity_s": 600.0, "max_delay_s": 3.0, "report_s": 0.5}
CONFIG = parse(OrdersConfig, VALUES, "test")
GOOD = {
    "machine": "tractor-1", "session": "abc", "authority": "operator", "sequence": 10, "order": "start",
    "signed_ns": NOW, "expires_ns": NOW + 5 * S,
}  # fmt: skip


def signed(key: Ed25519PrivateKey = PAGE, **changes: Any) -> SignedOrder:
    content = {name: value for name, value in (GOOD | changes).items() if value is not None}
    return signed_bytes(json.dumps(content).encode(), key)


def signed_bytes(payload: bytes, key: Ed25519PrivateKey = PAGE) -> SignedOrder:
    return SignedOrder(NOW, public_bytes(key), key.sign(payload), payload)


class Bench:
    """A gate and its outputs."""

    def __init__(self, folder: Path | None = None, session: str = "abc", port: OrderPort | None = None) -> None:
        verifier = OrderVerifier("tractor-1", session, CONFIG, SequenceStore(folder))
        self.gate = OrderGate("tractor-1", session, verifier, CONFIG.report_s, 0.1, port)
        self.now_ns, self.orders = NOW, ()
        self.mode: Mode | None = None
        self.mission: MissionStatus | None = None
        self.outputs: list[Any] = []

    def all(self, topic: str, kind: type[SignedOrder]) -> tuple[SignedOrder, ...]:
        assert topic == "order/operator"
        return self.orders

    def latest(self, topic: str, kind: type[Any]) -> SupervisorState | MissionStatus | None:
        if topic == "mission":
            return self.mission
        assert topic == "supervisor"
        return None if self.mode is None else supervisor(self.mode)

    def give(self, *orders: SignedOrder, after_s: float = 0.01) -> list[OperatorCommandKind]:
        """Kinds of the commands of one step."""
        self.now_ns += round(after_s * 1e9)
        self.orders = orders
        self.outputs = list(self.gate.step(self.now_ns, self))  # type: ignore[arg-type]
        return [m.kind for m in self.of(OperatorCommand)]

    def of(self, kind: type[Any]) -> list[Any]:
        return [message for _, message in self.outputs if isinstance(message, kind)]

    @property
    def refused(self) -> dict[str, int]:
        return {one.reason: one.count for one in self.of(OrderStatus)[-1].refused}


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("name", ORDERS)
def test_signed_order_becomes_a_command(bench: Bench, name: str) -> None:
    bench.mode, bench.mission = Mode.AUTOMATIC, mission(MissionState.DRIVING)
    assert bench.give(signed(order=name, left_m=0.02 if name == "nudge" else None)) == [ORDERS[name]]
    (command,) = bench.of(OperatorCommand)
    if name != "emergency_stop":
        assert (command.authority, command.sequence, command.expires_ns) == ("operator", 10, NOW + 5 * S)
    assert not bench.of(Fault)


REFUSED = {
    "unknown key": (signed(STRANGER), Reason.UNKNOWN_KEY),
    "key of another size": (SignedOrder(NOW, b"", b"", b"{}"), Reason.UNKNOWN_KEY),
    "other machine": (signed(machine="tractor-2"), Reason.WRONG_MACHINE),
    "earlier session": (signed(session="abb"), Reason.WRONG_SESSION),
    "authority of another key": (signed(authority="remote"), Reason.NOT_PERMITTED),
    "order of another key": (signed(RADIO, authority="remote"), Reason.NOT_PERMITTED),
    "unknown order": (signed(order="fly"), Reason.NOT_PERMITTED),
    "expired": (signed(expires_ns=NOW), Reason.STALE),
    "valid for too long": (signed(expires_ns=NOW + 601 * S), Reason.STALE),
    "signed long ago": (signed(signed_ns=NOW - 4 * S), Reason.STALE),
    "signed in the future": (signed(signed_ns=NOW + 4 * S), Reason.STALE),
    "not said when it was signed": (signed(signed_ns=None), Reason.MALFORMED),
    "no sequence": (signed(sequence=None), Reason.MALFORMED),
    "negative": (signed(sequence=-1), Reason.MALFORMED),
    "text for a number": (signed(sequence="11"), Reason.MALFORMED),
    "number beyond 63 bits": (signed(sequence=1 << 63), Reason.MALFORMED),
    "unknown parameter": (signed(speed_mps=9.0), Reason.MALFORMED),
    "parameter of another order": (signed(left_m=0.01), Reason.MALFORMED),
    "nudge without its step": (signed(order="nudge"), Reason.MALFORMED),
    "step of a nudge too long": (signed(order="nudge", left_m=0.06), Reason.MALFORMED),
    "step of a nudge not finite": (signed(order="nudge", left_m=float("nan")), Reason.MALFORMED),
    "no object": (signed_bytes(b"[]"), Reason.MALFORMED),
    "no JSON": (signed_bytes(b"\xff\x00"), Reason.MALFORMED),
    "empty": (signed_bytes(b""), Reason.MALFORMED),
    "nested": (signed_bytes(b"[" * 1000), Reason.MALFORMED),
    "forged": (SignedOrder(NOW, public_bytes(PAGE), bytes(64), signed().payload), Reason.FORGED),
    "signature of another key": (
        SignedOrder(NOW, public_bytes(PAGE), signed(RADIO).signature, signed().payload), Reason.FORGED,
    ),
    "signature cut": (SignedOrder(NOW, public_bytes(PAGE), signed().signature[:63], signed().payload), Reason.FORGED),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused_order_is_counted_and_named(bench: Bench, case: str) -> None:
    order, reason = REFUSED[case]
    assert bench.give(order) == []
    assert bench.refused == {reason: 1}
    (fault,) = bench.of(Fault)
    assert (fault.code, fault.is_active, fault.response) == (f"orders.{reason}", True, Response.NONE)
    bench.give(after_s=0.6)
    assert [(f.code, f.is_active) for f in bench.of(Fault)] == [(f"orders.{reason}", False)]
    assert bench.give(signed()) == [OperatorCommandKind.START]


def test_replay_reordering_and_frequency(bench: Bench) -> None:
    first, second = signed(sequence=10), signed(sequence=12, order="pause")
    assert bench.give(first, second) == [OperatorCommandKind.START, OperatorCommandKind.PAUSE]
    assert bench.give(second, first, signed(sequence=11)) == []
    assert bench.refused == {"replayed": 2, "reordered": 1}
    many = [signed(sequence=20 + k, order="pause") for k in range(5)]
    assert len(bench.give(*many)) == 3  # with the two before: five within a second
    assert bench.refused["too_frequent"] == 2
    assert bench.give(signed(sequence=30), after_s=1.0) == [OperatorCommandKind.START]


def test_sequence_and_session_over_a_restart(tmp_path: Path) -> None:
    order = signed(sequence=50)
    assert Bench(tmp_path).give(order) == [OperatorCommandKind.START]
    again = Bench(tmp_path)  # the same session: what a clock or nonce that repeats would give
    assert again.give(order, signed(sequence=49)) == []
    assert again.refused == {"replayed": 1, "reordered": 1}
    assert again.give(signed(sequence=51)) == [OperatorCommandKind.START]
    other = Bench(tmp_path, session="next")
    assert other.give(signed(sequence=60)) == []
    assert other.refused == {"wrong_session": 1}
    assert [path.suffix for path in tmp_path.iterdir()] == [".json"]


@pytest.mark.parametrize("content", [b"", b"{}", b'{"sequence": "5"}', b'{"sequence": true}', b"\xff", b"[]"])
def test_damaged_sequence_file_refuses_all_but_the_stop(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / f"{public_bytes(PAGE).hex()}.json"
    path.write_bytes(content)
    bench = Bench(tmp_path)
    assert bench.give(signed(), signed(order="emergency_stop")) == [OperatorCommandKind.EMERGENCY_STOP]
    assert bench.refused == {"not_stored": 1}
    assert str(path) in bench.of(Fault)[0].text_en
    assert path.read_bytes() == content


def test_folder_that_cannot_be_written_refuses(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    bench = Bench(tmp_path / "file" / "orders")
    assert bench.give(signed()) == []
    assert bench.refused == {"not_stored": 1}


@pytest.mark.parametrize(
    "stop",
    [
        signed(STRANGER, order="emergency_stop", machine="x", session="y", sequence=0, expires_ns=0),
        SignedOrder(NOW, b"", b"", b'{"order": "emergency_stop"}'),
        SignedOrder(NOW, bytes(32), bytes(64), b'{"order": "emergency_stop", "sequence": -1}'),
    ],
)
def test_emergency_stop_needs_no_key(bench: Bench, stop: SignedOrder) -> None:
    bench.give(signed(sequence=10))
    assert bench.give(stop) == [OperatorCommandKind.EMERGENCY_STOP]
    assert bench.give(stop, stop) == [OperatorCommandKind.EMERGENCY_STOP]
    assert bench.give(signed(sequence=11)) == [OperatorCommandKind.START]  # it uses up no number


def test_emergency_stop_behind_a_flood(bench: Bench) -> None:
    flood = [SignedOrder(NOW, public_bytes(PAGE), bytes(64), signed(sequence=k).payload) for k in range(350)]
    assert bench.give(*flood, signed(STRANGER, order="emergency_stop")) == [OperatorCommandKind.EMERGENCY_STOP]
    assert bench.refused == {"forged": MAX_VERIFIED, "too_frequent": 350 - MAX_VERIFIED}


@settings(derandomize=True, max_examples=200)
@given(st.integers(0, 2**20), st.integers(0, 7))
def test_no_order_with_a_changed_bit_is_accepted(at: int, bit: int) -> None:
    order = signed()
    parts = [order.public_key, order.signature, order.payload]
    flat = bytearray(b"".join(parts))
    flat[at % len(flat)] ^= 1 << bit
    changed = SignedOrder(NOW, bytes(flat[:32]), bytes(flat[32:96]), bytes(flat[96:]))
    bench = Bench()
    assert bench.give(changed) == []
    assert set(bench.refused) <= {"unknown_key", "forged"}


def test_every_reason_has_texts() -> None:
    assert set(FAULTS) == set(Reason)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"public_key": "00"}, "public_key"),
        ({"public_key": "Z" * 64}, "public_key"),
        ({"orders": ["fly"]}, "no such order"),
        ({"orders": []}, "orders"),
        ({"private_key": "00" * 32}, "private_key"),
    ],
)
def test_configuration_names_what_is_wrong(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse(OrdersConfig, VALUES | {"keys": {"page": KEYS["page"] | change}}, "test")


@pytest.fixture
def port() -> Iterator[OrderPort]:
    port = OrderPort(0)
    yield port
    port.close()


def test_orders_and_status_through_the_port(port: OrderPort) -> None:
    import socket

    bench = Bench(port=port)
    order = signed()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(1.0)
        client.connect(("127.0.0.1", port.number))
        client.send(b"")
        bench.give()
        status = json.loads(client.recv(4096))
        assert (status["machine"], status["session"], status["accepted"]) == ("tractor-1", "abc", 0)
        client.send(order.signature + order.public_key + order.payload)
        client.send(b"junk")
        assert bench.give() == [OperatorCommandKind.START]
        client.send(b"")
        bench.give()
        status = json.loads(client.recv(4096))
        assert (status["accepted"], status["refused"]) == (1, {"unknown_key": 1})


def test_simulated_operator_signs_the_same_for_the_same_seed() -> None:
    start = OperatorCommandKind.START
    first, again, other = (SimulatedOperator(seed, "m", "s").order(NOW, start, 5.0) for seed in (1, 1, 2))
    assert first == again
    assert first.public_key == public_bytes(operator_key(1)) != other.public_key


def test_forbid_pauses_and_no_start_or_resume_is_accepted_until_it_is_permitted(bench: Bench) -> None:
    """BD-4.1f; pause, stop and confirmation are accepted meanwhile."""
    assert bench.give(signed(order="forbid", sequence=11)) == [OperatorCommandKind.PAUSE]
    assert bench.of(OrderStatus)[-1].is_forbidden
    assert bench.give(signed(order="start", sequence=12), signed(order="resume", sequence=13)) == []
    assert bench.refused == {"forbidden": 2}
    assert [fault.code for fault in bench.of(Fault)] == ["orders.forbidden"]
    others = [signed(order=order, sequence=14 + k) for k, order in enumerate(("pause", "confirm_clear"))]
    assert len(bench.give(*others, after_s=2.0)) == 2
    assert bench.give(signed_bytes(b'{"order": "emergency_stop"}', STRANGER)) == [OperatorCommandKind.EMERGENCY_STOP]
    present_ns = {"signed_ns": bench.now_ns}
    permit = signed(order="permit", sequence=20, **present_ns)
    assert bench.give(permit, after_s=2.0) == [OperatorCommandKind.PAUSE]
    assert not bench.of(OrderStatus)[-1].is_forbidden
    assert bench.give(signed(order="start", sequence=21, **present_ns)) == [OperatorCommandKind.START]


def test_a_start_that_was_refused_is_not_repeated_after_the_permission(bench: Bench) -> None:
    bench.give(signed(order="forbid", sequence=11))
    start = signed(order="start", sequence=12)
    assert bench.give(start) == []
    bench.gate._verifier._store.set_forbidden(False)  # by another key, whose numbers are its own
    assert bench.give(start) == []
    assert bench.refused == {"forbidden": 1, "replayed": 1}


def test_forbid_and_start_in_one_step_is_forbidden(bench: Bench) -> None:
    orders = (
        signed(order="start", sequence=10),
        signed(order="forbid", sequence=11),
        signed(order="resume", sequence=12),
    )
    assert bench.give(*orders) == [OperatorCommandKind.START, OperatorCommandKind.PAUSE]


def test_operation_stays_forbidden_after_a_restart(tmp_path: Path) -> None:
    Bench(tmp_path).give(signed(order="forbid", sequence=11))
    restarted = Bench(tmp_path, session="def")
    assert restarted.give(signed(order="start", sequence=12, session="def")) == []
    assert restarted.refused == {"forbidden": 1}
    restarted.give(signed(order="permit", sequence=13, session="def"))
    assert not Bench(tmp_path, session="ghi").gate._verifier.is_forbidden


def test_forbid_that_cannot_be_stored_still_forbids(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Path) -> None:
        raise OSError(28, "No space left on device")

    bench = Bench(tmp_path)
    monkeypatch.setattr(Path, "touch", fail)
    assert bench.give(signed(order="forbid", sequence=11)) == []
    assert bench.refused == {"not_stored": 1}
    assert bench.of(OrderStatus)[-1].is_forbidden


def test_a_permission_whose_number_cannot_be_stored_permits_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: SequenceStore, key: str, sequence: int) -> None:
        raise HeadlandError("disk full")

    bench.give(signed(order="forbid", sequence=11))
    monkeypatch.setattr(SequenceStore, "advance", fail)
    assert bench.give(signed(order="permit", sequence=12)) == []
    assert bench.refused == {"not_stored": 1}
    assert bench.of(OrderStatus)[-1].is_forbidden


@pytest.mark.parametrize("order", ["forbid", "permit"])
def test_forbid_and_permit_need_a_key_that_may_order_them(bench: Bench, order: str) -> None:
    for key, changes in ((RADIO, {"authority": "remote"}), (STRANGER, {})):
        assert bench.give(signed(key, order=order, **changes)) == []
    assert not bench.gate._verifier.is_forbidden


def lost(bench: Bench) -> list[bool]:
    """Reports of the last step that the operator is lost (True), or is there again."""
    return [fault.is_active for fault in bench.of(Fault) if fault.code == LOST.code]


def present(bench: Bench, sequence: int, key: Ed25519PrivateKey = PAGE, authority: str = "operator") -> SignedOrder:
    """The statement that an operator is there."""
    expires_ns = bench.now_ns + 5 * S
    return signed(
        key, order="present", sequence=sequence, authority=authority, expires_ns=expires_ns, signed_ns=bench.now_ns
    )


def test_a_lost_operator_stops_the_machine_in_automatic_operation(bench: Bench) -> None:
    """10 s after the last order of the key that started, by a fault that is kept until it is reset."""
    bench.mode = Mode.AUTOMATIC
    assert bench.give(signed()) == [OperatorCommandKind.START]
    for k in range(1, 4):
        bench.give(after_s=4.0)
        assert bench.give(present(bench, 10 + k)) == []
        assert lost(bench) == []
    assert bench.give(after_s=9.9) == []
    assert lost(bench) == []
    bench.give(after_s=0.2)
    (fault,) = bench.of(Fault)
    assert (fault.code, fault.response, fault.is_latched) == (LOST.code, Response.CONTROLLED_STOP, True)
    assert fault.is_active
    bench.give(after_s=5.0)
    assert lost(bench) == []  # reported once
    bench.give(present(bench, 20))
    assert lost(bench) == [False]


@pytest.mark.parametrize("mode", [None, Mode.MANUAL, Mode.STANDBY, Mode.FINISHED, Mode.FAULT_STOP])
def test_a_lost_operator_is_no_fault_outside_automatic_operation(bench: Bench, mode: Mode | None) -> None:
    bench.give(signed())
    bench.mode = mode
    bench.give(after_s=60.0)
    assert lost(bench) == []


def test_without_a_limit_the_machine_drives_on(bench: Bench) -> None:
    bench.mode = Mode.AUTOMATIC
    assert bench.give(signed(RADIO, authority="remote", order="resume"), after_s=0.1) == [OperatorCommandKind.RESUME]
    bench.give(after_s=3000.0)
    assert lost(bench) == []


def test_who_resumes_or_resets_has_to_be_there_and_who_pauses_has_not(bench: Bench) -> None:
    """The page started; a pause of the radio is no attendance, its resume takes over, and the page may go."""
    bench.mode = Mode.AUTOMATIC
    bench.give(signed())
    bench.give(signed(RADIO, authority="remote", order="pause"), after_s=4.0)
    bench.give(after_s=6.1)
    assert lost(bench) == [True]
    times = {"signed_ns": bench.now_ns, "expires_ns": bench.now_ns + 5 * S}
    resume = signed(RADIO, authority="remote", order="resume", sequence=11, **times)
    bench.give(resume)
    assert lost(bench) == [False]
    bench.give(after_s=100.0)
    assert lost(bench) == []


@pytest.mark.parametrize("order", ["pause", "forbid", "emergency_stop", "confirm_clear", "resume"])
def test_an_order_held_back_on_its_way_is_void_but_a_stop_is_not(bench: Bench, order: str) -> None:
    """Who confirms that nobody is near has not looked again since."""
    given = bench.give(signed(order=order, expires_ns=NOW + 60 * S), after_s=30.0)
    assert bool(given) == (order not in ("confirm_clear", "resume"))


@pytest.mark.parametrize(
    "change",
    [
        {"sequence": 10}, {"sequence": 9}, {"session": "old"}, {"machine": "other"}, {"expires_ns": NOW - S},
        {"signed_ns": NOW},
        {"authority": "remote"},
    ],
)  # fmt: skip
def test_a_replayed_or_foreign_presence_is_none(bench: Bench, change: dict[str, Any]) -> None:
    bench.mode = Mode.AUTOMATIC
    bench.give(signed())
    values = {"order": "present", "sequence": 11, "signed_ns": NOW + 9 * S, "expires_ns": NOW + 60 * S} | change
    bench.give(signed(**values), after_s=9.0)
    assert sum(bench.refused.values()) == 1
    bench.give(after_s=1.5)
    assert lost(bench) == [True]


def test_a_presence_signed_by_another_key_is_none(bench: Bench) -> None:
    bench.mode = Mode.AUTOMATIC
    bench.give(signed())
    assert bench.give(present(bench, 50, RADIO, "remote"), after_s=9.0) == []
    bench.give(after_s=1.5)
    assert lost(bench) == [True]


def test_no_presence_keeps_a_forbidden_start_alive(bench: Bench) -> None:
    """A start that is refused because operation is forbidden makes nobody the operator."""
    bench.mode = Mode.AUTOMATIC
    bench.give(signed(order="forbid"), signed(sequence=11))
    bench.give(after_s=60.0)
    assert lost(bench) == []


@pytest.mark.parametrize(
    ("mode", "section", "shift_m", "step_m", "reason"),
    [
        (Mode.AUTOMATIC, PathSectionType.SWATH, 0.09, 0.01, None),
        (Mode.AUTOMATIC, PathSectionType.SWATH, 0.10, 0.01, "out_of_range"),
        (Mode.AUTOMATIC, PathSectionType.SWATH, -0.10, -0.01, "out_of_range"),
        (Mode.AUTOMATIC, PathSectionType.SWATH, 0.10, -0.05, None),
        (Mode.AUTOMATIC, PathSectionType.TURN, 0.0, 0.01, "not_on_swath"),
        (Mode.AUTOMATIC, PathSectionType.HEADLAND, 0.0, 0.01, "not_on_swath"),
        (Mode.STANDBY, PathSectionType.SWATH, 0.0, 0.01, "not_on_swath"),
        (Mode.OBSTACLE_STOP, PathSectionType.SWATH, 0.0, 0.01, "not_on_swath"),
    ],
)
def test_a_nudge_is_accepted_on_a_swath_within_the_largest_shift(
    bench: Bench, mode: Mode, section: PathSectionType, shift_m: float, step_m: float, reason: str | None
) -> None:
    bench.mode = mode
    bench.mission = replace(mission(MissionState.DRIVING), section_type=section, shift_left_m=shift_m)
    order = signed(order="nudge", left_m=step_m)
    assert bench.give(order) == ([] if reason else [OperatorCommandKind.NUDGE])
    if reason is None:
        assert bench.of(OperatorCommand)[0].left_m == step_m
    else:
        assert bench.refused == {reason: 1}
        bench.mode, bench.mission = Mode.AUTOMATIC, mission(MissionState.DRIVING)
        assert bench.give(order) == []  # its number is used up


@pytest.mark.parametrize("name", [name for name in ORDERS if name != "emergency_stop"])
def test_a_check_is_verified_and_has_no_effect(bench: Bench, name: str) -> None:
    """Self-test of a control: its number is used up, nothing else is changed."""
    bench.mode, bench.mission = Mode.AUTOMATIC, mission(MissionState.DRIVING)
    order = signed(order=name, left_m=0.01 if name == "nudge" else None, is_check=True, sequence=11)
    assert bench.give(order) == []
    (status,) = bench.of(OrderStatus)
    assert (status.checked, status.accepted, status.is_forbidden, status.refused) == (11, 0, False, ())
    assert bench.give(order) == []
    assert bench.refused == {"replayed": 1}
    assert bench.give(signed(RADIO, authority="remote", order="start", is_check=True)) == []
    assert bench.refused["not_permitted"] == 1
    assert not bench.gate._verifier.attendance.is_lost(bench.now_ns + 3600 * S)  # a check starts no attendance


def test_an_emergency_stop_is_no_check(bench: Bench) -> None:
    """Whatever is beside it in the payload."""
    assert bench.give(signed(order="emergency_stop", is_check=True)) == [OperatorCommandKind.EMERGENCY_STOP]
