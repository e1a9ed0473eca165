"""Control command, safe command, supervisor state, operator commands, machine state and CAN frames."""

from dataclasses import dataclass
from enum import IntEnum, StrEnum

from geometry.arrays import Float32, Float64
from messages.faults import Response
from messages.message import Message, MessagePart
from messages.perception import ObstacleClass


@dataclass(frozen=True)
class ControlCommand(Message):
    """Command of control, input of the supervisor.

    `speed_mps` is signed (reverse negative), `acceleration_mps2` its requested change (≤ 0 brakes), `curvature_radpm`
    left positive; `path_s_m` is the arc length on path `path_id`; errors are left positive, at `base`.
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
    """Operating mode of the machine."""

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
    """Command to the machine; only the supervisor builds it.

    `speed_mps` is signed; `deceleration_mps2` ≥ 0 is the braking demand (0 = none); `reason` is the code of the
    limiting rule ("" = control command unchanged). `is_drive_enabled` false: no steering, no propulsion, brakes
    applied.
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
    """Result of one rule: `speed_limit_mps` (infinite = no objection) and response."""

    code: str
    response: Response
    speed_limit_mps: float
    text: str


@dataclass(frozen=True)
class SupervisorState(Message):
    """State of the supervisor, with the reason of the safe command.

    `clearance_m` is the distance to the nearest obstacle in the protective field (infinite if none),
    `stopping_distance_m` is S, `required_range_m` the range required at the present speed, `detection_range_m` the
    range up to which the field is known to be free; `triggering_points_base_m` (N, 3) are the points of the obstacle,
    `protective_field_base_m` (M, 2) is the outline of the field.
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
    """Commands of an operator; `CONFIRM_CLEAR`: nobody is near the machine where its sensors have not looked.

    `NUDGE` shifts the driven line sideways (row joining).
    """

    START = 0
    PAUSE = 1
    RESUME = 2
    EMERGENCY_STOP = 3
    RESET = 4
    MANUAL = 5
    AUTOMATIC = 6
    CONFIRM_CLEAR = 7
    NUDGE = 8


@dataclass(frozen=True)
class SignedOrder(Message):
    """Order of an operator as it was sent: `payload` in JSON, its Ed25519 `signature`, and the sender's `public_key`.

    docs/orders.md has the contents of the payload. Nothing in it counts before `interfaces/orders` has verified it.
    """

    public_key: bytes
    signature: bytes
    payload: bytes


@dataclass(frozen=True)
class OperatorCommand(Message):
    """Verified order of an operator; invalid after `expires_ns` or when `sequence` does not increase.

    `left_m`: step of a nudge, to the left of the machine; 0 for other commands.
    """

    kind: OperatorCommandKind
    authority: str
    sequence: int
    expires_ns: int
    left_m: float = 0.0


@dataclass(frozen=True)
class RefusedOrders(MessagePart):
    """Number of orders refused since the start for one reason, such as "forged"."""

    reason: str
    count: int


@dataclass(frozen=True)
class OrderStatus(Message):
    """What an order must be signed for (`machine`, nonce `session` of this start), and how many came since then.

    `is_forbidden`: a person has forbidden automatic operation, no start is accepted. `checked`: number of the last
    order that was verified as a self-test only (-1: none).
    """

    machine: str
    session: str
    accepted: int
    refused: tuple[RefusedOrders, ...]
    is_forbidden: bool = False
    checked: int = -1


@dataclass(frozen=True)
class MachineState(Message):
    """State of the machine from its CAN bus, newest values of all frames.

    Each group has the time of its last valid frame (0 = never): `motion_stamp_ns` (wheel-based speed),
    `steering_stamp_ns` (estimated curvature), `implement_stamp_ns` (hitch, PTO, fold), `cab_stamp_ns` (steering wheel,
    pedals, seat, supply), `heartbeat_stamp_ns`. `hitch` is 0 (lowest) to 1 (highest), `fold_position` 0 (working width)
    to 1 (transport width). `rejected_frames` counts invalid frames.
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
    """One extended CAN frame; `stamp_ns` is the time of sending or reception."""

    stamp_ns: int
    identifier: int
    data: bytes


@dataclass(frozen=True)
class CanFrames(Message):
    """All frames on one channel since the previous message."""

    channel: str
    frames: tuple[CanFrame, ...]
