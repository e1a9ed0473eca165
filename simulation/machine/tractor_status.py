"""Tractor ECU, sending side: status frames of the DBC, each at its period."""

import math
from collections.abc import Callable, Mapping

import numpy as np
from cantools.database.can import Database, Message

from simulation.machine.ecu_checks import HEARTBEAT_LAST, HEARTBEAT_START, xbr_checksum
from simulation.machine.implement import can_fold
from simulation.machine.machine import Machine
from simulation.machine.tractor_bus import TractorBus

SUPPLY_V, SUPPLY_SIGMA_V = 13.8, 0.03
CLEAR, COMMAND_TIMEOUT = 0, 5  # guidance exit codes
LIMITED_HIGH, LIMITED_LOW = 2, 3
END_STOP_RAD = 0.01
FOLD_EVERY = 5  # one in this many cab frames
TRACTOR_NAME = {  # an agricultural tractor ECU: industry group 2, device class 1, function 134
    "Identity": 1, "Manufacturer": 0x7FF, "EcuInstance": 0, "FunctionInstance": 0, "Function": 134, "DeviceClass": 1,
    "DeviceClassInstance": 0, "IndustryGroup": 2, "SelfConfigurable": 0,
}  # fmt: skip


class StatusFrame:
    """One message of the DBC; signals without value are sent as all ones (not available)."""

    def __init__(self, message: Message) -> None:
        self.identifier = message.frame_id
        self.period_ns = (message.cycle_time or 1000) * 1_000_000
        self._message = message
        self._ones = {s.name: s.raw_to_scaled((1 << s.length) - 1, decode_choices=False) for s in message.signals}

    def encode(self, values: Mapping[str, int | float]) -> bytes:
        """Bytes of the frame, with its checksum where it has one."""
        data = self._message.encode({**self._ones, "Checksum": 0, **values}, padding=True, strict=False)
        if "Checksum" not in self._ones:
            return data
        return data[:7] + bytes([data[7] & 0x0F | xbr_checksum(self.identifier, data) << 4])


class TractorStatus:
    """Sends the state of the machine as measured by its own sensors."""

    def __init__(self, machine: Machine, bus: TractorBus, database: Database, random: np.random.Generator) -> None:
        self._machine, self._bus, self._random = machine, bus, random
        self._counters = [0, 0, 0]
        self._cab_frames = 0
        self._heartbeat = HEARTBEAT_START
        self._is_claimed = False
        frames: dict[str, Callable[[], list[Mapping[str, int | float]]]] = {
            "GuidanceMachineStatus": self._guidance_values,
            "WheelBasedSpeed": self._wheel_values,
            "RearHitchStatus": self._hitch_values,
            "RearPtoStatus": self._pto_values,
            "CabState": self._cab_values,
            "HeartbeatTractor": self._heartbeat_values,
        }
        self._frames = [(StatusFrame(database.get_message_by_name(name)), values) for name, values in frames.items()]
        self._address_claim = StatusFrame(database.get_message_by_name("AddressClaimedTractor"))

    def send(self, elapsed_ns: int) -> None:
        """Sends the frames due `elapsed_ns` after the start."""
        if not self._is_claimed:
            self._is_claimed = True
            self._bus.send(self._address_claim.identifier, self._address_claim.encode(TRACTOR_NAME))
        for frame, values in self._frames:
            if elapsed_ns % frame.period_ns == 0:
                for group in values():
                    self._bus.send(frame.identifier, frame.encode(group))

    def _guidance_values(self) -> list[Mapping[str, int | float]]:
        steering, machine = self._machine.steering, self._machine
        curvature = math.tan(machine.measured_angle_rad) / machine.wheelbase_m
        is_at_end = abs(steering.angle_rad) > steering.max_angle_rad - END_STOP_RAD
        limit = (LIMITED_LOW if curvature > 0.0 else LIMITED_HIGH) if is_at_end else 0
        return [{
            "EstimatedCurvature": -curvature * 1e3, "MechanicalLockout": 0, "LimitStatus": limit,
            "SteeringReady": int(self._bus.is_steering_ready), "InputPosition": 1, "ResetRequest": 0,
            "ExitCode": COMMAND_TIMEOUT if self._bus.is_safe_state else CLEAR, "RemoteEngageSwitch": 1,
        }]  # fmt: skip

    def _wheel_values(self) -> list[Mapping[str, int | float]]:
        speed, distance = self._machine.wheel_speed_mps, self._machine.wheel_distance_m
        return [{"Speed": abs(speed), "Distance": distance, "Direction": int(speed >= 0.0), "Key": 1, "StartStop": 1}]

    def _hitch_values(self) -> list[Mapping[str, int | float]]:
        attached = self._machine.attached
        return [{"Position": 100.0 * attached.hitch, "InWork": int(attached.is_working), "Draft": attached.draft_n()}]

    def _pto_values(self) -> list[Mapping[str, int | float]]:
        rpm = self._machine.attached.pto_radps * 30.0 / math.pi
        return [{"Speed": rpm, "Engaged": int(rpm > 20.0), "Mode": 0}]

    def _cab_values(self) -> list[Mapping[str, int | float]]:
        """No driver on board: driver torque, angle and rate, which exclude the actuator's, are zero."""
        supply = SUPPLY_V + SUPPLY_SIGMA_V * float(self._random.standard_normal())
        driver = {"Group": 1, "HandTorque": 0.0, "HandAngle": 0.0, "HandRate": 0.0}
        cab = {
            "Group": 2, "BrakePedal": 0.0, "ClutchPedal": 0.0, "SupplyVoltage": supply, "Seat": 0, "EmergencyButton": 0,
            "ParkBrakeState": int(self._machine.park_brake > 0.95), "HornState": int(self._bus.is_horn_on),
            "BeaconState": int(self._bus.is_beacon_on),
        }  # fmt: skip
        return [{**driver, "Counter": self._count(0)}, {**cab, "Counter": self._count(1)}, *self._fold_values()]

    def _fold_values(self) -> list[Mapping[str, int | float]]:
        """Fold position, in every fifth cab frame, of an implement that folds."""
        self._cab_frames += 1
        attached = self._machine.attached
        if self._cab_frames % FOLD_EVERY != 1 or not can_fold(attached.implement):
            return []
        return [{"Group": 3, "FoldPosition": 100.0 * attached.fold, "Counter": self._count(2)}]

    def _heartbeat_values(self) -> list[Mapping[str, int | float]]:
        sequence = self._heartbeat
        self._heartbeat = 0 if sequence >= HEARTBEAT_LAST else sequence + 1
        return [{"Sequence": sequence}]

    def _count(self, group: int) -> int:
        self._counters[group] = (self._counters[group] + 1) & 15
        return self._counters[group]
