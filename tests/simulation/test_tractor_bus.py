"""Tractor ECU: accepted and rejected frames, time-outs, safe state, status frames."""

import itertools
import math

import can
import pytest

from simulation.machine.ecu_checks import (
    RECOVERY_COUNT,
    Heartbeat,
    StopAll,
    is_checksum_good,
    is_sequence_good,
    xbr_checksum,
)
from tests.simulation.simulated_farm import Farm, flat


@pytest.fixture
def farm():
    farm = Farm()
    yield farm
    farm.close()


def test_standstill_without_frames(farm):
    farm.send_commands = lambda: None
    farm.drive(2.0)
    assert farm.machine.speed_mps == 0.0
    assert farm.machine.park_brake == 1.0


@pytest.mark.parametrize(("curvature", "is_left"), [(0.1, True), (-0.1, False)])
def test_curvature_sign_on_bus(farm, curvature, is_left):
    farm.curvature_radpm = curvature
    farm.drive_at(1.5)
    assert (farm.machine.yaw_rate_radps > 0.0) == is_left
    assert farm.machine.yaw_rate_radps / farm.machine.speed_mps == pytest.approx(curvature, abs=0.012)
    _, status = farm.frames["GuidanceMachineStatus"][-1]
    assert -status["EstimatedCurvature"] * 1e-3 == pytest.approx(curvature, abs=0.003)


@pytest.mark.parametrize(
    ("name", "timeout_s"),
    [("GuidanceSystemCommand", 0.15), ("MachineSelectedSpeedCommand", 0.3), ("ExternalBrakeRequest", 0.3),
     ("AuxiliaryCommand", 0.3), ("HeartbeatGateway", 0.3)],
)  # fmt: skip
def test_frame_timeout_full_stop(farm, name, timeout_s):
    farm.drive_at(2.78)
    x, v = farm.machine.x_m, farm.machine.speed_mps
    farm.silent.add(name)
    farm.drive(timeout_s - 0.11)
    assert farm.machine.brakes.deceleration_mps2 == 0.0
    farm.drive(3.0)
    assert farm.machine.speed_mps == 0.0
    last = 0.1 if name == "HeartbeatGateway" else 0.02  # since the last frame
    braking = v * 0.45 - 0.06 + (v - 0.6) ** 2 / 8.0
    assert farm.machine.x_m - x < v * (timeout_s + last + 0.02) + braking
    assert farm.frames["GuidanceMachineStatus"][-1][1]["ExitCode"] == 5


def test_safe_state_until_drive_request_withdrawn(farm):
    farm.drive_at(2.0)
    farm.silent.add("GuidanceSystemCommand")
    farm.drive(2.0)
    farm.silent.clear()
    farm.drive(2.0)
    assert farm.machine.speed_mps == 0.0
    farm.drive_at(2.0)
    assert farm.machine.speed_mps > 1.5


def test_safe_state_implement_stop(farm):
    farm.is_lowered = farm.is_pto_on = True
    farm.drive_at(1.5)
    assert farm.machine.attached.is_working
    assert farm.frames["RearPtoStatus"][-1][1]["Engaged"] == 1
    farm.silent.add("HeartbeatGateway")
    farm.drive(4.0)
    assert farm.machine.attached.pto_radps < 1.0


def test_stop_all_implement(farm):
    farm.is_lowered = farm.is_pto_on = True
    farm.drive_at(1.5)
    farm.permit, farm.is_lowered = 0, False
    farm.drive(3.0)
    assert farm.machine.attached.pto_radps < 1.0
    assert farm.machine.attached.hitch == 0.0  # position held


def test_hitch_times(farm):
    farm.is_lowered = True
    farm.drive(0.5)
    assert 0.4 < farm.machine.attached.hitch < 0.65
    farm.drive(1.0)
    assert farm.machine.attached.hitch == 0.0
    farm.is_lowered = False
    farm.drive(1.1)
    assert 0.8 < farm.machine.attached.hitch < 1.0
    farm.drive(0.3)
    assert farm.machine.attached.hitch == 1.0


def test_checksum_and_counter_rejected(farm):
    farm.drive(0.5)
    message = farm.dbc.get_message_by_name("ExternalBrakeRequest")
    before = farm.world._bus.rejected_frames
    farm.bus.send(can.Message(arbitration_id=message.frame_id, data=bytes(8), is_extended_id=True))
    farm._counts -= 1  # repeated counter
    farm.drive(0.02)
    assert farm.world._bus.rejected_frames >= before + 2


@pytest.mark.parametrize("data", [b"", b"\x00", bytes(7), b"\xff" * 8])
@pytest.mark.parametrize("identifier", [0x0C04F01C, 0x0CADF01C, 0x0CFD431C, 0x0CEFF01C, 0x0CF0E41C, 0x12345678])
def test_invalid_frame_standstill(farm, identifier, data):
    farm.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=True))
    farm.drive(0.2)
    assert farm.machine.speed_mps == 0.0


def test_status_frame_periods(farm):
    farm.drive(2.0)
    for name, period_ms, groups in [
        ("GuidanceMachineStatus", 100, (None,)),
        ("WheelBasedSpeed", 100, (None,)),
        ("CabState", 20, (1, 2)),
        ("CabState", 100, (3,)),
    ]:
        stamps = [stamp for stamp, values in farm.frames[name] if values.get("Group") in groups][:: len(groups)]
        assert {b - a for a, b in itertools.pairwise(stamps)} == {period_ms * 1_000_000}
    beats = [values["Sequence"] for _, values in farm.frames["HeartbeatTractor"]]
    assert beats[:3] == [251, 0, 1]


def test_wheel_based_speed_direction():
    farm = Farm(config=flat())
    farm.drive_at(-1.0)
    values = farm.frames["WheelBasedSpeed"][-1][1]
    assert values["Speed"] == pytest.approx(1.0, abs=0.03)
    assert values["Direction"] == 0
    farm.close()


def test_xbr_checksum():
    data = bytes([1, 2, 3, 4, 5, 6, 7, 0x0A])
    total = 28 + 10 + 0x0C + 0x04 + 0xF0 + 0x1C
    expected = ((total >> 4) + total) & 15
    assert xbr_checksum(0x0C04F01C, data) == expected
    assert is_checksum_good(0x0C04F01C, data[:7] + bytes([expected << 4 | 0x0A]))
    assert not any(
        is_checksum_good(0x0C04F01C, data[:7] + bytes([wrong << 4 | 0x0A])) for wrong in range(16) if wrong != expected
    )


@pytest.mark.parametrize(
    ("last", "sequence", "is_good"),
    [(None, 251, True), (None, 7, True), (251, 0, True), (251, 2, True), (251, 3, False), (251, 251, False),
     (5, 5, False), (5, 6, True), (5, 8, True), (5, 9, False), (5, 4, False), (250, 0, True), (249, 1, True),
     (249, 2, False),
     (5, 251, True), (5, 254, False), (5, 255, False)],
)  # fmt: skip
def test_heartbeat_sequence(last, sequence, is_good):
    assert is_sequence_good(last, sequence) == is_good


def test_heartbeat_recovery():
    heartbeat, now = Heartbeat(0.3), 0
    for k in (0, 1, 2, 2):
        now += 100_000_000
        heartbeat.receive(now, k)
    assert not heartbeat.is_good(now)
    for k in range(RECOVERY_COUNT):
        assert not heartbeat.is_good(now)
        now += 100_000_000
        heartbeat.receive(now, 3 + k)
    assert heartbeat.is_good(now)
    assert heartbeat.is_good(now + 300_000_000)
    assert not heartbeat.is_good(now + 300_000_001)


@pytest.mark.parametrize(
    ("states", "is_permitted"),
    [([], False), ([(1, 0)], True), ([(0, 0)], False), ([(0, 0), (1, 0)], True), ([(1, 0), (0, 1)], False),
     ([(1, 0), (0, 1), (1, 1)], True), ([(1, 0), (1, 1)], False), ([(1, 0), (1, 1), (1, 1)], False), ([(3, 0)], False)],
)  # fmt: skip
def test_stop_all_transitions(states, is_permitted):
    stop_all = StopAll(2.5)
    for permit, count in states:
        stop_all.receive(0, permit, count)
    assert stop_all.is_permitted(0) == is_permitted
    assert not stop_all.is_permitted(3_000_000_000)


def test_end_stop_reported(farm):
    farm.curvature_radpm = 0.5
    farm.drive_at(0.8)
    assert farm.frames["GuidanceMachineStatus"][-1][1]["LimitStatus"] in (2, 3)
    assert math.degrees(farm.machine.steering.angle_rad) > 28.0
