"""CAN transmitter: machine commands from phase and safe command, and their frames with individual periods."""

import math
from dataclasses import dataclass, replace

from configs.vehicle import Vehicle, steering_rate
from interfaces.engagement import Phase
from interfaces.isobus import brake, cab, guidance, heartbeat, implement, speed, stop_all
from interfaces.isobus.checksum import protect
from interfaces.isobus.frame import BROADCAST, Frame, encode_identifier
from interfaces.isobus.values import NOT_AVAILABLE
from messages.command import Mode, SafeCommand

CONTROL_PERIOD_NS = 100_000_000
BRAKE_PERIOD_NS = 20_000_000
STOP_ALL_PERIOD_NS = 1_000_000_000
_STOPS_IMPLEMENTS = (Mode.EMERGENCY_STOP, Mode.FAULT_STOP)
_PRIORITY = 3


@dataclass(frozen=True)
class ActualValues:
    """Actual values of the machine; NaN where not received."""

    curvature_radpm: float
    speed_mps: float
    hitch: float


@dataclass(frozen=True)
class Commands:
    """Content of the frames; None leaves a value to the machine or its driver.

    `curvature_radpm` is the set point or, without `is_steering`, only reported; with `is_accepted` it is rate-limited.
    `is_error` reports an error in the heartbeat: the machine enters its safe state whatever else is on the bus.
    """

    is_steering: bool | None = None
    is_accepted: bool = False
    curvature_radpm: float = math.nan
    speed_mps: float | None = None
    deceleration_mps2: float = 0.0
    hitch: float | None = None
    pto_rpm: float | None = None
    is_pto_on: bool | None = None
    is_implement_permitted: bool | None = None
    is_drive_enabled: bool | None = None
    is_park_brake_set: bool | None = None
    is_horn_on: bool | None = None
    is_beacon_on: bool | None = None
    is_folded: bool | None = None
    is_error: bool = False


def commands_for(
    phase: Phase, command: SafeCommand | None, actual: ActualValues, full_mps2: float, pto_rpm: float
) -> Commands:
    """Commands of a phase; `full_mps2` is the brake demand without a safe command."""
    if phase is Phase.RELEASED:
        return Commands(is_drive_enabled=False)  # disables the drive request only, not the driver's pedal
    if command is None or phase is Phase.SILENT:
        return Commands(
            is_steering=False, curvature_radpm=actual.curvature_radpm, speed_mps=0.0, deceleration_mps2=full_mps2,
            is_pto_on=False, is_implement_permitted=False, is_drive_enabled=False,
        )  # fmt: skip
    is_active, is_offered = phase is Phase.ACTIVE, phase is Phase.OFFERING
    return Commands(
        is_steering=is_active or is_offered,
        is_accepted=is_active,
        curvature_radpm=command.curvature_radpm if is_active else actual.curvature_radpm,
        speed_mps=_speed(phase, command.speed_mps, actual.speed_mps),
        deceleration_mps2=command.deceleration_mps2,
        hitch=_hitch(phase, command.is_implement_lowered, actual.hitch),
        pto_rpm=pto_rpm if is_active and command.is_pto_on else None,
        is_pto_on=None if command.is_pto_on and not is_active else command.is_pto_on,
        is_implement_permitted=phase is not Phase.LOST and command.mode not in _STOPS_IMPLEMENTS,
        is_drive_enabled=is_active or is_offered,
        is_park_brake_set=command.is_park_brake_set,
        is_horn_on=command.is_horn_on,
        is_beacon_on=command.is_beacon_on,
        is_folded=command.is_implement_folded if is_active and command.mode is Mode.AUTOMATIC else None,
    )


def contested_commands(stop: Commands) -> Commands:
    """Commands while another sender is on the bus; the drive request is not withdrawn, as the safe state ends then."""
    return replace(stop, is_drive_enabled=None, is_error=True)


def limit_curvature_rate(
    last_radpm: float, target_radpm: float, step_s: float, steering_radps: float, wheelbase_m: float
) -> float:
    """Curvature after a step towards the target at the steering rate `steering_radps`: κ = tan δ / L."""
    rate = steering_radps * (1.0 + (wheelbase_m * last_radpm) ** 2) / wheelbase_m
    return last_radpm + max(-rate * step_s, min(rate * step_s, target_radpm - last_radpm))


def _speed(phase: Phase, target_mps: float, actual_mps: float) -> float:
    if phase is Phase.ACTIVE:
        return target_mps
    if phase is not Phase.OFFERING or actual_mps * target_mps <= 0.0:
        return 0.0
    return math.copysign(min(abs(actual_mps), abs(target_mps)), target_mps)


def _hitch(phase: Phase, is_lowered: bool, actual: float) -> float | None:
    if phase is Phase.ACTIVE:
        return 0.0 if is_lowered else 1.0
    return actual if phase is Phase.OFFERING and math.isfinite(actual) else None


class _Channel:
    """One outgoing message: sent each period, and at once when its content changes."""

    def __init__(self, group: int, destination: int, period_ns: int, is_protected: bool = False) -> None:
        self._group, self._destination, self._period_ns, self._is_protected = (
            group,
            destination,
            period_ns,
            is_protected,
        )
        self._sent_ns: int | None = None
        self._body = b""
        self._counter = 0

    def is_due(self, now_ns: int, body: bytes, min_interval_ns: int) -> bool:
        """Whether the period has elapsed, or the content changed and `min_interval_ns` has elapsed."""
        if self._sent_ns is None:
            return True
        age_ns = now_ns - self._sent_ns
        return age_ns >= self._period_ns or (body != self._body and age_ns >= min_interval_ns)

    def frame(self, now_ns: int, own_address: int, body: bytes) -> Frame:
        """Frame to send now."""
        self._sent_ns, self._body = now_ns, body
        identifier = encode_identifier(_PRIORITY, self._group, own_address, self._destination)
        if not self._is_protected:
            return Frame(identifier, body)
        self._counter += 1
        return Frame(identifier, protect(identifier, body, self._counter))


class CanTransmitter:
    """Period, counter and last content of each message; brakes and steering are sent first."""

    def __init__(self, vehicle: Vehicle, tractor_address: int, min_interval_ns: int) -> None:
        self._wheelbase_m, self._steering_radps = vehicle.drivetrain.wheelbase_m, steering_rate(vehicle)
        self._channels = (
            _Channel(brake.GROUP, tractor_address, BRAKE_PERIOD_NS, is_protected=True),
            _Channel(guidance.COMMAND_GROUP, tractor_address, CONTROL_PERIOD_NS),
            _Channel(cab.GROUP, tractor_address, CONTROL_PERIOD_NS, is_protected=True),
            _Channel(speed.COMMAND_GROUP, BROADCAST, CONTROL_PERIOD_NS),
            _Channel(implement.COMMAND_GROUP, BROADCAST, CONTROL_PERIOD_NS),
            _Channel(stop_all.GROUP, BROADCAST, STOP_ALL_PERIOD_NS),
        )
        self._waits_ns = (0, min_interval_ns, 0, min_interval_ns, 0, 0)  # guidance and speed change continuously
        self._heartbeat = _Channel(heartbeat.GROUP, BROADCAST, CONTROL_PERIOD_NS)
        self._beat, self._stop = heartbeat.Heartbeat(), stop_all.StopAll()
        self._commands, self._bodies = Commands(), self._encode(Commands())
        self._curvature_radpm, self._stepped_ns = 0.0, 0

    def step(self, now_ns: int, own_address: int, commands: Commands, is_urgent: bool) -> list[Frame]:
        """Frames that are due; with `is_urgent` (phase changed) without minimum interval; an error at each step."""
        if commands != self._commands:
            self._commands, self._bodies = commands, self._encode(commands)
        self._bodies[1] = self._steer(now_ns, commands)
        frames = []
        for channel, body, wait_ns in zip(self._channels, self._bodies, self._waits_ns, strict=True):
            if channel.is_due(now_ns, body, 0 if is_urgent else wait_ns):
                frames.append(channel.frame(now_ns, own_address, body))
        if commands.is_error:
            frames.insert(0, self._heartbeat.frame(now_ns, own_address, self._beat.encode_error()))
        elif self._heartbeat.is_due(now_ns, b"", CONTROL_PERIOD_NS):
            frames.append(self._heartbeat.frame(now_ns, own_address, self._beat.encode()))
        return frames

    def _encode(self, commands: Commands) -> list[bytes]:
        return [
            brake.encode_request(commands.deceleration_mps2),
            NOT_AVAILABLE,  # steering: see _steer
            cab.encode_auxiliary(
                commands.is_drive_enabled,
                commands.is_park_brake_set,
                commands.is_horn_on,
                commands.is_beacon_on,
                commands.is_folded,
            ),
            NOT_AVAILABLE if commands.speed_mps is None else speed.encode_command(commands.speed_mps),
            implement.encode_commands(commands.hitch, commands.pto_rpm, commands.is_pto_on),
            self._stop.encode(commands.is_implement_permitted),
        ]

    def _steer(self, now_ns: int, commands: Commands) -> bytes:
        step_s, self._stepped_ns = (now_ns - self._stepped_ns) * 1e-9, now_ns
        if commands.is_steering is None:
            return NOT_AVAILABLE
        if not math.isfinite(commands.curvature_radpm):
            return guidance.encode_idle()
        self._curvature_radpm = (
            self._rate_limited(commands, step_s) if commands.is_accepted else commands.curvature_radpm
        )
        return guidance.encode_command(self._curvature_radpm, commands.is_steering)

    def _rate_limited(self, commands: Commands, step_s: float) -> float:
        last, target = self._curvature_radpm, commands.curvature_radpm
        return limit_curvature_rate(last, target, step_s, self._steering_radps, self._wheelbase_m)
