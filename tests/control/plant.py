"""Tractor model of the control tests: bicycle with steering loop, slip, speed loop with an error, and sensor noise.

Independent of `simulation/`, so that a common error is detected.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from configs.strict import CONFIGS, load, parse, read_yaml
from configs.vehicle import ImplementFile, Vehicle
from control.controller import ControlConfig, Controller
from geometry.transforms import invert, planar
from messages.command import MachineState, Mode, SafeCommand
from messages.motion import MapPose, Odometry, PositionSource
from messages.plan import Path, PathSection, PathSectionType

VEHICLE = load(Vehicle, CONFIGS / "machines" / "tractor_e.yaml")
IMPLEMENT = load(ImplementFile, CONFIGS / "implements" / "harrow_6m.yaml").implement
CONFIG = parse(ControlConfig, read_yaml(CONFIGS / "stack/control.yaml"), "stack/control.yaml")
DT_S = 0.01
TICK_NS = 10_000_000
BASE_NS = 5_000_000_000


@dataclass
class Ground:
    """Effects of the field on the machine; the slope falls to the south."""

    side_slope_deg: float = 0.0
    crab_per_g: float = 0.20  # rad of slip angle by lateral share of weight: 0.6 degrees on 3 degrees
    understeer: float = 0.0
    soil_radpm: float = 0.0
    grade: float = 0.0


@dataclass
class SensorNoise:
    """Noise of the inputs of the controller."""

    map_m: float = 0.006  # slow error of the localizer
    map_s: float = 20.0
    pose_m: float = 0.0005
    yaw_deg: float = 0.02
    yaw_rate_radps: float = 0.001
    angle_deg: float = 0.1
    angle_zero_deg: float = 0.3
    speed_mps: float = 0.01


@dataclass
class Actuators:
    """Response of the machine."""

    bus_s: float = 0.03
    dead_s: float = 0.06
    loop_s: float = 0.286
    motor_s: float = 0.08
    rate_radps: float = 0.46875
    backlash_deg: float = 0.2
    speed_gain: float = 0.96  # a steady error of 4 %
    speed_lag_s: float = 0.35
    acceleration_mps2: float = 0.6
    slowing_mps2: float = 1.0


@dataclass
class Track:
    """True states and commands, every 20 ms."""

    t_s: list[float] = field(default_factory=list)
    x_m: list[float] = field(default_factory=list)
    y_m: list[float] = field(default_factory=list)
    yaw_rad: list[float] = field(default_factory=list)
    speed_mps: list[float] = field(default_factory=list)
    hitch: list[float] = field(default_factory=list)
    commands: list = field(default_factory=list)


class Inbox:
    def __init__(self):
        self.messages = {}

    def latest(self, topic, kind):
        return self.messages.get(topic)

    last = latest


class Plant:
    """Machine, sensors and a supervisor that passes all commands; `run` drives until the path is finished."""

    def __init__(
        self, x=0.0, y=0.0, yaw=0.0, speed=0.0, ground=None, noise=None, actuators=None, seed=1, config=CONFIG,
        implement=IMPLEMENT,
    ):  # fmt: skip
        self.implement = implement
        self.ground, self.noise, self.act = ground or Ground(), noise or SensorNoise(), actuators or Actuators()
        self.x, self.y, self.yaw, self.speed = x, y, yaw, speed
        self.rng = np.random.default_rng(seed)
        self.controller = Controller(VEHICLE, implement, config)
        self.inbox = Inbox()
        self.now_ns = BASE_NS
        self.commands = deque([(0.0, 0.0, 0.0, False)] * round(self.act.bus_s / DT_S))
        self.rates = deque([0.0] * round(self.act.dead_s / DT_S))
        self.motor_radps = self.drive_rad = self.angle_rad = self.curvature = 0.0
        self.reference_mps = speed
        self.soil = 0.0
        self.map_error = np.zeros(2)
        self.hitch = 1.0
        self.fold = 0.0
        self.is_enabled = True
        self.track = Track()
        self.jump = (0.0, 0.0)

    def run(self, path, until_s=300.0, stop=None):
        self.inbox.messages["path"] = path
        end_ns = self.now_ns + round(until_s * 1e9)
        while self.now_ns < end_ns:
            control_command = None
            if (self.now_ns - BASE_NS) % (2 * TICK_NS) == 0:
                control_command = self.control()
            self.move()
            self.now_ns += TICK_NS
            if control_command is not None and (
                control_command.is_finished or (stop is not None and stop(self, control_command))
            ):
                break
        return self.track

    def control(self):
        self.measure()
        control_command = self.controller.step(self.now_ns, self.inbox)[0][1]
        self.inbox.messages["safe_command"] = SafeCommand(
            self.now_ns, Mode.AUTOMATIC, self.is_enabled, control_command.speed_mps if self.is_enabled else 0.0,
            max(0.0, -control_command.acceleration_mps2), control_command.curvature_radpm,
            control_command.is_implement_lowered, control_command.is_pto_on,
            False, False, True, "",
        )  # fmt: skip
        self.control_command = control_command
        t = self.track
        for values, value in ((t.t_s, self.now_ns * 1e-9), (t.x_m, self.x), (t.y_m, self.y), (t.yaw_rad, self.yaw),
                              (t.speed_mps, self.speed), (t.hitch, self.hitch), (t.commands,
                              control_command)):  # fmt: skip
            values.append(value)
        return control_command

    def move(self):
        a, w = self.act, self.control_command
        brake = max(0.0, -w.acceleration_mps2) if self.is_enabled else 3.0
        self.commands.append(
            (w.curvature_radpm, w.speed_mps if self.is_enabled else 0.0, brake, w.is_implement_lowered)
        )
        curvature, speed, brake, is_lowered = self.commands.popleft()
        self.turn_wheels(math.atan(2.55 * curvature))
        up = abs(speed) > abs(self.reference_mps) and speed * self.reference_mps >= 0
        most = (a.acceleration_mps2 if up else a.slowing_mps2) * DT_S
        self.reference_mps += max(-most, min(most, speed - self.reference_mps))
        target = a.speed_gain * self.reference_mps - 2.0 * self.ground.grade * math.cos(self.yaw)
        if speed == 0.0 and abs(self.reference_mps) < 0.01:
            target = 0.0  # the drive holds at standstill
        self.speed += (target - self.speed) * DT_S / a.speed_lag_s
        if brake > 0.0:
            self.speed = math.copysign(max(0.0, abs(self.speed) - brake * DT_S), self.speed)
        step = DT_S / (self.implement.lower_s if is_lowered else self.implement.lift_s)
        self.hitch = max(0.0, self.hitch - step) if is_lowered else min(1.0, self.hitch + step)
        if abs(self.speed) < 0.01 and self.is_enabled and self.implement.folded is not self.implement:
            change = DT_S / self.implement.fold.duration_s
            self.fold = min(max(self.fold + (change if w.is_implement_folded else -change), 0.0), 1.0)
        self.roll()

    def turn_wheels(self, desired_rad):
        a = self.act
        measured = self.drive_rad - math.radians(self.noise.angle_zero_deg)
        rate = max(-a.rate_radps, min(a.rate_radps, (desired_rad - measured) / a.loop_s))
        self.rates.append(rate if abs(desired_rad - measured) > math.radians(0.06) else 0.0)
        self.motor_radps += (self.rates.popleft() - self.motor_radps) * DT_S / a.motor_s
        self.drive_rad = max(-0.52, min(0.52, self.drive_rad + self.motor_radps * DT_S))
        play = 0.5 * math.radians(a.backlash_deg)
        self.angle_rad = max(self.drive_rad - play, min(self.drive_rad + play, self.angle_rad))
        self.curvature = math.tan(self.angle_rad) / 2.55 / (1.0 + self.ground.understeer * self.speed**2)

    def roll(self):
        g, v = self.ground, self.speed
        self.soil += (-self.soil * DT_S / 0.5) + g.soil_radpm * math.sqrt(2 * DT_S / 0.5) * self.rng.standard_normal()
        self.curvature += self.soil
        side = math.sin(math.radians(g.side_slope_deg)) * math.cos(self.yaw)  # weight to the right when going east
        crab = -g.crab_per_g * side * (1.0 if v >= 0.0 else -1.0)
        turn = v * self.curvature * DT_S
        course = self.yaw + 0.5 * turn + crab
        self.x += v * DT_S * math.cos(course)
        self.y += v * DT_S * math.sin(course)
        self.yaw += turn

    def measure(self):
        s, n = self.noise, self.rng.standard_normal
        share = math.exp(-0.02 / s.map_s)
        self.map_error = share * self.map_error + s.map_m * math.sqrt(1 - share * share) * n(2)
        T_odom_map = planar(3.0, 2.0, 0.3)
        x, y = self.x + s.pose_m * n(), self.y + s.pose_m * n()
        T_map_base = planar(x, y, self.yaw + math.radians(s.yaw_deg) * n())
        shift = planar(self.map_error[0] + self.jump[0], self.map_error[1] + self.jump[1], 0.0)
        measured = math.tan(self.drive_rad - math.radians(s.angle_zero_deg) + math.radians(s.angle_deg) * n()) / 2.55
        odom = Odometry(
            self.now_ns, T_odom_map @ T_map_base, self.speed + s.speed_mps * n(), 0.0, 0.0,
            self.speed * self.curvature + s.yaw_rate_radps * n(), measured, np.eye(6),
        )  # fmt: skip
        self.inbox.messages["odom"] = odom
        if (self.now_ns - BASE_NS) % 100_000_000 == 0:
            T_map_odom = shift @ invert(T_odom_map)
            self.inbox.messages["map_pose"] = MapPose(
                self.now_ns, T_map_odom, shift @ T_map_base, np.eye(6), PositionSource.RTK_FIXED, 0.1, 0.1, True
            )
            self.inbox.messages["machine"] = machine_state(self.now_ns, self.hitch, self.speed, self.fold)


def machine_state(now_ns, hitch, speed, fold=0.0):
    return MachineState(
        now_ns, now_ns, now_ns, now_ns, now_ns, now_ns, speed, 0.0, True, 0, 0, hitch, hitch < 0.1, 56.0, True, False,
        False, True, 0.0, 0.0, 0.0, 0.0, False, False, 13.8, 0, fold,
    )  # fmt: skip


def path_along(curvatures, speed_mps=2.78, start=(0.0, 0.0, 0.0), direction=1, work=None, path_id=1, step_m=0.1):
    """Path from the curvature of travel at each step."""
    x, y, heading = start
    heading += 0.0 if direction > 0 else math.pi
    points, headings = [(x, y)], [heading]
    for k in curvatures:
        turn = k * step_m
        x += step_m * math.cos(heading + 0.5 * turn)
        y += step_m * math.sin(heading + 0.5 * turn)
        heading += turn
        points.append((x, y))
        headings.append(heading)
    n = len(points)
    s = step_m * np.arange(n)
    speed = np.minimum(speed_mps, np.sqrt(2 * 0.5 * np.maximum(s[-1] - s, 0.0)))
    speed = np.minimum(speed, np.sqrt(0.3**2 + 2 * 0.5 * s))
    speed[-1] = 0.0
    is_working = np.zeros(n, np.uint8) if work is None else np.asarray(work, np.uint8)
    machine = np.array(headings) + (0.0 if direction > 0 else math.pi)
    return Path(
        0, path_id, direction, np.array(points), machine, direction * np.array([*curvatures, curvatures[-1]], float), s,
        speed, is_working, (PathSection(PathSectionType.SWATH, 0, 0, n - 1),), np.zeros(n, np.int32), True,
    )  # fmt: skip


def true_offsets(track, path):
    """Offset (left positive in the direction of travel) and arc length of each sample against the given path."""
    p, s = path.p_map_m, path.s_m
    q = np.stack([track.x_m, track.y_m], axis=1)
    offsets, positions = np.empty(len(q)), np.empty(len(q))
    near = 0
    for i, point in enumerate(q):
        lo, hi = max(0, near - 10), min(len(p), near + 30)
        near = lo + int(np.argmin(np.sum((p[lo:hi] - point) ** 2, axis=1)))
        best = (math.inf, 0.0, 0.0)
        for k in (near - 1, near):
            if 0 <= k < len(p) - 1:
                d = p[k + 1] - p[k]
                length = float(np.hypot(*d))
                along = float(np.clip((point - p[k]) @ d / length, 0.0, length))
                foot = p[k] + d * along / length
                cross = float(d[0] * (point - p[k])[1] - d[1] * (point - p[k])[0]) / length
                distance = float(np.hypot(*(point - foot)))
                if distance < best[0]:
                    best = (distance, cross, s[k] + along)
        offsets[i], positions[i] = best[1], best[2]
    return offsets, positions
