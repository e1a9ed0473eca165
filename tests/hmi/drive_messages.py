"""Scene of the demo, and messages of a drive with chosen values."""

from typing import Any

import numpy as np

from configs.mission import Mission
from configs.site import Site
from configs.strict import CONFIGS, load
from configs.vehicle import ImplementFile, Vehicle
from geometry.transforms import planar
from hmi.page_state import PageState
from hmi.scene import Scene
from messages.command import MachineState, Mode, OrderStatus, RuleResult, SupervisorState
from messages.faults import Fault, Response, Severity
from messages.message import Envelope, Message
from messages.motion import MapPose, Odometry, PositionSource
from messages.node import Inbox
from messages.perception import ObstacleClass
from messages.plan import MissionState, MissionStatus, PathSectionType

SECOND_NS = 1_000_000_000
NOW_NS = 50 * SECOND_NS


class EmptyInbox(Inbox):
    """Inbox without messages."""

    def latest(self, topic: str, kind: Any) -> None:
        """Nothing."""

    def last(self, topic: str, kind: Any) -> None:
        """Nothing."""

    def all(self, topic: str, kind: Any) -> tuple[Any, ...]:
        """Nothing."""
        return ()

    def at(self, topic: str, kind: Any, stamp_ns: int) -> None:
        """Nothing."""


def demo_scene() -> Scene:
    """Scene of the mission `yard`: field of 80 m x 50 m, harrow of 6 m."""
    mission = load(Mission, CONFIGS / "missions/yard.yaml")
    vehicle = load(Vehicle, CONFIGS / f"machines/{mission.machine}.yaml")
    implement = load(ImplementFile, CONFIGS / f"implements/{mission.implement}.yaml").implement
    return Scene(load(Site, CONFIGS / "sites/demo.yaml"), vehicle, implement)


def supervisor(mode: Mode, reason: str = "", stamp_ns: int = NOW_NS, **values: Any) -> SupervisorState:
    """State of the supervisor."""
    more = {
        "rules": (), "obstacle_class": ObstacleClass.UNKNOWN, "clearance_m": np.inf, "stopping_distance_m": 0.0,
        "required_range_m": 0.0, "detection_range_m": 40.0, "resume_in_s": 0.0,
        "triggering_points_base_m": np.empty((0, 3), np.float32), "protective_field_base_m": np.empty((0, 2)),
    } | values  # fmt: skip
    return SupervisorState(stamp_ns, mode, reason, **more)


def fault(is_active: bool, severity: Severity = Severity.ALARM, code: str = "brake.weak") -> Fault:
    return Fault(
        NOW_NS, code, "supervisor", severity, True, Response.CONTROLLED_STOP, is_active, "brake weak", "制动弱"
    )


def rule(code: str, text: str) -> RuleResult:
    """Result of a rule that stops."""
    return RuleResult(code, Response.CONTROLLED_STOP, 0.0, text)


def status(stamp_ns: int = NOW_NS) -> OrderStatus:
    """Status of the order gate."""
    return OrderStatus(stamp_ns, "tractor-1", "session", 0, ())


def odometry(x_m: float, y_m: float, yaw_rad: float = 0.0, speed_mps: float = 0.0, stamp_ns: int = NOW_NS) -> Odometry:
    """Motion at a pose in `odom`."""
    return Odometry(stamp_ns, planar(x_m, y_m, yaw_rad), speed_mps, 0.0, 0.0, 0.0, 0.0, np.eye(6))


def map_pose(x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0, stamp_ns: int = NOW_NS) -> MapPose:
    """Pose of `odom` in `map`."""
    T = planar(x_m, y_m, yaw_rad)
    return MapPose(stamp_ns, T, T, np.eye(6), PositionSource.RTK_FIXED, 0.2, 0.1, True)


def machine(stamp_ns: int = NOW_NS, **values: Any) -> MachineState:
    """State of the machine, standing."""
    stamps = {f"{name}_stamp_ns": stamp_ns for name in ("motion", "steering", "implement", "cab", "heartbeat")}
    more = {
        "speed_mps": 0.0, "curvature_radpm": 0.0, "is_steering_ready": True, "steering_exit_code": 0,
        "steering_limit": 0, "hitch": 1.0, "is_hitch_in_work": False, "pto_radps": 0.0, "is_pto_engaged": False,
        "is_park_brake_set": True, "is_horn_on": False, "is_beacon_on": False, "brake_pedal": 0.0,
        "driver_torque_nm": 0.0, "driver_rate_radps": 0.0, "driver_angle_rad": 0.0, "is_seat_occupied": False,
        "is_emergency_button_pressed": False, "supply_v": 13.8, "rejected_frames": 0,
    } | stamps | values  # fmt: skip
    return MachineState(stamp_ns, **more)


def mission(
    state: MissionState, driven_m: float = 0.0, total_m: float = 100.0, stamp_ns: int = NOW_NS
) -> MissionStatus:
    """State of the mission on its first row."""
    return MissionStatus(stamp_ns, state, PathSectionType.SWATH, 0, 1, 0.0, driven_m, total_m, "", ())


def state_of(*messages: tuple[str, Message], now_ns: int = NOW_NS) -> PageState:
    """Page state after messages by topic."""
    state = PageState(demo_scene(), 0.25)
    state.take(now_ns, [Envelope(topic, 0, now_ns, message) for topic, message in messages])
    return state
