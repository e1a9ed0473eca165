"""From wish to wire: what control wants, what the supervisor permits, and what the machine answers."""

from dataclasses import dataclass
from enum import IntEnum, StrEnum

from geometry.arrays import Float32, Float64
from messages.faults import Response
from messages.message import Message, MessagePart
from messages.perception import ObstacleClass


@dataclass(frozen=True)
class ControlCommand(Message):
    """What control would do: nothing of it reaches the machine unless the supervisor lets it.

    `speed_mps` is signed (reverse negative), `acceleration_mps2` its wanted change (≤ 0 brakes), `curvature_radpm` left
    positive; `path_s_m` the place on path `path_id`; errors are left positive, at `base`.
    """

    speed_mps: float
    acceleration_mps2: float
    curvature_radpm: float
    is_implement_lowered: bool
    is_pto_on: bool
    path_id: int
    path_s_m: float
    xte_m: float
    heading_error_rad: float
    is_finished: bool
    is_implement_folded: bool = False


class Mode(StrEnum):
    """Who drives, and what the supervisor is doing about it."""

    MANUAL = "manual"
    STANDBY = "standby"
    START_WARNING = "start_warning"
    AUTOMATIC = "automatic"
    OBSTACLE_STOP = "obstacle_stop"
    FAULT_STOP = "fault_stop"
    EMERGENCY_STOP = "emergency_stop"
    FINISHED = "finished"


@dataclass(frozen=True)
class SafeCommand(Message):
    """What the machine is to do; built by the supervisor alone.

    `speed_mps` signed, `deceleration_mps2` ≥ 0 is asked of the brakes (0 = none); `reason` is the code of the rule that
    bound the command ("" = the wish passed whole). `is_drive_enabled` false means: no steering, no propulsion, brake.
    """

    mode: Mode
    is_drive_enabled: bool
    speed_mps: float
    deceleration_mps2: float
    curvature_radpm: float
    is_implement_lowered: bool
    is_pto_on: bool
    is_park_brake_set: bool
    is_horn_on: bool
    is_beacon_on: bool
    reason: str
    is_implement_folded: bool = False


@dataclass(frozen=True)
class RuleResult(MessagePart):
    """What one rule says at this moment: `speed_limit_mps` (infinite = no objection) and what to do about it."""

    code: str
    response: Response
    speed_limit_mps: float
    text: str


@dataclass(frozen=True)
class SupervisorState(Message):
    """Why the safe command is what it is.

    `clearance_m` is the free way to the nearest cause in the swept field (infinite if none), `stopping_distance_m` =
    S alone, `required_range_m` the full range needed at the present speed, `detection_range_m` how far the field is
    proven free; `triggering_points_base_m` (N, 3) are the points that caused it, `protective_field_base_m` (M, 2) the
    outline of the swept field.
    """

    mode: Mode
    reason: str
    rules: tuple[RuleResult, ...]
    obstacle_class: ObstacleClass
    clearance_m: float
    stopping_distance_m: float
    required_range_m: float
    detection_range_m: float
    resume_in_s: float
    triggering_points_base_m: Float32
    protective_field_base_m: Float64


class OperatorCommandKind(IntEnum):
    """What a person may ask of the machine."""

    START = 0
    PAUSE = 1
    RESUME = 2
    EMERGENCY_STOP = 3
    RESET = 4
    MANUAL = 5
    AUTOMATIC = 6


@dataclass(frozen=True)
class OperatorCommand(Message):
    """An order of a person, on the machine or remote; void after `expires_ns` or when `sequence` does not rise."""

    kind: OperatorCommandKind
    authority: str
    sequence: int
    expires_ns: int


@dataclass(frozen=True)
class MachineState(Message):
    """What the machine says of itself on its bus, newest values of all frames.

    Each group has the time of its last good frame (0 = never): `motion_stamp_ns` (wheel-based speed),
    `steering_stamp_ns` (estimated curvature), `implement_stamp_ns` (hitch and PTO), `cab_stamp_ns` (hand wheel, pedals,
    seat, supply), `heartbeat_stamp_ns`. `hitch` is 0 lowest to 1 highest, `fold_position` 0 at working to 1 at
    transport width (of the implement's group). `rejected_frames` counts bad frames.
    """

    motion_stamp_ns: int
    steering_stamp_ns: int
    implement_stamp_ns: int
    cab_stamp_ns: int
    heartbeat_stamp_ns: int
    speed_mps: float
    curvature_radpm: float
    is_steering_ready: bool
    steering_exit_code: int
    steering_limit: int
    hitch: float
    is_hitch_in_work: bool
    pto_radps: float
    is_pto_engaged: bool
    is_park_brake_set: bool
    is_horn_on: bool
    is_beacon_on: bool
    brake_pedal: float
    driver_torque_nm: float
    driver_rate_radps: float
    driver_angle_rad: float
    is_seat_occupied: bool
    is_emergency_button_pressed: bool
    supply_v: float
    rejected_frames: int
    fold_position: float = 0.0


@dataclass(frozen=True)
class CanFrame(MessagePart):
    """One extended frame; `stamp_ns` is when it was sent or received."""

    stamp_ns: int
    identifier: int
    data: bytes


@dataclass(frozen=True)
class CanFrames(Message):
    """All frames that crossed one channel since the last message."""

    channel: str
    frames: tuple[CanFrame, ...]
