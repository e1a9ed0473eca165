"""Gateway against other senders on the bus: recognized within 200 ms, named, answered by a stop; no false alarm."""

from collections.abc import Iterator
from dataclasses import replace

import can
import pytest

from interfaces.isobus import brake, guidance, speed
from interfaces.isobus.frame import encode_identifier
from interfaces.isobus.heartbeat import ERROR
from messages.command import Mode
from messages.faults import Fault, Response
from tests.interfaces import dbc
from tests.interfaces.gateway_rig import DRIVE, HOLD, MS, Rig, engaged, is_stopped

GATEWAY, TRACTOR, STRANGER = 28, 240, 99
FAST = speed.encode_command(3.9)
LEFT = guidance.encode_command(0.2, True)


@pytest.fixture
def rig() -> Iterator[Rig]:
    rig = Rig()
    yield rig
    rig.close()


def inject(rig: Rig, identifier: int, data: bytes) -> None:
    rig.tractor.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=True))


def named(group: int, source: int, destination: int = 255) -> int:
    return encode_identifier(3, group, source, destination)


def faults_after(rig: Rig, ms: int) -> dict[str, Fault]:
    rig.outputs.clear()
    rig.forward(ms, DRIVE)
    return {m.code: m for _, m in rig.outputs if isinstance(m, Fault) and m.is_active}


@pytest.mark.parametrize(
    ("identifier", "data", "code", "words"),
    [
        (named(speed.COMMAND_GROUP, GATEWAY), FAST, "foreign_source", "PGN 64835"),
        (named(guidance.COMMAND_GROUP, GATEWAY, TRACTOR), LEFT, "foreign_source", "PGN 44288"),
        (named(0xF0E4, GATEWAY), b"\x05", "foreign_source", "PGN 61668"),
        (named(0xEE00, GATEWAY), b"\xff" * 8, "foreign_source", "PGN 60928"),
        (named(guidance.COMMAND_GROUP, STRANGER, TRACTOR), LEFT, "foreign_command", "guidance, PGN 44288"),
        (named(speed.COMMAND_GROUP, STRANGER), FAST, "foreign_command", "speed, PGN 64835 from address 99"),
        (named(0xFE42, 0), b"\xff" * 8, "foreign_command", "hitch and PTO, PGN 65090 from address 0"),
        (named(brake.GROUP, STRANGER, TRACTOR), b"\xff" * 8, "foreign_command", "brake, PGN 1024 from address 99"),
        (named(0xEE00, TRACTOR), b"\x01" * 8, "second_tractor", "another NAME"),
    ],
)  # fmt: skip
def test_one_foreign_frame_stops_the_machine(rig: Rig, identifier: int, data: bytes, code: str, words: str) -> None:
    rig.forward(400, HOLD)
    inject(rig, named(0xEE00, TRACTOR), b"\x02" * 8)
    engaged(rig)
    inject(rig, identifier, data)
    found = faults_after(rig, 40)
    assert set(found) == {f"gateway.{code}"}
    fault = found[f"gateway.{code}"]
    assert words in fault.text_en
    assert words in fault.text_zh
    assert fault.response is Response.CONTROLLED_STOP
    assert rig.newest("MachineSelectedSpeedCommand")["SetPoint"] == 0
    assert rig.newest("ExternalBrakeRequest")["ControlMode"] == 2
    assert rig.newest("HeartbeatGateway")["Sequence"] == ERROR
    assert rig.newest("AuxiliaryCommand")["DriveEnable"] == 3  # not withdrawn: the tractor stays in its safe state


@pytest.mark.parametrize("per_s", [10, 20, 50, 200])
@pytest.mark.parametrize("name", ["WheelBasedSpeed", "GuidanceMachineStatus"])
def test_second_sender_of_tractor_frames(rig: Rig, name: str, per_s: int) -> None:
    engaged(rig)
    data = dbc.encode(name, **rig.values[name])
    rig.outputs.clear()
    for k in range(30):
        if k % max(1, 100 // per_s) == 0:
            for _ in range(max(1, per_s // 100)):
                inject(rig, dbc.identifier(name), data)
        rig.step(DRIVE)
    stamps = [m.stamp_ns for _, m in rig.outputs if isinstance(m, Fault) and m.code == "gateway.second_tractor"]
    assert stamps[0] - (rig.now_ns - 300 * MS) <= 200 * MS


@pytest.mark.parametrize("after_steps", range(1, 20))
def test_one_counterfeit_status_frame(rig: Rig, after_steps: int) -> None:
    engaged(rig)
    for _ in range(after_steps):
        rig.step(DRIVE)
    inject(rig, dbc.identifier("WheelBasedSpeed"), dbc.encode("WheelBasedSpeed", Speed=0.1, Direction=1))
    assert set(faults_after(rig, 110)) == {"gateway.second_tractor"}


def test_attack_by_counterfeit_heartbeat_of_the_tractor(rig: Rig) -> None:
    engaged(rig)
    inject(rig, dbc.identifier("HeartbeatTractor"), bytes([(rig.beat + 1) % 251]))
    assert set(faults_after(rig, 120)) == {"gateway.tractor_silent"}


def test_fault_and_stop_end_after_the_last_sign(rig: Rig) -> None:
    engaged(rig)
    inject(rig, named(speed.COMMAND_GROUP, GATEWAY), FAST)
    rig.forward(980, DRIVE)
    assert rig.faults == {"gateway.foreign_source"}
    rig.forward(180, HOLD)
    assert not rig.faults
    beats = [v["Sequence"] for _, v in rig.read("HeartbeatGateway")][-1:]
    assert beats[0] in (251, 0)


def test_manual_driving_is_not_disturbed(rig: Rig) -> None:
    manual = replace(HOLD, mode=Mode.MANUAL, deceleration_mps2=0.0)
    rig.forward(400, manual)
    inject(rig, named(guidance.COMMAND_GROUP, STRANGER, TRACTOR), LEFT)
    rig.forward(40, manual)
    assert rig.faults == {"gateway.foreign_command"}
    assert rig.newest("ExternalBrakeRequest")["ControlMode"] == 0
    assert rig.newest("HeartbeatGateway")["Sequence"] < ERROR


@pytest.mark.parametrize("kind", ["frame", "error"])
def test_flood_is_named_and_does_not_hold_up_the_gateway(rig: Rig, kind: str) -> None:
    engaged(rig)
    rig.outputs.clear()
    start_ns = rig.now_ns
    for _ in range(20):
        for k in range(100):
            rig.tractor.send(
                can.Message(arbitration_id=0x08, is_error_frame=True)
                if kind == "error"
                else can.Message(arbitration_id=named(0xFF00 + k, 1 + k), data=b"", is_extended_id=True)
            )
        rig.step(DRIVE)
    stamps = [m.stamp_ns for _, m in rig.outputs if isinstance(m, Fault) and m.code == "gateway.flood"]
    assert stamps[0] - start_ns <= 100 * MS
    assert rig.bus.recv(0) is not None  # not all were read
    assert rig.newest("HeartbeatGateway")["Sequence"] == ERROR


@pytest.mark.parametrize("steps", [10, 60])
def test_a_halted_tractor_that_catches_up_is_no_attack(rig: Rig, steps: int) -> None:
    engaged(rig)
    rig.is_talking = False
    rig.forward(10 * steps, DRIVE)
    for _ in range(steps // 10):
        rig.talk()
    rig.is_talking = True
    rig.forward(400, DRIVE)
    assert not rig.faults & {"gateway.second_tractor", "gateway.flood", "gateway.foreign_source"}


@pytest.mark.parametrize("halt_ms", [300, 1000, 3000])
def test_a_halted_gateway_that_catches_up_is_no_flood(rig: Rig, halt_ms: int) -> None:
    engaged(rig)
    for _ in range(halt_ms // 100):
        for k in range(15):
            inject(rig, named(0xFF00 + k, 7), b"")
        rig.talk()
        rig.now_ns += 100 * MS
    rig.forward(400, HOLD)
    assert "gateway.flood" not in rig.faults


def test_lost_heartbeats_are_not_named_as_a_second_tractor(rig: Rig) -> None:
    engaged(rig)
    send = rig.send
    rig.send = lambda name, data: None if name == "HeartbeatTractor" else send(name, data)
    rig.forward(1500, DRIVE)
    assert rig.faults == {"gateway.tractor_silent"}


def test_regular_contention_at_the_start_is_no_attack(rig: Rig) -> None:
    rig.step(HOLD)
    inject(rig, named(0xEE00, GATEWAY), b"\xff" * 8)
    rig.forward(600, HOLD)
    assert not rig.faults


def test_bus_off_and_restart(rig: Rig) -> None:
    engaged(rig)
    rig.tractor.send(can.Message(arbitration_id=0x40, is_error_frame=True))
    rig.forward(40, DRIVE)
    assert rig.faults == {"gateway.bus"}
    rig.forward(1500, DRIVE)
    assert rig.faults == {"gateway.bus"}
    rig.tractor.send(can.Message(arbitration_id=0x100, is_error_frame=True))
    rig.forward(1100, HOLD)
    assert not rig.faults


def test_stop_while_contested_is_complete(rig: Rig) -> None:
    engaged(rig)
    for _ in range(30):
        inject(rig, named(speed.COMMAND_GROUP, GATEWAY), FAST)
        rig.step(DRIVE)
    assert not is_stopped(rig)  # only by the drive request
    assert rig.newest("GuidanceSystemCommand")["Intent"] == 0
    assert rig.newest("HitchAndPtoCommands")["RearPtoEngage"] == 0
    assert rig.newest("StopAllImplements")["Permit"] == 0
