"""What the machine is told: from phase and safe command to orders, and from orders to frames at their own periods."""

import math
from dataclasses import dataclass

from configs.vehicle import Vehicle, steering_rate
from interfaces.engagement import Phase
from interfaces.isobus import brake, cab, guidance, heartbeat, implement, speed, stop_all
from interfaces.isobus.checksum import seal
from interfaces.isobus.frame import BROADCAST, Frame, encode_identifier
from interfaces.isobus.values import NOT_AVAILABLE
from messages.command import Mode, SafeCommand

CONTROL_PERIOD_NS = 100_000_000
BRAKE_PERIOD_NS = 20_000_000
STOP_ALL_PERIOD_NS = 1_000_000_000
_STOPS_IMPLEMENTS = (Mode.EMERGENCY_STOP, Mode.FAULT_STOP)
_PRIORITY = 3


@dataclass(frozen=True)
class Present:
    """The values that the machine has now; NaN where it has not told."""

    curvature_radpm: float
    speed_mps: float
    hitch: float


@dataclass(frozen=True)
class Orders:
    """What the frames are to say; None leaves the matter to the machine or its driver.

    `curvature_radpm` is ours to hold or, when not `is_steering`, only told; once `is_accepted` it is slewed.
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


def order(phase: Phase, command: SafeCommand | None, present: Present, full_mps2: float, pto_rpm: float) -> Orders:
    """What to say in this phase; `full_mps2` is asked of the brakes when nobody is there to ask for less."""
    if phase is Phase.RELEASED:
        return Orders(is_drive_enabled=False)  # our drive request; the driver's pedal is not ours to disable
    if command is None or phase is Phase.SILENT:
        return Orders(
            is_steering=False, curvature_radpm=present.curvature_radpm, speed_mps=0.0, deceleration_mps2=full_mps2,
            is_pto_on=False, is_implement_permitted=False, is_drive_enabled=False,
        )  # fmt: skip
    is_active, is_offered = phase is Phase.ACTIVE, phase is Phase.OFFERING
    return Orders(
        is_steering=is_active or is_offered,
        is_accepted=is_active,
        curvature_radpm=command.curvature_radpm if is_active else present.curvature_radpm,
        speed_mps=_speed(phase, command.speed_mps, present.speed_mps),
        deceleration_mps2=command.deceleration_mps2,
        hitch=_hitch(phase, command.is_implement_lowered, present.hitch),
        pto_rpm=pto_rpm if is_active and command.is_pto_on else None,
        is_pto_on=None if command.is_pto_on and not is_active else command.is_pto_on,
        is_implement_permitted=phase is not Phase.LOST and command.mode not in _STOPS_IMPLEMENTS,
        is_drive_enabled=is_active or is_offered,
        is_park_brake_set=command.is_park_brake_set,
        is_horn_on=command.is_horn_on,
        is_beacon_on=command.is_beacon_on,
        is_folded=command.is_implement_folded if is_active else None,
    )


def slew_curvature(
    last_radpm: float, wanted_radpm: float, step_s: float, steering_radps: float, wheelbase_m: float
) -> float:
    """The curvature nearest to the wanted one that wheels turning at `steering_radps` reach: κ = tan δ / L."""
    rate = steering_radps * (1.0 + (wheelbase_m * last_radpm) ** 2) / wheelbase_m
    return last_radpm + max(-rate * step_s, min(rate * step_s, wanted_radpm - last_radpm))


def _speed(phase: Phase, wanted_mps: float, present_mps: float) -> float:
    if phase is Phase.ACTIVE:
        return wanted_mps
    if phase is not Phase.OFFERING or present_mps * wanted_mps <= 0.0:
        return 0.0
    return math.copysign(min(abs(present_mps), abs(wanted_mps)), wanted_mps)


def _hitch(phase: Phase, is_lowered: bool, present: float) -> float | None:
    if phase is Phase.ACTIVE:
        return 0.0 if is_lowered else 1.0
    return present if phase is Phase.OFFERING and math.isfinite(present) else None


class _Channel:
    """One message on its way out: sent each period, and at once when its content changes."""

    def __init__(self, group: int, destination: int, period_ns: int, is_sealed: bool = False) -> None:
        self._group, self._destination, self._period_ns, self._is_sealed = group, destination, period_ns, is_sealed
        self._sent_ns: int | None = None
        self._body = b""
        self._counter = 0

    def is_due(self, now_ns: int, body: bytes, fastest_ns: int) -> bool:
        """Whether the period is over, or the content is another and the last frame not too young."""
        if self._sent_ns is None:
            return True
        age_ns = now_ns - self._sent_ns
        return age_ns >= self._period_ns or (body != self._body and age_ns >= fastest_ns)

    def frame(self, now_ns: int, own_address: int, body: bytes) -> Frame:
        """The frame to send now."""
        self._sent_ns, self._body = now_ns, body
        identifier = encode_identifier(_PRIORITY, self._group, own_address, self._destination)
        if not self._is_sealed:
            return Frame(identifier, body)
        self._counter += 1
        return Frame(identifier, seal(identifier, body, self._counter))


class Outgoing:
    """Keeps each message's period, counter and last content; brakes and steering go first."""

    def __init__(self, vehicle: Vehicle, tractor_address: int, fastest_ns: int) -> None:
        self._wheelbase_m, self._steering_radps = vehicle.drivetrain.wheelbase_m, steering_rate(vehicle)
        self._channels = (
            _Channel(brake.GROUP, tractor_address, BRAKE_PERIOD_NS, is_sealed=True),
            _Channel(guidance.COMMAND_GROUP, tractor_address, CONTROL_PERIOD_NS),
            _Channel(cab.GROUP, tractor_address, CONTROL_PERIOD_NS, is_sealed=True),
            _Channel(speed.COMMAND_GROUP, BROADCAST, CONTROL_PERIOD_NS),
            _Channel(implement.COMMAND_GROUP, BROADCAST, CONTROL_PERIOD_NS),
            _Channel(stop_all.GROUP, BROADCAST, STOP_ALL_PERIOD_NS),
        )
        self._waits_ns = (0, fastest_ns, 0, fastest_ns, 0, 0)  # content of guidance and speed changes all the time
        self._heartbeat = _Channel(heartbeat.GROUP, BROADCAST, CONTROL_PERIOD_NS)
        self._beat, self._stop = heartbeat.Heartbeat(), stop_all.StopAll()
        self._orders, self._bodies = Orders(), self._encode(Orders())
        self._curvature_radpm, self._stepped_ns = 0.0, 0

    def step(self, now_ns: int, own_address: int, orders: Orders, is_urgent: bool) -> list[Frame]:
        """The frames that are due; when `is_urgent` (the phase changed) nothing waits."""
        if orders != self._orders:
            self._orders, self._bodies = orders, self._encode(orders)
        self._bodies[1] = self._steer(now_ns, orders)
        frames = []
        for channel, body, wait_ns in zip(self._channels, self._bodies, self._waits_ns, strict=True):
            if channel.is_due(now_ns, body, 0 if is_urgent else wait_ns):
                frames.append(channel.frame(now_ns, own_address, body))
        if self._heartbeat.is_due(now_ns, b"", CONTROL_PERIOD_NS):
            frames.append(self._heartbeat.frame(now_ns, own_address, self._beat.encode()))
        return frames

    def _encode(self, orders: Orders) -> list[bytes]:
        return [
            brake.encode_request(orders.deceleration_mps2),
            NOT_AVAILABLE,  # steering has its own time
            cab.encode_auxiliary(
                orders.is_drive_enabled,
                orders.is_park_brake_set,
                orders.is_horn_on,
                orders.is_beacon_on,
                orders.is_folded,
            ),
            NOT_AVAILABLE if orders.speed_mps is None else speed.encode_command(orders.speed_mps),
            implement.encode_commands(orders.hitch, orders.pto_rpm, orders.is_pto_on),
            self._stop.encode(orders.is_implement_permitted),
        ]

    def _steer(self, now_ns: int, orders: Orders) -> bytes:
        step_s, self._stepped_ns = (now_ns - self._stepped_ns) * 1e-9, now_ns
        if orders.is_steering is None:
            return NOT_AVAILABLE
        if not math.isfinite(orders.curvature_radpm):
            return guidance.encode_idle()
        self._curvature_radpm = self._slewed(orders, step_s) if orders.is_accepted else orders.curvature_radpm
        return guidance.encode_command(self._curvature_radpm, orders.is_steering)

    def _slewed(self, orders: Orders, step_s: float) -> float:
        last, wanted = self._curvature_radpm, orders.curvature_radpm
        return slew_curvature(last, wanted, step_s, self._steering_radps, self._wheelbase_m)
