"""Closed loop of synthetic messages around the supervisor: level ground scanned by configured lidars, with boxes."""

import functools
import math
from dataclasses import dataclass, field, replace
from pathlib import Path as File
from typing import Any

import numpy as np

from configs.strict import load
from configs.vehicle import Lidar, Mount, Radar, TrailedImplement, Ultrasonic, Vehicle
from geometry.transforms import planar, transform
from messages.command import ControlCommand, MachineState, OperatorCommand, OperatorCommandKind, OrderStatus
from messages.message import Message
from messages.motion import MapPose, Odometry, PositionSource
from messages.perception import HealthState, Obstacles, SensorHealth, Tracks
from messages.plan import MissionState, MissionStatus, Path, PathSection, PathSectionType
from messages.sensors import ImuSample, LidarScan, RadarScan, UltrasonicRange, WheelSample
from messages.topics import spec_of
from safety.collision_monitor import MonitorInputs
from safety.monitors.brake_test import Phase
from safety.monitors.vehicle import VehicleState
from safety.obstacle_sources import SourceData
from safety.rules.situation import Situation
from safety.supervisor import Supervisor
from safety.supervisor_config import SupervisorConfig
from safety.zones.protective_field import Clearance
from safety.zones.standing_bodies import NO_STANDING_BODY
from safety.zones.tracked_obstacles import NO_CRITICAL_OBJECT

ROOT = File(__file__).parents[2]
START_NS = 5_000_000_000
STEP_NS = 20_000_000
NO_BYTES = np.empty(0, np.uint8)
WAGON = TrailedImplement(
    kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
    hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
)  # fmt: skip


def tractor(*lidars: str) -> Vehicle:
    """The shipped machine with its motion sensors and the named lidars only."""
    machine = load(Vehicle, ROOT / "configs/machines/tractor_e.yaml")
    only: dict[str, Any] = {"radar": {}, "camera": {}, "ultrasonic": {}, "uwb": {}}
    only["lidar"] = {name: machine.sensors.lidar[name] for name in lidars}
    return machine.model_copy(update={"sensors": machine.sensors.model_copy(update=only)})


class SyntheticInbox:
    """Semantics of messages.node.Inbox: stale by the topic table, `all` since the last step."""

    def __init__(self) -> None:
        self.now_ns = START_NS
        self.messages: dict[str, Message] = {}
        self.queues: dict[str, list[Message]] = {}

    def put(self, topic: str, message: Message) -> None:
        self.messages[topic] = message
        self.queues.setdefault(topic, []).append(message)

    def last(self, topic: str, kind: type) -> Any:
        return self.messages.get(topic)

    def latest(self, topic: str, kind: type) -> Any:
        message = self.messages.get(topic)
        limit = spec_of(topic).max_age_s
        if message is None or abs(self.now_ns - message.stamp_ns) > limit * 1e9:
            return None
        return message

    def all(self, topic: str, kind: type) -> Any:
        return tuple(self.queues.get(topic, ()))

    def at(self, topic: str, kind: type, stamp_ns: int) -> Any:
        raise AssertionError("the supervisor reads nothing at a time")


def put_box(points: np.ndarray, origin: np.ndarray, center: tuple[float, float], size: tuple[float, float, float]):
    """First intersections of the rays from `origin` to points (N, 3) with an upright box at `center`, (N, 3)."""
    low = np.array([center[0] - size[0] / 2, center[1] - size[1] / 2, 0.0])
    high = np.array([center[0] + size[0] / 2, center[1] + size[1] / 2, size[2]])
    distance = points - origin
    with np.errstate(divide="ignore", invalid="ignore"):
        t0, t1 = (low - origin) / distance, (high - origin) / distance
    enter, leave = np.minimum(t0, t1).max(axis=1), np.maximum(t0, t1).min(axis=1)
    hit = (enter <= leave) & (enter > 0.0) & (enter < 1.0)
    out = points.copy()
    out[hit] = origin + distance[hit] * enter[hit, None]
    return out


@dataclass(frozen=True)
class Box:
    """Upright box in odom (= map): centre; length, width, height."""

    x_m: float
    y_m: float
    size_m: tuple[float, float, float] = (0.5, 0.5, 1.7)


@functools.cache
def _bare_ground(lidar: Lidar, slope: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Elevations, azimuths, origin in base, and ground point of each ray (at most 1 km away)."""
    el = np.radians(np.asarray(lidar.elevation_deg))
    fov = math.radians(lidar.field_of_view_deg)
    az = -fov / 2 + fov * (np.arange(lidar.columns) + 0.5) / lidar.columns
    T_base_sensor = lidar.mount.T_base_sensor
    flat = np.cos(el)[:, None]
    rays = np.stack([flat * np.cos(az), flat * np.sin(az), np.sin(el)[:, None] * np.ones_like(az)], axis=-1)
    rays = rays.reshape(-1, 3) @ T_base_sensor[:3, :3].T
    origin = T_base_sensor[:3, 3]
    with np.errstate(divide="ignore"):
        down = np.where(rays[:, 2] < -1e-6, -origin[2] / rays[:, 2], np.inf)
        if slope:
            # z = slope * (x - 3) for x > 3
            bent = (slope * (origin[0] - 3.0) - origin[2]) / (rays[:, 2] - slope * rays[:, 0])
            bent = np.where(bent > 0.0, bent, np.inf)
            x = origin[0] + np.where(np.isfinite(bent), bent, 0.0) * rays[:, 0]
            down = np.where((x > 3.0) & (rays[:, 0] > 0.05), bent, down)
    reach = np.minimum(down, 1000.0)
    points = origin + rays * reach[:, None]
    return el, az, origin, points


def scan_of(
    lidar: Lidar, stamp_ns: int, pose: tuple[float, float, float], boxes: tuple[Box, ...], rng: np.random.Generator,
    slope: float = 0.0, shape_boxes: tuple[Box, ...] = (),
) -> LidarScan:  # fmt: skip
    """Scan of level ground (or ground that rises by `slope` ahead of x = 3 in base) with boxes on it."""
    el, az, origin, points = _bare_ground(lidar, slope)
    far = lidar.range_m[1]
    T_odom_base = planar(*pose)
    for box in boxes:
        local = T_odom_base[:3, :3].T @ (np.array([box.x_m, box.y_m, 0.0]) - T_odom_base[:3, 3])
        if abs(local[0]) > 30.0:
            continue
        points = put_box(points, origin, (local[0], local[1]), box.size_m)
    for box in shape_boxes:
        points = put_box(points, origin, (box.x_m, box.y_m), box.size_m)
    range_m = np.linalg.norm(points - origin, axis=1)
    range_m += rng.normal(0.0, lidar.range_sigma_m, len(range_m))
    range_m[(range_m > far) | (range_m < lidar.range_m[0])] = 0.0
    ranges = np.round(range_m * 1000.0).astype(np.uint16).reshape(len(el), len(az))
    return LidarScan(stamp_ns, ranges, el, az, np.empty((0, 3), np.float32), NO_BYTES, np.empty(0, np.float32))


def straight_path(path_id: int = 1, length_m: float = 100.0, start: tuple[float, float] = (0.0, 0.0),
                  direction: int = 1, curvature: float = 0.0, speed_mps: float = 3.0) -> Path:  # fmt: skip
    """Straight or circular path from `start`, heading east at its start."""
    s = np.arange(0.0, length_m + 0.05, 0.1)
    distance = direction * s
    heading = curvature * distance
    half = 0.5 * heading
    chord = distance * np.sinc(half / math.pi)
    p = np.column_stack([start[0] + chord * np.cos(half), start[1] + chord * np.sin(half)])
    n = len(s)
    section = PathSection(PathSectionType.SWATH, 1, 0, n - 1)
    return Path(
        START_NS, path_id, direction, p, heading, np.full(n, curvature), s, np.full(n, speed_mps),
        np.ones(n, np.uint8), (section,), np.zeros(n, np.int32), False,
    )  # fmt: skip


def machine_state(stamp_ns: int, **changes: Any) -> MachineState:
    """Healthy machine at standstill."""
    state = MachineState(
        stamp_ns=stamp_ns, motion_stamp_ns=stamp_ns, steering_stamp_ns=stamp_ns, implement_stamp_ns=stamp_ns,
        cab_stamp_ns=stamp_ns, heartbeat_stamp_ns=stamp_ns, speed_mps=0.0, curvature_radpm=0.0, is_steering_ready=True,
        steering_exit_code=0, steering_limit=0, hitch=0.0, is_hitch_in_work=True, pto_radps=0.0, is_pto_engaged=False,
        is_park_brake_set=False, is_horn_on=False, is_beacon_on=False, brake_pedal=0.0, driver_torque_nm=0.0,
        driver_rate_radps=0.0, driver_angle_rad=0.0, is_seat_occupied=False, is_emergency_button_pressed=False,
        supply_v=13.8, rejected_frames=0,
    )  # fmt: skip
    return replace(state, **changes)


@dataclass(frozen=True)
class Target:
    """Object at a position in odom with a velocity, for radar (by its cross-section) and ultrasonic (if `has_echo`)."""

    x_m: float
    y_m: float
    vx_mps: float = 0.0
    vy_mps: float = 0.0
    rcs_dbsm: float = -3.0
    has_echo: bool = False


def healthy(stamp_ns: int, sensor: str, state: HealthState = HealthState.GOOD, reason: str = "") -> SensorHealth:
    """Health that covers every direction."""
    edges = np.array([-math.pi, math.pi])
    return SensorHealth(stamp_ns, sensor, state, reason, edges, np.array([40.0]), 0)


def nothing_seen(stamp_ns: int, sensor: str) -> Obstacles:
    """Obstacles message without obstacles."""
    empty, none = np.empty((0, 3)), np.empty(0, np.int32)
    return Obstacles(
        stamp_ns, sensor, stamp_ns, empty, empty, np.empty(0), empty, np.empty((0, 2)), np.empty((0, 7)),
        np.zeros(1, np.int32), none, np.empty((0, 3), np.float32),
    )  # fmt: skip


def in_sensor(world: "World", mount: Mount, target: Target) -> tuple[np.ndarray, np.ndarray]:
    """Position in the sensor frame and velocity relative to the sensor of a target 1 m above the ground."""
    T = planar(world.x_m, world.y_m, world.yaw_rad) @ mount.T_base_sensor
    place = T[:3, :3].T @ (np.array([target.x_m, target.y_m, 1.0]) - T[:3, 3])
    own = world.speed_mps * np.array([math.cos(world.yaw_rad), math.sin(world.yaw_rad), 0.0])
    return place, T[:3, :3].T @ (np.array([target.vx_mps, target.vy_mps, 0.0]) - own)


def radar_scan(world: "World", radar: Radar, now_ns: int) -> RadarScan:
    """Detections of the targets with noise, and weak clutter anywhere in view."""
    rng, rows = world.rng, []
    for target in world.targets:
        place, velocity = in_sensor(world, radar.mount, target)
        range_m, azimuth = float(np.linalg.norm(place)), math.atan2(place[1], place[0])
        if (
            abs(azimuth) > math.radians(radar.field_of_view_deg / 2)
            or not radar.range_m[0] <= range_m <= radar.range_m[1]
        ):
            continue
        noise = rng.normal(0.0, [radar.range_sigma_m, math.radians(radar.azimuth_sigma_deg), radar.doppler_sigma_mps])
        doppler = float(velocity @ place) / range_m
        rows.append((range_m + noise[0], azimuth + noise[1], 0.0, doppler + noise[2], target.rcs_dbsm))
    for _ in range(world.clutter):
        azimuth = rng.uniform(-0.5, 0.5)
        rows.append(
            (rng.uniform(1.0, 40.0), azimuth, 0.0, -world.speed_mps * math.cos(azimuth), rng.uniform(-25.0, -8.0))
        )
    columns = np.array(rows).reshape(-1, 5).T
    return RadarScan(now_ns, *(column.copy() for column in columns))


def echo_of(world: "World", sensor: Ultrasonic) -> float:
    """Range of the nearest target with an echo in the cone, NaN without."""
    half, near = math.radians(sensor.cone_deg / 2), math.nan
    for target in world.targets:
        place, _ = in_sensor(world, sensor.mount, target)
        range_m = math.hypot(place[0], place[1])
        is_in = target.has_echo and abs(math.atan2(place[1], place[0])) <= half
        if is_in and sensor.range_m[0] <= range_m <= sensor.range_m[1] and not near < range_m:
            near = range_m
    return near + world.rng.normal(0.0, sensor.range_sigma_m)


@dataclass
class World:
    """Drives a supervisor through simulated time; the machine follows its commands."""

    supervisor: Supervisor
    vehicle: Vehicle
    path: Path
    inbox: SyntheticInbox = field(default_factory=SyntheticInbox)
    boxes: tuple[Box, ...] = ()
    shape_boxes: tuple[Box, ...] = ()
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed_mps: float = 0.0
    commanded_mps: float = 2.78
    curvature: float | None = None
    slope: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    tracks: tuple = ()
    mute: set[str] = field(default_factory=set)
    machine_changes: dict[str, Any] = field(default_factory=dict)
    pose_changes: dict[str, Any] = field(default_factory=dict)
    odom_changes: dict[str, Any] = field(default_factory=dict)
    command_changes: dict[str, Any] = field(default_factory=dict)
    mission: MissionState = MissionState.DRIVING
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    command: Any = None
    state: Any = None
    faults: list = field(default_factory=list)
    history: list = field(default_factory=list)
    steps: int = 0
    sequence: int = 0
    follows_commands: bool = True
    path_s_m: float = 0.0
    acceleration: float = 0.0
    is_plain: bool = False
    has_brake_test: bool = False
    targets: tuple[Target, ...] = ()
    clutter: int = 0
    fold: float = 0.0
    folds: bool = False

    def __post_init__(self) -> None:
        if not self.has_brake_test:
            self.supervisor._brake_test.phase = Phase.PASSED

    @property
    def mode(self) -> str:
        return str(self.supervisor.mode)

    def order(
        self,
        order: OperatorCommandKind,
        authority: str = "operator",
        expires_s: float = 10.0,
        sequence: int | None = None,
        is_confirmed: bool = True,
    ):
        """Puts a command; a confirmation that nobody is near goes before a start."""
        if is_confirmed and order is OperatorCommandKind.START:
            self.order(OperatorCommandKind.CONFIRM_CLEAR)
        self.sequence += 1
        number = self.sequence if sequence is None else sequence
        now = self.inbox.now_ns + STEP_NS
        self.inbox.put("operator_command", OperatorCommand(now, order, authority, number, now + round(expires_s * 1e9)))

    def put(self, topic: str, message: Message) -> None:
        if topic not in self.mute and topic.partition("/")[0] not in self.mute:
            self.inbox.put(topic, message)

    def put_all(self) -> None:
        now, pose = self.inbox.now_ns, (self.x_m, self.y_m, self.yaw_rad)
        T = planar(*pose)
        T[:3, :3] = T[:3, :3] @ transform((0, 0, 0), (self.roll_rad, self.pitch_rad, 0.0))[:3, :3]
        curvature = self.curvature if self.curvature is not None else float(self.path.curvature_radpm[0])
        self.put("imu", ImuSample(now, np.zeros(3), np.zeros(3)))
        self.put("wheel", WheelSample(now, self.speed_mps, 0.0))
        turn = self.speed_mps * curvature
        odom = Odometry(now, T, self.speed_mps, 0.0, self.acceleration, turn, curvature, np.eye(6) * 1e-4)
        self.put("odom", replace(odom, **self.odom_changes))
        changes = {
            "speed_mps": self.speed_mps,
            "curvature_radpm": curvature,
            "is_park_brake_set": bool(self.command and self.command.is_park_brake_set),
            "fold_position": self.fold,
            **self.machine_changes,
        }
        self.put("machine", machine_state(now, **changes))
        if self.steps % 5 == 0:
            pose_message = MapPose(now, np.eye(4), T.copy(), np.eye(6) * 1e-4, PositionSource.RTK_FIXED, 0.1, 0.1, True)
            self.put("map_pose", replace(pose_message, **self.pose_changes))
            self.put("order_status", OrderStatus(now, "tractor", "00", 0, ()))
            self.put("tracks", Tracks(now, self.tracks))
            for name, lidar in self.vehicle.sensors.lidar.items():
                if f"lidar/{name}" not in self.mute:
                    scan = scan_of(lidar, now, pose, self.boxes, self.rng, self.slope, self.shape_boxes)
                    self.put(f"lidar/{name}", scan)
        self.put_others(now)
        if self.steps % 10 == 0:
            status = MissionStatus(
                now, self.mission, PathSectionType.SWATH, 1, self.path.path_id, self.path_s_m, 0.0, 1.0, "", ()
            )
            self.put("mission", status)
        control_command = ControlCommand(
            now,
            self.path.direction * self.commanded_mps,
            0.0,
            curvature,
            True,
            True,
            self.path.path_id,
            self.path_s_m,
            0.0,
            0.0,
            False,
        )
        self.put("control_command", replace(control_command, **self.command_changes))
        if self.steps == 0 or self.inbox.messages.get("path") is not self.path:
            self.put("path", self.path)

    def put_others(self, now: int) -> None:
        """Radars at 25 Hz, ultrasonic sensors and health at 10 Hz, cameras at 2 Hz, with their obstacles messages."""
        sensors = self.vehicle.sensors
        if self.steps % 2 == 0:
            for name, radar in sensors.radar.items():
                self.put(f"radar/{name}", radar_scan(self, radar, now))
                self.put(f"obstacles/radar_{name}", nothing_seen(now, f"radar_{name}"))
        if self.steps % 25 == 0:
            for name in sensors.camera:
                self.put(f"obstacles/camera_{name}", nothing_seen(now, f"camera_{name}"))
        if self.steps % 5 == 0:
            for name, sensor in sensors.ultrasonic.items():
                self.put(f"ultrasonic/{name}", UltrasonicRange(now, echo_of(self, sensor)))
                self.put(f"obstacles/ultrasonic_{name}", nothing_seen(now, f"ultrasonic_{name}"))
            for kind in ("lidar", "radar", "ultrasonic", "camera"):
                for name in getattr(sensors, kind):
                    self.put(f"health/{kind}_{name}", healthy(now, f"{kind}_{name}"))

    def move(self) -> None:
        dt = STEP_NS * 1e-9
        before = self.speed_mps
        if self.follows_commands and self.command is not None:
            target = self.command.speed_mps
            up = 0.6 if abs(target) > abs(self.speed_mps) else max(0.5, min(4.0, self.command.deceleration_mps2))
            if abs(target) <= abs(self.speed_mps) and self.command.deceleration_mps2 > 0.0 and abs(target) == 0.0:
                up = min(4.0, max(self.command.deceleration_mps2, 0.5))
            self.speed_mps += max(-up * dt, min(up * dt, target - self.speed_mps))
        self.acceleration = (self.speed_mps - before) / dt
        curvature = self.curvature if self.curvature is not None else float(self.path.curvature_radpm[0])
        if self.folds and self.command is not None:
            self.fold = min(1.0, max(0.0, self.fold + (dt / 8.0 if self.command.is_implement_folded else -dt / 8.0)))
        distance = self.speed_mps * dt
        self.yaw_rad += 0.5 * curvature * distance
        self.x_m += distance * math.cos(self.yaw_rad)
        self.y_m += distance * math.sin(self.yaw_rad)
        self.yaw_rad += 0.5 * curvature * distance
        self.path_s_m = max(0.0, self.path_s_m + distance * self.path.direction)

    def step(self, count: int = 1) -> "World":
        for _ in range(count):
            self.inbox.now_ns += STEP_NS
            self.put_all()
            for topic, message in self.supervisor.step(self.inbox.now_ns, self.inbox):
                if topic == "safe_command":
                    self.command = message
                elif topic == "supervisor":
                    self.state = message
                else:
                    self.faults.append(message)
            self.history.append((self.mode, self.command))
            self.inbox.queues = {}
            self.steps += 1
            self.move()
        return self

    def run(self, seconds: float) -> "World":
        return self.step(round(seconds * 50))

    def start(self) -> "World":
        """Through the start warning into automatic mode."""
        self.run(0.2)
        self.order(OperatorCommandKind.START)
        return self.run(3.2)


def situation_of(config: SupervisorConfig, **changes: Any) -> Situation:
    """Situation to which no rule objects, with changes to it or to its inputs and vehicle state."""
    T = transform((0.0, 0.0, 0.0), (changes.pop("roll_rad", 0.0), changes.pop("pitch_rad", 0.0), 0.0))
    pose = MapPose(START_NS, np.eye(4), np.eye(4), np.eye(6) * 1e-4, PositionSource.RTK_FIXED, 0.1, 0.1, True)
    control_command = ControlCommand(START_NS, 2.0, 0.0, 0.0, True, True, 1, 0.0, 0.0, 0.0, False)
    inputs = MonitorInputs(
        Odometry(START_NS, T, 2.0, 0.0, 0.0, 0.0, 0.0, np.eye(6)), replace(pose, **changes.pop("pose", {})),
        control_command, None, None, 0.0, 1.0, SourceData({}, {}, {}), {},
    )  # fmt: skip
    speed_mps, is_known = changes.pop("speed_mps", 2.0), changes.pop("is_speed_known", True)
    vehicle = VehicleState(
        speed_mps if is_known else None, speed_mps, 1, config.braking.flat, 0.0, 0.01,
        math.inf if math.isnan(level := inputs.map_pose.protection_level_m) else level, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            False,
    )  # fmt: skip
    inputs = replace(inputs, **{name: changes.pop(name) for name in vars(inputs).keys() & changes.keys()})
    vehicle = replace(vehicle, **{name: changes.pop(name) for name in vars(vehicle).keys() & changes.keys()})
    good = Situation(
        now_ns=START_NS, config=config, rule_limits=config.rules, inputs=inputs, machine=machine_state(START_NS),
        vehicle=vehicle, max_speed_mps=8.0, allowance_m=2.1, timed_out_topics=(), frozen=(), faults=(),
        clearance=Clearance(math.inf, math.inf, np.empty((0, 3))), critical_object=NO_CRITICAL_OBJECT,
        standing_body=NO_STANDING_BODY, detection_range_m=40.0, blind=(),
        geofence_distance_m=math.inf, is_foldable=False, clock_step_s=0.0, has_pose_jumped=False,
        brake_test=Phase.PASSED, sensor_failures=(),
        is_departure_unresolved=False, is_somebody_near=False, lidar_failures=(), vegetation_m=0.0, consent=None,
        is_docking=False, is_under_roof=False, wall_distance_m=math.inf,
    )  # fmt: skip
    return replace(good, **changes)


def around(limit: float, step: float, count: int = 5) -> list[float]:
    """The limit and `count` steps on either side."""
    return [limit + k * step for k in range(-count, count + 1)]
