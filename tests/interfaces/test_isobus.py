"""Codec against cantools over the full range of every value, including reserved bits and missing values."""

import itertools
import math

import pytest

from interfaces.isobus import brake, cab, guidance, implement, speed, stop_all
from interfaces.isobus.checksum import ProtectionCheck, checksum, protect
from interfaces.isobus.frame import decode_identifier, encode_identifier
from interfaces.isobus.heartbeat import Heartbeat
from interfaces.isobus.values import NOT_AVAILABLE, BadFrame, Scale
from tests.interfaces import dbc

ENDS_16 = [0, 1, 2, 3, 4, 5, 255, 256, 257, 32126, 32127, 32128, 32129, 32130]
LAST_16 = list(range(0xFAFF - 5, 0xFAFF + 1))
RAW_16 = sorted({*ENDS_16, *LAST_16, *range(0, 0xFAFF, 641)})
NOT_16 = [*range(0xFB00, 0xFB06), 0xFBFF, 0xFDFF, 0xFE00, 0xFE01, 0xFEFF, 0xFF00, 0xFFFE, 0xFFFF]
RAW_8 = sorted({0, 1, 2, 3, 4, 5, *range(245, 251), *range(0, 251, 10)})
NOT_8 = [0xFB, 0xFC, 0xFD, 0xFE, 0xFF]


def with_raw(data: bytes, byte: int, raw: int, size: int = 2) -> bytes:
    return data[: byte - 1] + raw.to_bytes(size, "little") + data[byte - 1 + size :]


def assert_reserved_are_ones(name: str, data: bytes) -> None:
    mask = dbc.reserved_mask(name)
    assert int.from_bytes(data, "little") & mask == mask


# identifiers


@pytest.mark.parametrize(
    ("name", "priority", "group", "source", "destination"),
    [
        ("GuidanceSystemCommand", 3, guidance.COMMAND_GROUP, 28, 240),
        ("GuidanceMachineStatus", 3, guidance.STATUS_GROUP, 240, 28),
        ("WheelBasedSpeed", 3, speed.WHEEL_GROUP, 240, 255),
        ("GroundBasedSpeed", 3, speed.GROUND_GROUP, 240, 255),
        ("MachineSelectedSpeed", 3, speed.SELECTED_GROUP, 240, 255),
        ("MachineSelectedSpeedCommand", 3, speed.COMMAND_GROUP, 28, 255),
        ("RearHitchStatus", 3, implement.REAR_HITCH_GROUP, 240, 255),
        ("FrontHitchStatus", 3, implement.FRONT_HITCH_GROUP, 240, 255),
        ("RearPtoStatus", 3, implement.REAR_PTO_GROUP, 240, 255),
        ("FrontPtoStatus", 3, implement.FRONT_PTO_GROUP, 240, 255),
        ("HitchAndPtoCommands", 3, implement.COMMAND_GROUP, 28, 255),
        ("StopAllImplements", 3, stop_all.GROUP, 28, 255),
        ("HeartbeatGateway", 3, 0xF0E4, 28, 255),
        ("ExternalBrakeRequest", 3, brake.GROUP, 28, 240),
        ("AuxiliaryCommand", 3, cab.GROUP, 28, 240),
        ("CabState", 3, cab.GROUP, 240, 28),
        ("AddressClaimedGateway", 6, 0xEE00, 28, 255),
    ],
)
def test_identifiers_against_dbc(name, priority, group, source, destination):
    assert encode_identifier(priority, group, source, destination) == dbc.identifier(name)
    assert decode_identifier(dbc.identifier(name)) == (priority, group, source, destination)


# guidance


@pytest.mark.parametrize("is_intending", [False, True])
def test_guidance_command_range(is_intending):
    for raw in RAW_16:
        left_radpm = -(raw * 0.25 - 8032.0) / 1000.0
        data = guidance.encode_command(left_radpm, is_intending)
        read = dbc.decode("GuidanceSystemCommand", data)
        assert read["Curvature"] == raw * 0.25 - 8032.0
        assert read["Intent"] == is_intending
        assert_reserved_are_ones("GuidanceSystemCommand", data)


def test_left_curvature_is_negative_on_bus():
    assert dbc.decode("GuidanceSystemCommand", guidance.encode_command(0.2, True))["Curvature"] == -200.0
    assert guidance.encode_command(0.0, True)[:2] == (32128).to_bytes(2, "little")


@pytest.mark.parametrize("curvature_radpm", [math.nan, math.inf, -math.inf, 8.0322, -8.0319])
def test_curvature_out_of_range(curvature_radpm):
    with pytest.raises(ValueError, match="does not fit"):
        guidance.encode_command(curvature_radpm, True)


def test_idle_guidance_command():
    data = guidance.encode_idle()
    assert dbc.decode("GuidanceSystemCommand", data)["Intent"] == 0
    assert data[:2] == b"\xff\xff"
    assert_reserved_are_ones("GuidanceSystemCommand", data)


def guidance_status(**values):
    standard = {"EstimatedCurvature": 0, "MechanicalLockout": 0, "SteeringReady": 1, "LimitStatus": 0, "ExitCode": 0}
    return dbc.encode("GuidanceMachineStatus", **(standard | values))


def test_guidance_status_range():
    for raw in RAW_16:
        right = raw * 0.25 - 8032.0
        read = guidance.decode_status(guidance_status(EstimatedCurvature=right))
        assert read.curvature_radpm == pytest.approx(-right / 1000.0, abs=1e-12)
        assert (read.is_steering_ready, read.is_locked_out, read.limit, read.exit_code) == (True, False, 0, 0)


@pytest.mark.parametrize("raw", NOT_16)
def test_guidance_status_without_curvature(raw):
    with pytest.raises(BadFrame):
        guidance.decode_status(with_raw(guidance_status(), 1, raw))


@pytest.mark.parametrize("limit", range(8))
def test_guidance_limit_status_bits(limit):
    data = guidance_status(LimitStatus=limit)
    if limit in (4, 5):
        with pytest.raises(BadFrame):
            guidance.decode_status(data)
    else:
        assert guidance.decode_status(data).limit == limit


def test_guidance_exit_codes_and_ready_states():
    for code in range(64):
        assert guidance.decode_status(guidance_status(ExitCode=code)).exit_code == code
    for state in range(4):
        assert guidance.decode_status(guidance_status(SteeringReady=state)).is_steering_ready == (state == 1)
        assert guidance.decode_status(guidance_status(MechanicalLockout=state)).is_locked_out == (state != 0)


# speed


def test_speed_command_range():
    for raw in RAW_16:
        for sign in (1, -1):
            data = speed.encode_command(sign * raw * 0.001)
            read = dbc.decode("MachineSelectedSpeedCommand", data)
            assert read["SetPoint"] == pytest.approx(raw * 0.001, abs=1e-9)
            assert read["Direction"] == (sign > 0 or raw == 0)
            assert data[2:4] == b"\xff\xff"
            assert_reserved_are_ones("MachineSelectedSpeedCommand", data)


@pytest.mark.parametrize("speed_mps", [math.nan, math.inf, 64.256, -64.256])
def test_speed_out_of_range(speed_mps):
    with pytest.raises(ValueError, match="does not fit"):
        speed.encode_command(speed_mps)


@pytest.mark.parametrize("name", ["WheelBasedSpeed", "GroundBasedSpeed"])
def test_speed_range(name):
    for raw in RAW_16:
        for direction in (0, 1):
            read = speed.decode_speed(dbc.encode(name, Speed=raw * 0.001, Direction=direction))
            assert read == pytest.approx(raw * 0.001 * (1 if direction else -1), abs=1e-12)


@pytest.mark.parametrize("raw", NOT_16)
def test_missing_speed(raw):
    with pytest.raises(BadFrame):
        speed.decode_speed(with_raw(dbc.encode("WheelBasedSpeed", Speed=0, Direction=1), 1, raw))


@pytest.mark.parametrize("direction", [2, 3])
def test_missing_direction_by_speed(direction):
    with pytest.raises(BadFrame):
        speed.decode_speed(dbc.encode("WheelBasedSpeed", Speed=1, Direction=direction))
    assert speed.decode_speed(dbc.encode("WheelBasedSpeed", Speed=0, Direction=direction)) == 0.0


def test_selected_speed_limit_status_bits():
    for limit in (0, 1, 2, 3, 6, 7):
        for source in (0, 1, 2, 3, 4, 7):
            data = dbc.encode(
                "MachineSelectedSpeed", Speed=2.5, Direction=1, Source=source, LimitStatus=limit, ExitCode=5
            )
            assert speed.decode_selected(data) == speed.SelectedSpeed(2.5, source, limit, 5)
    for limit in (4, 5):
        with pytest.raises(BadFrame):
            speed.decode_selected(dbc.encode("MachineSelectedSpeed", Speed=1, Direction=1, Source=0, LimitStatus=limit))


# implement


@pytest.mark.parametrize("name", ["RearHitchStatus", "FrontHitchStatus"])
def test_hitch_range(name):
    for raw in RAW_8:
        for is_in_work in (0, 1):
            read = implement.decode_hitch(dbc.encode(name, Position=raw * 0.4, InWork=is_in_work, LimitStatus=3))
            assert (read.position, read.is_in_work, read.limit) == (pytest.approx(raw / 250), is_in_work == 1, 3)


def test_hitch_without_position_or_work_state():
    good = dbc.encode("RearHitchStatus", Position=0, InWork=1)
    for raw in NOT_8:
        with pytest.raises(BadFrame):
            implement.decode_hitch(with_raw(good, 1, raw, 1))
    for state in (2, 3):
        with pytest.raises(BadFrame):
            implement.decode_hitch(dbc.encode("RearHitchStatus", Position=0, InWork=state))


@pytest.mark.parametrize("name", ["RearPtoStatus", "FrontPtoStatus"])
def test_pto_range(name):
    for raw in RAW_16:
        read = implement.decode_pto(dbc.encode(name, Speed=raw * 0.125, Engaged=raw % 2, LimitStatus=2))
        assert read == implement.PtoStatus(raw * 0.125, raw % 2 == 1, 2)
    for raw in NOT_16:
        with pytest.raises(BadFrame):
            implement.decode_pto(with_raw(dbc.encode(name, Speed=0, Engaged=0), 1, raw))


def test_hitch_and_pto_command_range():
    for k, raw in enumerate(RAW_16):
        position = RAW_8[k % len(RAW_8)]
        data = implement.encode_commands(position / 250, raw * 0.125, k % 2 == 0)
        read = dbc.decode("HitchAndPtoCommands", data)
        assert read["RearHitchPosition"] == pytest.approx(position * 0.4)
        assert (read["RearPtoSpeed"], read["RearPtoEngage"]) == (raw * 0.125, k % 2 == 0)
        assert data[0] == 0xFF
        assert data[2:4] == b"\xff\xff"
        assert read["FrontPtoEngage"] == 3
        assert data[7] == 0xFF
        assert_reserved_are_ones("HitchAndPtoCommands", data)


def test_empty_command_is_all_ones():
    assert implement.encode_commands(None, None, None) == NOT_AVAILABLE


@pytest.mark.parametrize("position", [-0.001, 1.001, math.nan])
def test_hitch_position_out_of_range(position):
    with pytest.raises(ValueError, match="position"):
        implement.encode_commands(position, None, None)


# brake


def xbr(deceleration_mps2: float, counter: int) -> bytes:
    return protect(dbc.identifier("ExternalBrakeRequest"), brake.encode_request(deceleration_mps2), counter)


def test_brake_request_range():
    for k in range(0, 15687, 37):
        data = xbr(k / 1000, k)
        read = dbc.decode("ExternalBrakeRequest", data)
        assert read["Acceleration"] == pytest.approx(-k / 1000, abs=0.5 / 2048 + 1e-9)
        assert (read["ControlMode"], read["Priority"], read["Counter"]) == (2 if k else 0, 0, k % 16)
        assert read["Checksum"] == second_checksum(dbc.identifier("ExternalBrakeRequest"), data)
        assert_reserved_are_ones("ExternalBrakeRequest", data)


@pytest.mark.parametrize("deceleration_mps2", [-0.001, math.nan, math.inf, 15.7])
def test_invalid_deceleration(deceleration_mps2):
    with pytest.raises(ValueError, match=r"deceleration|fit"):
        brake.encode_request(deceleration_mps2)


def second_checksum(identifier: int, data: bytes) -> int:
    """Independent implementation of the J1939-71 formula, byte by byte."""
    total = data[0] + data[1] + data[2] + data[3] + data[4] + data[5] + data[6] + (data[7] & 0x0F)
    total += (identifier & 0xFF) + (identifier >> 8 & 0xFF) + (identifier >> 16 & 0xFF) + (identifier >> 24 & 0xFF)
    return ((total >> 4) + total) & 0x0F


def test_checksum_formula():
    # 0x0C + 0x04 + 0xF0 + 0x1C + 7·0xFF + 1 = 284 + 1785 + 1 = 2070; 2070 >> 4 = 129; 2199 & 15 = 7
    assert checksum(0x0C04F01C, b"\xff" * 7 + b"\xf1") == 7


def test_single_bit_errors_of_protected_frame():
    identifier = dbc.identifier("ExternalBrakeRequest")
    good = xbr(2.5, 3)
    ProtectionCheck().check(identifier, good)
    for bit in range(64):
        with pytest.raises(BadFrame, match="checksum"):
            ProtectionCheck().check(identifier, (int.from_bytes(good, "little") ^ 1 << bit).to_bytes(8, "little"))


@pytest.mark.parametrize("step", range(16))
def test_counter_steps(step):
    check, body = ProtectionCheck(), b"\x01" * 7
    check.check(1, protect(1, body, 14))
    if 1 <= step <= 3:
        check.check(1, protect(1, body, 14 + step))
    else:
        with pytest.raises(BadFrame, match="counter"):
            check.check(1, protect(1, body, 14 + step))


# ours


@pytest.mark.parametrize(
    "states",
    list(itertools.product((None, False, True), repeat=5)),
)
def test_auxiliary_command_states(states):
    identifier = dbc.identifier("AuxiliaryCommand")
    data = protect(identifier, cab.encode_auxiliary(*states), 5)
    read = dbc.decode("AuxiliaryCommand", data)
    target = [3 if state is None else int(state) for state in states]
    assert [read[k] for k in ("DriveEnable", "ParkBrake", "Horn", "Beacon", "Fold")] == target
    assert (read["Group"], read["Counter"], read["Checksum"]) == (16, 5, second_checksum(identifier, data))
    assert_reserved_are_ones("AuxiliaryCommand", data)


def cab_frame(**values) -> bytes:
    return dbc.encode("CabState", Counter=0, Checksum=0, **values)


def test_fold_range():
    for raw in RAW_8:
        assert cab.decode_cab_state(cab_frame(Group=3, FoldPosition=0.4 * raw)).position == pytest.approx(0.004 * raw)
    for raw in NOT_8:
        with pytest.raises(BadFrame):
            cab.decode_cab_state(with_raw(cab_frame(Group=3, FoldPosition=0), 2, raw, 1))


def test_driver_steering_range():
    for raw in RAW_16:
        data = cab_frame(Group=1, HandTorque=raw * 0.01 - 320, HandAngle=raw * 0.001 - 32, HandRate=raw * 0.001 - 32)
        read = cab.decode_cab_state(data)
        assert read.torque_nm == pytest.approx(raw * 0.01 - 320)
        assert read.angle_rad == pytest.approx(raw * 0.001 - 32)
        assert read.rate_radps == pytest.approx(raw * 0.001 - 32)
    for byte in (2, 4, 6):
        for raw in NOT_16:
            with pytest.raises(BadFrame):
                cab.decode_cab_state(with_raw(cab_frame(Group=1, HandTorque=0, HandAngle=0, HandRate=0), byte, raw))


def cab_state(**values) -> bytes:
    standard = {
        "BrakePedal": 0,
        "ClutchPedal": 0,
        "SupplyVoltage": 13.8,
        "Seat": 0,
        "EmergencyButton": 0,
        "ParkBrakeState": 0,
        "HornState": 0,
        "BeaconState": 0,
    }
    return cab_frame(Group=2, **(standard | values))


def test_cab_range():
    for raw in RAW_8:
        read = cab.decode_cab_state(cab_state(BrakePedal=raw * 0.4, ClutchPedal=100 - raw * 0.4))
        assert (read.brake_pedal, read.clutch_pedal) == (pytest.approx(raw / 250), pytest.approx(1 - raw / 250))
    for raw in RAW_16:
        assert cab.decode_cab_state(cab_state(SupplyVoltage=raw * 0.05)).supply_v == pytest.approx(raw * 0.05)


@pytest.mark.parametrize(
    ("signal", "field"),
    [
        ("Seat", "is_seat_occupied"),
        ("EmergencyButton", "is_emergency_button_pressed"),
        ("ParkBrakeState", "is_park_brake_set"),
        ("HornState", "is_horn_on"),
        ("BeaconState", "is_beacon_on"),
    ],
)
def test_cab_flags_are_independent(signal, field):
    flags = [f for f in cab.CabState.__dataclass_fields__ if f.startswith("is_")]
    read = cab.decode_cab_state(cab_state(**{signal: 1}))
    assert {f: getattr(read, f) for f in flags} == {f: f == field for f in flags}
    for state in (2, 3):
        with pytest.raises(BadFrame):
            cab.decode_cab_state(cab_state(**{signal: state}))


@pytest.mark.parametrize("group", [0, 4, 16, 255])
def test_unknown_cab_group(group):
    with pytest.raises(BadFrame, match="group"):
        cab.decode_cab_state(bytes([group]) + b"\x00" * 7)


# stop all, heartbeat, lengths


def test_stop_all_transition_count():
    sender = stop_all.StopAll()
    states = [None, True, True, False, False, True, None, False, True, False]
    read = [dbc.decode("StopAllImplements", sender.encode(state)) for state in states]
    assert [r["Permit"] for r in read] == [3, 1, 1, 0, 0, 1, 3, 0, 1, 0]
    assert [r["TransitionCount"] for r in read] == [0, 0, 0, 1, 1, 1, 1, 2, 2, 3]
    assert_reserved_are_ones("StopAllImplements", sender.encode(True))


def test_stop_all_count_wraps():
    sender = stop_all.StopAll()
    for _ in range(300):
        sender.encode(True)
        assert dbc.decode("StopAllImplements", sender.encode(False))["TransitionCount"] <= 250


def test_heartbeat_sequence():
    beat = Heartbeat()
    sent = [beat.encode()[0] for _ in range(254)]
    assert sent == [251, *range(251), 0, 1]


@pytest.mark.parametrize("length", [0, 1, 7, 9, 64])
@pytest.mark.parametrize(
    "decode",
    [guidance.decode_status, speed.decode_speed, speed.decode_selected, implement.decode_hitch, implement.decode_pto],
)
def test_frame_length(decode, length):
    with pytest.raises(BadFrame, match="bytes instead of 8"):
        decode(b"\x00" * length)


@pytest.mark.parametrize(("size", "highest"), [(1, 0xFA), (2, 0xFAFF), (4, 0xFAFFFFFF)])
def test_highest_valid_raw_value(size, highest):
    scale = Scale(1.0, 0.0, size)
    for raw in range(highest - 5, highest + 6):
        if raw <= highest:
            assert scale.decode(scale.encode(raw), 1) == raw
        else:
            with pytest.raises(ValueError, match="fit"):
                scale.encode(raw)
            with pytest.raises(BadFrame):
                scale.decode(raw.to_bytes(size, "little"), 1)
