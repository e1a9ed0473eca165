"""Tractor ECU, receiving side: obeys valid frames within their time-outs, else enters its safe state."""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache

import can
import cantools
from cantools.database.can import Database
from pydantic import Field

from configs.strict import CONFIGS, Config
from messages.errors import ConfigError
from simulation.machine.ecu_checks import Counter, Deadline, Heartbeat, StopAll, is_checksum_good
from simulation.machine.machine import ActuatorCommand

CURVATURE_MAX_RAW, SPEED_MAX_RAW, HITCH_MAX_RAW = 64255, 64255, 250  # largest valid; above: error or not available
ON = 1
MAX_FRAMES = 200  # per reception; an ECU has hardware filters, so that a flood does not stop it


class BusConfig(Config):
    """Time-outs of the tractor (docs/isobus.md), after which it enters the safe state."""

    guidance_timeout_s: float = Field(gt=0.0, le=2.0)
    command_timeout_s: float = Field(gt=0.0, le=2.0)
    stop_all_timeout_s: float = Field(gt=0.0, le=10.0)


class TractorBus:
    """Reads the gateway's frames and derives the actuator command.

    Safe state: steering released, drive off, full brakes, implement stopped. It ends when all frames are valid again
    and the gateway has withdrawn its drive request meanwhile.
    """

    def __init__(
        self, bus: can.BusABC, database: Database, wheelbase_m: float, full_brake_mps2: float, config: BusConfig
    ) -> None:
        self.rejected_frames = 0
        self.is_safe_state = False
        self.is_horn_on = self.is_beacon_on = False
        self.is_steering_ready = False
        self._wheelbase_m, self._full_brake_mps2 = wheelbase_m, full_brake_mps2
        self._bus = bus
        self._dbc = database
        self._curvature_radpm: float | None = None
        self._speed_mps = self._brake_mps2 = 0.0
        self._hitch: float | None = None
        self._is_pto_requested = self._is_drive_requested = False
        self._is_park_brake_requested = True
        self._fold_request: bool | None = None
        self._guidance = Deadline(config.guidance_timeout_s)
        self._others = [Deadline(config.command_timeout_s) for _ in range(3)]
        self._speed, self._brake, self._auxiliary = self._others
        self._heartbeat = Heartbeat(config.command_timeout_s)
        self._stop_all = StopAll(config.stop_all_timeout_s)
        self._brake_counter, self._auxiliary_counter = Counter(), Counter()
        self._readers: Mapping[str, Callable[[int, dict[str, int]], bool]] = {
            "GuidanceSystemCommand": self._read_guidance,
            "MachineSelectedSpeedCommand": self._read_speed,
            "ExternalBrakeRequest": self._read_brake,
            "AuxiliaryCommand": self._read_auxiliary,
            "HitchAndPtoCommands": self._read_implement,
            "StopAllImplements": self._read_stop_all,
            "HeartbeatGateway": self._read_heartbeat,
        }

    def close(self) -> None:
        """Closes the bus."""
        self._bus.shutdown()

    def send(self, identifier: int, data: bytes) -> None:
        """Sends one frame; with the bus down it is lost."""
        with suppress(can.CanError):
            self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=True))

    def receive(self, now_ns: int) -> None:
        """Processes the received frames; with the bus down there are none."""
        with suppress(can.CanError):
            for _ in range(MAX_FRAMES):
                if (frame := self._bus.recv(0)) is None:
                    break
                self.rejected_frames += not self._process_frame(now_ns, frame)

    def _process_frame(self, now_ns: int, frame: can.Message) -> bool:
        try:
            message = self._dbc.get_message_by_frame_id(frame.arbitration_id)
            reader = self._readers.get(message.name)
            if reader is None:
                return True
            raw = message.decode(bytes(frame.data), decode_choices=False, scaling=False)
        except (KeyError, ValueError, cantools.database.errors.Error):
            return False
        has_checksum = "Checksum" in raw
        if has_checksum and not is_checksum_good(frame.arbitration_id, bytes(frame.data)):
            return False
        return reader(now_ns, raw)  # type: ignore[arg-type]

    def _read_guidance(self, now_ns: int, raw: dict[str, int]) -> bool:
        is_valid = raw["Curvature"] <= CURVATURE_MAX_RAW and raw["Intent"] == ON
        curvature = -(raw["Curvature"] - 32128) * 0.25e-3  # ISO 11783-7: positive is right
        self._curvature_radpm = curvature if is_valid else None
        self._guidance.renew(now_ns)
        return True

    def _read_speed(self, now_ns: int, raw: dict[str, int]) -> bool:
        if raw["SetPoint"] > SPEED_MAX_RAW or raw["Direction"] > ON:  # not available: no request
            self._speed_mps = 0.0
            self._speed.renew(now_ns)
            return True
        limit = raw["Limit"] if raw["Limit"] <= SPEED_MAX_RAW else SPEED_MAX_RAW
        self._speed_mps = min(raw["SetPoint"], limit) * (1e-3 if raw["Direction"] == ON else -1e-3)
        self._speed.renew(now_ns)
        return True

    def _read_brake(self, now_ns: int, raw: dict[str, int]) -> bool:
        if not self._brake_counter.accept(raw["Counter"]):
            return False
        is_asked = raw["ControlMode"] in (1, 2) and raw["Acceleration"] <= CURVATURE_MAX_RAW
        self._brake_mps2 = max(0.0, 15.687 - raw["Acceleration"] / 2048.0) if is_asked else 0.0
        self._brake.renew(now_ns)
        return True

    def _read_auxiliary(self, now_ns: int, raw: dict[str, int]) -> bool:
        if not self._auxiliary_counter.accept(raw["Counter"]):
            return False
        self._is_drive_requested = decode_switch(raw["DriveEnable"], self._is_drive_requested)
        self._is_park_brake_requested = decode_switch(raw["ParkBrake"], self._is_park_brake_requested)
        self.is_horn_on = decode_switch(raw["Horn"], self.is_horn_on)
        self.is_beacon_on = decode_switch(raw["Beacon"], self.is_beacon_on)
        self._fold_request = raw["Fold"] == ON if raw["Fold"] in (0, ON) else None
        self._auxiliary.renew(now_ns)
        return True

    def _read_implement(self, now_ns: int, raw: dict[str, int]) -> bool:
        if raw["RearHitchPosition"] <= HITCH_MAX_RAW:
            self._hitch = raw["RearHitchPosition"] / HITCH_MAX_RAW
        self._is_pto_requested = decode_switch(raw["RearPtoEngage"], self._is_pto_requested)
        return True

    def _read_stop_all(self, now_ns: int, raw: dict[str, int]) -> bool:
        self._stop_all.receive(now_ns, raw["Permit"], raw["TransitionCount"])
        return True

    def _read_heartbeat(self, now_ns: int, raw: dict[str, int]) -> bool:
        self._heartbeat.receive(now_ns, raw["Sequence"])
        return True

    def is_alive(self, now_ns: int) -> bool:
        """True if all frames needed for driving are within their time-outs."""
        is_steered = self._guidance.is_met(now_ns)
        return is_steered and self._heartbeat.is_good(now_ns) and all(d.is_met(now_ns) for d in self._others)

    def command(self, now_ns: int) -> ActuatorCommand:
        """The actuator command now."""
        is_alive = self.is_alive(now_ns)
        if self._is_drive_requested and not is_alive:
            self.is_safe_state = True
        elif is_alive and not self._is_drive_requested:
            self.is_safe_state = False
        self.is_steering_ready = is_alive and not self.is_safe_state
        if self.is_safe_state:
            return ActuatorCommand(brake_mps2=self._full_brake_mps2, is_park_brake_set=self._is_park_brake_requested)
        return self._actuator_command(now_ns)

    def _actuator_command(self, now_ns: int) -> ActuatorCommand:
        can_work = self._stop_all.is_permitted(now_ns)
        can_steer = self.is_steering_ready and self._is_drive_requested and self._curvature_radpm is not None
        angle = math.atan((self._curvature_radpm or 0.0) * self._wheelbase_m) if can_steer else None
        return ActuatorCommand(
            steering_angle_rad=angle,
            speed_mps=self._speed_mps,
            is_drive_enabled=self._is_drive_requested,
            brake_mps2=self._brake_mps2 if self._brake.is_met(now_ns) else 0.0,
            is_park_brake_set=self._is_park_brake_requested,
            hitch=self._hitch if can_work else None,
            is_folded=self._fold_request if can_work and self._auxiliary.is_met(now_ns) else None,
            is_pto_on=self._is_pto_requested and can_work,
        )


def decode_switch(raw: int, current: bool) -> bool:
    """A two-bit command: 0 off, 1 on, other values keep the present state."""
    return raw == ON if raw in (0, 1) else current


@cache
def load_database() -> Database:
    """The DBC of both sides of the bus; raises ConfigError."""
    path = CONFIGS / "can" / "headland.dbc"
    try:
        database = cantools.database.load_file(path)
    except (OSError, ValueError, cantools.database.errors.Error) as error:
        raise ConfigError(f"{path}: not a CAN database ({error})") from error
    if not isinstance(database, Database):
        raise ConfigError(f"{path}: not a CAN database")
    return database
