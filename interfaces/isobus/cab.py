"""Cab messages without a standard (proprietary A, PGN 61184), defined in `configs/can/headland.dbc`."""

from dataclasses import dataclass

from interfaces.isobus.values import BadFrame, Scale, decode_flag

GROUP = 0xEF00
AUXILIARY = 16
DRIVER_STEERING = 1
CAB = 2
FOLD = 3
LEAVE = 3

_TORQUE_NM = Scale(0.01, -320.0, 2)
_ANGLE_RAD = Scale(0.001, -32.0, 2)
_RATE_RADPS = Scale(0.001, -32.0, 2)
_PEDAL = Scale(0.004, 0.0, 1)
_POSITION = Scale(0.004, 0.0, 1)
_SUPPLY_V = Scale(0.05, 0.0, 2)


@dataclass(frozen=True)
class DriverSteering:
    """Steering wheel torque, angle and rate of the driver, left positive."""

    torque_nm: float
    angle_rad: float
    rate_radps: float


@dataclass(frozen=True)
class CabState:
    """Pedals 0 to 1, supply, seat, emergency button, park brake, horn and beacon."""

    brake_pedal: float
    clutch_pedal: float
    supply_v: float
    is_seat_occupied: bool
    is_emergency_button_pressed: bool
    is_park_brake_set: bool
    is_horn_on: bool
    is_beacon_on: bool


@dataclass(frozen=True)
class FoldState:
    """Fold position of the implement: 0 working width to 1 transport width."""

    position: float


def encode_auxiliary(
    is_drive_enabled: bool | None, is_park_brake_set: bool | None, is_horn_on: bool | None, is_beacon_on: bool | None,
    is_folded: bool | None,
) -> bytes:  # fmt: skip
    """Bytes 1–7 of the auxiliary command; None leaves as is."""
    states = (is_drive_enabled, is_park_brake_set, is_horn_on, is_beacon_on)
    packed = sum(_two_bits(state) << 2 * k for k, state in enumerate(states))
    return bytes([AUXILIARY, packed, 0xFC | _two_bits(is_folded)]) + b"\xff" * 4


def _two_bits(state: bool | None) -> int:
    return LEAVE if state is None else int(state)


def decode_cab_state(data: bytes) -> DriverSteering | CabState | FoldState:
    """One of the three groups of a frame with checked protection; raises BadFrame."""
    if data[0] == DRIVER_STEERING:
        return DriverSteering(_TORQUE_NM.decode(data, 2), _ANGLE_RAD.decode(data, 4), _RATE_RADPS.decode(data, 6))
    if data[0] == CAB:
        return _decode_cab(data)
    if data[0] == FOLD:
        return FoldState(_POSITION.decode(data, 2))
    raise BadFrame(f"group {data[0]} is not known")


def _decode_cab(data: bytes) -> CabState:
    pedals = _PEDAL.decode(data, 2), _PEDAL.decode(data, 3)
    seat, button, park, horn = (decode_flag(data, 6, bit) for bit in (1, 3, 5, 7))
    return CabState(*pedals, _SUPPLY_V.decode(data, 4), seat, button, park, horn, decode_flag(data, 7, 1))
