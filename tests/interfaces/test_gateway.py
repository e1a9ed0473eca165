"""Gateway: commands and their frames, engagement, time-outs, states."""

import itertools
import math
from dataclasses import replace

import can
import pytest

from messages.command import CanFrames, MachineState, Mode
from tests.interfaces import dbc
from tests.interfaces.gateway_rig import DRIVE, HOLD, MS, START, Rig, engaged, is_released, is_stopped


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.close()


def test_address_claim_before_other_messages(rig):
    rig.forward(250, HOLD)
    assert [i for _, i, _ in rig.sent] == [dbc.identifier("AddressClaimedGateway")]
    rig.forward(20, HOLD)
    assert len(rig.sent) > 5


def test_no_command_without_supervisor(rig):
    rig.forward(1500)
    assert is_released(rig)
    assert not rig.faults


def test_periods_and_counters(rig):
    engaged(rig)
    rig.sent.clear()
    rig.forward(3000, DRIVE)
    counts = {m.name: len(rig.read(m.name)) for m in dbc.database().messages if m.senders == ["Gateway"]}
    assert counts["ExternalBrakeRequest"] == 150
    for name in (
        "GuidanceSystemCommand",
        "MachineSelectedSpeedCommand",
        "HitchAndPtoCommands",
        "AuxiliaryCommand",
        "HeartbeatGateway",
    ):
        assert counts[name] == 30, name
    assert counts["StopAllImplements"] == 3
    counters = [v["Counter"] for _, v in rig.read("ExternalBrakeRequest")]
    assert {(b - a) % 16 for a, b in itertools.pairwise(counters)} == {1}
    beats = [v["Sequence"] for _, v in rig.read("HeartbeatGateway")]
    assert beats == list(range(beats[0], beats[0] + 30))


def test_offer_of_actual_value_until_not_limited(rig):
    rig.values["GuidanceMachineStatus"]["SteeringReady"] = 0
    rig.values["WheelBasedSpeed"]["Speed"] = 0.5
    engaged(rig)
    guidance = rig.newest("GuidanceSystemCommand")
    assert (guidance["Curvature"], guidance["Intent"]) == (-50, 1)
    assert rig.newest("MachineSelectedSpeedCommand")["SetPoint"] == 0.5
    assert rig.newest("HitchAndPtoCommands")["RearHitchPosition"] == 100
    rig.values["GuidanceMachineStatus"]["SteeringReady"] = 1
    rig.forward(600, DRIVE)
    assert rig.newest("GuidanceSystemCommand")["Curvature"] == -100
    assert rig.newest("MachineSelectedSpeedCommand")["SetPoint"] == 2.0
    assert rig.newest("HitchAndPtoCommands")["RearHitchPosition"] == 0
    assert rig.newest("HitchAndPtoCommands")["RearPtoEngage"] == 1


@pytest.mark.parametrize("limit", [0, 1, 2, 3, 6, 7])
def test_acceptance_requires_not_limited(rig, limit):
    rig.values["GuidanceMachineStatus"]["LimitStatus"] = limit
    engaged(rig)
    assert (rig.newest("GuidanceSystemCommand")["Curvature"] == -100) == (limit == 0)


def test_fault_on_steering_not_accepting(rig):
    rig.values["GuidanceMachineStatus"]["SteeringReady"] = 0
    engaged(rig)
    assert not rig.faults
    rig.forward(2100, DRIVE)
    assert rig.faults == {"gateway.steering_refused"}


def test_curvature_rate_limit(rig):
    engaged(rig, replace(DRIVE, curvature_radpm=0.0))
    rig.sent.clear()
    rig.forward(1200, replace(DRIVE, curvature_radpm=0.2))
    read = [(t, -v["Curvature"] / 1000) for t, v in rig.read("GuidanceSystemCommand")]
    rates = [(b[1] - a[1]) / ((b[0] - a[0]) * 1e-9) for a, b in itertools.pairwise(read)]
    slowest = 90 / 60 / 3.2 / 2.55
    assert max(rates[:-2]) <= slowest * (1 + (0.2 * 2.55) ** 2) + 0.02
    assert rates[1] == pytest.approx(slowest, rel=0.1)
    assert read[-1][1] == pytest.approx(0.2)


def test_estimated_curvature_does_not_limit_command(rig):
    rig.values["GuidanceMachineStatus"]["EstimatedCurvature"] = -50
    engaged(rig, replace(DRIVE, curvature_radpm=-0.2))
    rig.forward(1500, replace(DRIVE, curvature_radpm=-0.2))
    assert rig.newest("GuidanceSystemCommand")["Curvature"] == 200


def test_direction_bit_in_reverse(rig):
    engaged(rig, replace(DRIVE, speed_mps=-1.25))
    read = rig.newest("MachineSelectedSpeedCommand")
    assert (read["SetPoint"], read["Direction"]) == (1.25, 0)


@pytest.mark.parametrize("silence_ms", range(60, 150, 10))
def test_safe_command_timeout(silence_ms):
    rig = Rig()
    engaged(rig)
    rig.step(DRIVE)
    rig.forward(silence_ms)
    assert is_stopped(rig) == (silence_ms > 100)
    assert ("gateway.silence" in rig.faults) == (silence_ms > 100)
    rig.close()


def test_recovery_after_timeout(rig):
    engaged(rig)
    rig.forward(300)
    rig.forward(140, DRIVE)
    assert is_stopped(rig)
    rig.forward(400, DRIVE)
    assert rig.newest("AuxiliaryCommand")["DriveEnable"] == 1
    assert not rig.faults


def test_repeated_command_is_not_fresh(rig):
    engaged(rig)
    command = rig.command
    for _ in range(12):
        rig.command = command
        rig.step()
    assert is_stopped(rig)


def test_command_with_future_stamp(rig):
    engaged(rig)
    for _ in range(12):
        rig.command = replace(DRIVE, stamp_ns=rig.now_ns + 30 * MS)
        rig.step()
    assert is_stopped(rig)
    assert "gateway.bad_command" in rig.faults


@pytest.mark.parametrize("field", ["speed_mps", "curvature_radpm", "deceleration_mps2"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9])
def test_command_out_of_range_stops(rig, field, value):
    engaged(rig)
    rig.forward(20, replace(DRIVE, **{field: value}))
    assert is_stopped(rig)
    assert "gateway.bad_command" in rig.faults


def test_timeout_in_manual_mode(rig):
    engaged(rig, replace(HOLD, mode=Mode.MANUAL, deceleration_mps2=0.0))
    assert is_released(rig)
    rig.forward(500)
    assert is_released(rig)


def test_manual_mode_with_an_empty_seat_brakes(rig):
    """The hand of nobody: the steering is off, and the machine does not roll."""
    engaged(rig)
    rig.step(replace(HOLD, mode=Mode.MANUAL, deceleration_mps2=1.5))
    assert rig.newest("ExternalBrakeRequest")["Acceleration"] == pytest.approx(-1.5, abs=1e-3)
    assert rig.newest("GuidanceSystemCommand")["Intent"] == 0
    assert rig.newest("AuxiliaryCommand")["DriveEnable"] == 0
    rig.forward(500)
    assert is_stopped(rig)
    rig.forward(200, replace(HOLD, mode=Mode.MANUAL, deceleration_mps2=0.0))
    assert is_released(rig)


def test_manual_mode_releases_at_once(rig):
    engaged(rig)
    rig.step(replace(DRIVE, mode=Mode.MANUAL))
    assert is_released(rig)


def test_brake_demand_with_drive_disabled(rig):
    engaged(rig)
    rig.step(replace(HOLD, mode=Mode.OBSTACLE_STOP, deceleration_mps2=2.5))
    assert rig.newest("ExternalBrakeRequest")["Acceleration"] == pytest.approx(-2.5, abs=1e-3)
    assert rig.newest("GuidanceSystemCommand")["Intent"] == 0
    assert rig.newest("MachineSelectedSpeedCommand")["SetPoint"] == 0
    assert rig.newest("StopAllImplements")["Permit"] == 1
    assert rig.newest("HitchAndPtoCommands")["RearPtoEngage"] == 3


@pytest.mark.parametrize("mode", [Mode.EMERGENCY_STOP, Mode.FAULT_STOP])
def test_emergency_stop_stops_implement(rig, mode):
    engaged(rig)
    rig.step(replace(HOLD, mode=mode))
    read = rig.newest("StopAllImplements")
    assert (read["Permit"], read["TransitionCount"]) == (0, 1)


def test_brake_request_latency(rig):
    engaged(rig)
    rig.forward(10, DRIVE)
    for _ in range(2):
        rig.sent.clear()
        rig.step(replace(DRIVE, deceleration_mps2=3.0))
        assert rig.newest("ExternalBrakeRequest")["Acceleration"] == pytest.approx(-3.0, abs=1e-3)
        rig.forward(50, DRIVE)


@pytest.mark.parametrize(
    "change", [{"SteeringReady": 0}, {"MechanicalLockout": 1}, {"LimitStatus": 1}, {"LimitStatus": 6}, {"ExitCode": 3}]
)
def test_no_reengagement_after_steering_exit(rig, change):
    engaged(rig)
    rig.values["GuidanceMachineStatus"] |= change
    rig.forward(110, DRIVE)
    assert rig.newest("GuidanceSystemCommand")["Intent"] == 0
    assert rig.newest("MachineSelectedSpeedCommand")["SetPoint"] == 0
    assert rig.newest("ExternalBrakeRequest")["ControlMode"] == 0
    assert "gateway.steering_lost" in rig.faults
    rig.forward(400, DRIVE)  # the supervisor does not react
    assert is_stopped(rig)
    rig.values["GuidanceMachineStatus"] |= {"SteeringReady": 1, "MechanicalLockout": 0, "LimitStatus": 0, "ExitCode": 0}
    rig.forward(500, DRIVE)
    assert is_stopped(rig)
    rig.forward(100, HOLD)
    rig.forward(700, DRIVE)
    assert rig.newest("GuidanceSystemCommand")["Curvature"] == -100


def test_steering_status_timeout(rig):
    engaged(rig)
    del rig.values["GuidanceMachineStatus"]
    rig.forward(420, DRIVE)
    assert "gateway.steering_lost" in rig.faults


def test_machine_state_content(rig):
    rig.values = {
        "GuidanceMachineStatus": {
            "EstimatedCurvature": -125,
            "MechanicalLockout": 0,
            "SteeringReady": 1,
            "LimitStatus": 3,
            "ExitCode": 21,
        },
        "WheelBasedSpeed": {"Speed": 1.234, "Direction": 0},
        "RearHitchStatus": {"Position": 20, "InWork": 1, "LimitStatus": 0},
        "RearPtoStatus": {"Speed": 540, "Engaged": 1, "LimitStatus": 0},
    }
    rig.driver_steering |= {"HandTorque": -3.5, "HandAngle": 0.5, "HandRate": -1.25}
    rig.cab |= {
        "BrakePedal": 40,
        "SupplyVoltage": 12.55,
        "Seat": 1,
        "EmergencyButton": 1,
        "HornState": 1,
        "BeaconState": 1,
    }
    rig.forward(400, HOLD)
    s = rig.state
    then = START + 300 * MS
    assert s.stamp_ns == START + 380 * MS
    assert {s.motion_stamp_ns, s.steering_stamp_ns, s.implement_stamp_ns, s.cab_stamp_ns, s.heartbeat_stamp_ns} == {
        then
    }
    assert (s.speed_mps, s.curvature_radpm) == (pytest.approx(-1.234), pytest.approx(0.125))
    assert (s.is_steering_ready, s.steering_exit_code, s.steering_limit) == (True, 21, 3)
    assert (s.hitch, s.is_hitch_in_work, s.is_pto_engaged) == (pytest.approx(0.2), True, True)
    assert s.pto_radps == pytest.approx(540 * 2 * math.pi / 60)
    assert (s.driver_torque_nm, s.driver_angle_rad, s.driver_rate_radps) == (
        pytest.approx(-3.5),
        pytest.approx(0.5),
        pytest.approx(-1.25),
    )
    assert (s.brake_pedal, s.supply_v) == (pytest.approx(0.4), pytest.approx(12.55))
    assert s.is_seat_occupied
    assert s.is_emergency_button_pressed
    assert s.is_park_brake_set
    assert s.is_horn_on
    assert s.is_beacon_on
    assert s.rejected_frames == 0


def test_fold_command_only_while_active(rig):
    rig.forward(400, replace(HOLD, is_implement_folded=True))
    assert rig.newest("AuxiliaryCommand")["Fold"] == 3
    rig.forward(400, replace(DRIVE, is_implement_folded=True))
    assert rig.newest("AuxiliaryCommand")["Fold"] == 1
    rig.forward(200, DRIVE)
    assert rig.newest("AuxiliaryCommand")["Fold"] == 0
    rig.forward(300)
    assert rig.newest("AuxiliaryCommand")["Fold"] == 3


def test_fold_position_and_timeout(rig):
    rig.forward(400, HOLD)
    assert rig.state.fold_position == 0.0
    rig.fold = {"Group": 3, "FoldPosition": 99.2}
    rig.forward(400, HOLD)
    assert rig.state.fold_position == pytest.approx(0.992)
    last_ns = rig.state.implement_stamp_ns
    rig.fold = None
    rig.forward(400, HOLD)
    assert rig.state.fold_position == pytest.approx(0.992)
    assert rig.state.implement_stamp_ns == last_ns < rig.state.cab_stamp_ns


def test_machine_state_period_and_frame_log(rig):
    engaged(rig)
    states = [m.stamp_ns for _, m in rig.outputs if isinstance(m, MachineState)]
    assert {b - a for a, b in itertools.pairwise(states)} == {20 * MS}
    logged = [f for t, m in rig.outputs if isinstance(m, CanFrames) and t == "can/tx" for f in m.frames]
    assert [(f.stamp_ns, f.identifier, f.data) for f in logged] == rig.sent[: len(logged)]
    assert any(m.frames for t, m in rig.outputs if t == "can/rx")


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("GuidanceMachineStatus", b"\xff" * 8),
        ("GuidanceMachineStatus", b"\x00" * 7),
        ("WheelBasedSpeed", b"\xff" * 8),
        ("RearHitchStatus", b"\xff" * 8),
        ("RearPtoStatus", b"\xff" * 8),
        ("CabState", b"\x01" + b"\x00" * 7),
        ("CabState", b"\xff" * 8),
        ("CabState", b""),
        ("HeartbeatTractor", b"\xfe"),
        ("HeartbeatTractor", b"\x01\x02"),
    ],
)
def test_invalid_frame_is_counted(rig, name, data):
    rig.forward(310, HOLD)
    before = rig.gateway._receiver.state(0)
    rig.send(name, data)
    rig.step(HOLD)
    after = rig.gateway._receiver.state(0)
    assert after == replace(before, rejected_frames=1)


def test_frames_of_other_nodes_are_ignored(rig):
    rig.forward(310, HOLD)
    before = rig.gateway._receiver.state(0)
    for identifier in (0x0CFE48F1, 0x0CAC2AF0, 0x0CACFFF1):
        rig.tractor.send(can.Message(arbitration_id=identifier, data=b"\x00" * 8, is_extended_id=True))
    rig.tractor.send(can.Message(arbitration_id=0x123, data=b"\x00", is_extended_id=False))
    rig.step(HOLD)
    assert rig.gateway._receiver.state(0) == before


def test_tractor_timeout(rig):
    engaged(rig)
    rig.is_talking = False
    rig.forward(600, DRIVE)
    assert "gateway.tractor_silent" in rig.faults
    assert rig.state.stamp_ns - rig.state.motion_stamp_ns >= 500 * MS


def test_lower_name_takes_address(rig):
    rig.forward(400, HOLD)
    rig.tractor.send(can.Message(arbitration_id=0x18EEFF1C, data=b"\x00" * 8, is_extended_id=True))
    rig.forward(400, HOLD)
    assert rig.sent[-1][1] & 0xFF == 128


def test_request_for_claimed_address(rig):
    rig.forward(400, HOLD)
    rig.sent.clear()
    rig.tractor.send(can.Message(arbitration_id=0x18EAFFF0, data=b"\x00\xee\x00", is_extended_id=True))
    rig.step(HOLD)
    assert dbc.identifier("AddressClaimedGateway") in [i for _, i, _ in rig.sent]


def test_bus_failure_is_a_fault(rig):
    engaged(rig)

    def fail(*_):
        raise can.CanOperationError("cable")

    rig.bus.recv = rig.bus.send = fail
    rig.forward(100, DRIVE)
    assert "gateway.bus" in rig.faults


def test_flooded_bus(rig):
    rig.forward(310, HOLD)
    for _ in range(1000):
        rig.tractor.send(can.Message(arbitration_id=0x18FFFFF0, data=b"", is_extended_id=True))
    rig.step(HOLD)
    assert rig.bus.recv(0) is not None
