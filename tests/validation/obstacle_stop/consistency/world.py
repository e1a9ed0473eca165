"""Synthetic drives: ground, boxes and poles scanned by ray casting with a true mount, described with another one."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from configs.vehicle import Lidar, Mount
from datasets.importers.point_clouds import list_scan
from geometry.jit import kernel
from geometry.rectangle import Rectangle
from geometry.transforms import invert, planar, transform
from messages.message import Envelope
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.sensors import ImuSample, LidarScan, WheelSample
from messages.truth import TrueMachine, TrueObject, TrueObjects
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.consistency.finding import Finding
from validation.obstacle_stop.consistency.observer import ConsistencyObserver
from validation.obstacle_stop.observation import Setting
from validation.obstacle_stop.swept_path import Outline

CONDITIONS = load_conditions(None)
START_NS = 1_700_000_000_000_000_000
OUTLINE = Rectangle(-1.0, 3.6, 1.8)
SECONDS, PERIOD_S, ODOM_S = 8.0, 0.1, 0.02


@kernel
def cast(origin, rays, boxes, ground, max_range):  # type: ignore[no-untyped-def]
    """Range along each ray (N, 3) to the plane z = a x + b y + c or an upright box (x, y, z, half sizes, yaw)."""
    out = np.full(len(rays), np.inf)
    for r in range(len(rays)):
        dx, dy, dz = rays[r]
        fall = dz - ground[0] * dx - ground[1] * dy
        if fall < -1e-9:
            out[r] = (ground[0] * origin[0] + ground[1] * origin[1] + ground[2] - origin[2]) / fall
        for k in range(len(boxes)):
            x, y, z, a, b, h, yaw = boxes[k]
            # closest approach in the plane
            t = (x - origin[0]) * dx + (y - origin[1]) * dy
            reach2 = a * a + b * b
            ox, oy = origin[0] - x, origin[1] - y
            flat2 = dx * dx + dy * dy
            if t < 0.0 or ox * ox + oy * oy - t * t / flat2 > reach2:
                continue
            c, s = math.cos(yaw), math.sin(yaw)
            px, py, pz = c * ox + s * oy, c * oy - s * ox, origin[2] - z
            qx, qy, qz = c * dx + s * dy, c * dy - s * dx, dz
            x0, x1 = (-a - px) / qx, (a - px) / qx
            y0, y1 = (-b - py) / qy, (b - py) / qy
            z0, z1 = (-h - pz) / qz, (h - pz) / qz
            enter = max(min(x0, x1), min(y0, y1), min(z0, z1))
            leave = min(max(x0, x1), max(y0, y1), max(z0, z1))
            if 0.0 < enter < leave and enter < out[r]:
                out[r] = enter
        if out[r] > max_range:
            out[r] = np.nan
    return out


@dataclass(frozen=True)
class Actor:
    """A labelled object: pose (x, y, yaw) in map by time, size, and whether a scan of a time has returns of it."""

    id: int
    at: Callable[[float], tuple[float, float, float]]
    size_m: tuple[float, float, float] = (0.6, 0.6, 1.75)
    label: ObstacleClass = ObstacleClass.PERSON
    has_returns: Callable[[float], bool] = lambda t: True

    def true_object(self, t_s: float, ground_m: float) -> TrueObject:
        """The truth at a time."""
        (x, y, yaw), size = self.at(t_s), np.array(self.size_m)
        center = np.array([x, y, ground_m + 0.5 * size[2]])
        return TrueObject(self.id, self.label, "", center, size, yaw, np.full(2, np.nan), math.nan)


@dataclass(frozen=True)
class Drive:
    """A drive and its surroundings; the `configured` mount describes the scans of the `mount`."""

    seed: int
    beams: int = 32
    columns: int = 360
    speed_mps: float = 3.0
    curvature_radpm: float = 0.0
    slope: float = 0.0
    bump_deg: float = 0.3
    noise_m: float = 0.03
    has_structure: bool = True
    objects: int = 5
    has_truth: bool = True
    truth_in_map: bool = True
    speed_wave: float = 0.0
    turn_wave: float = 0.0
    mount: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1.0, 0.0, 1.9), (0.0, 0.0, 0.0))
    configured: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    invisible: tuple[int, ...] = ()
    elevation_deg: tuple[float, ...] = field(default=())
    seconds: float = SECONDS
    actors: tuple[Actor, ...] = ()

    def lidar(self) -> Lidar:
        """The lidar as configured."""
        xyz, rpy = self.configured or self.mount
        low, high = (-25.0, 8.0) if self.beams > 16 else (-15.0, 15.0)
        table = self.elevation_deg or tuple(np.linspace(low, high, self.beams).tolist())
        return Lidar(
            mount=Mount(xyz_m=xyz, rpy_deg=rpy), elevation_deg=table, columns=self.columns, rate_hz=10.0,
            range_m=(0.5, 80.0), range_sigma_m=0.03,
        )  # fmt: skip

    def pose(self, t_s: float) -> tuple[float, float, float]:
        """Pose in map (x, y, yaw)."""
        grid = np.linspace(0.0, max(t_s, 1e-6), 40)
        speed, turn = self.rates(grid)
        yaw = np.concatenate([[0.0], np.cumsum(0.5 * (turn[1:] + turn[:-1]) * np.diff(grid))])
        vx, vy = speed * np.cos(yaw), speed * np.sin(yaw)
        return float(np.trapezoid(vx, grid)), float(np.trapezoid(vy, grid)), float(yaw[-1])

    def rates(self, t_s):  # type: ignore[no-untyped-def]
        """Speed and yaw rate at times."""
        speed = self.speed_mps * (1.0 + self.speed_wave * np.sin(1.3 * np.asarray(t_s)))
        return speed, self.curvature_radpm * speed + self.turn_wave * np.sin(1.1 * np.asarray(t_s))

    def scene(self) -> tuple[np.ndarray, list[TrueObject]]:
        """Boxes (K, 7) and the labelled objects, both in map; the first boxes are the objects."""
        rng = np.random.default_rng(self.seed)
        labelled, boxes = [], []
        for number in range(self.objects):
            t = rng.uniform(0.2, 1.0) * self.seconds
            x, y, yaw = self.pose(t)
            side = rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 9.0)
            size = np.array([0.6, 0.6, 1.75]) if number < 2 else np.array([4.2, 1.8, 1.6])
            side += np.sign(side) * 0.5 * size[1]
            x, y, turn = x - side * math.sin(yaw), y + side * math.cos(yaw), yaw + rng.uniform(-0.4, 0.4)
            z = self.slope * x + 0.5 * size[2]
            boxes.append((x, y, z, *(0.5 * size[:2]), 0.5 * size[2], turn))
            label = ObstacleClass.PERSON if number < 2 else ObstacleClass.VEHICLE
            labelled.append(TrueObject(number, label, "", np.array([x, y, z]), size, turn, np.zeros(2), math.nan))
        others = []
        for _ in range(45 if self.has_structure else 0):
            x, y, yaw = self.pose(rng.uniform(-0.2, 1.6) * self.seconds)
            side = rng.choice([-1.0, 1.0]) * rng.uniform(11.0, 30.0)
            x, y = x - side * math.sin(yaw) + rng.normal(0, 3), y + side * math.cos(yaw) + rng.normal(0, 1)
            if rng.random() < 0.5:
                a = b = rng.uniform(0.1, 0.2)
                h = rng.uniform(1.0, 2.5)
            else:
                a, b, h = rng.uniform([1, 1, 1], [6, 4, 2.5])
            others.append((x, y, self.slope * x + h, a, b, h, rng.uniform(0, 3)))
        return np.array(boxes + others).reshape(-1, 7), labelled

    def envelopes(self) -> list[Envelope]:
        """All messages in order of delivery; shared by drives that differ in the configured mount alone."""
        return list(_envelopes_of(replace(self, configured=None)))

    def generate(self) -> list[Envelope]:
        """All messages in order of delivery, generated again."""
        rng = np.random.default_rng(self.seed + 1000)
        fixed, standing = self.scene()
        visible = fixed[[k for k in range(len(fixed)) if k not in self.invisible]]
        lidar, (xyz, rpy) = self.lidar(), self.mount
        el, az = np.radians(lidar.elevation_deg), np.linspace(-math.pi, math.pi, self.columns, endpoint=False)
        flat, up = np.cos(el)[:, None], np.sin(el)[:, None] + 0.0 * az
        rays = np.stack([flat * np.cos(az), flat * np.sin(az), up], axis=-1).reshape(-1, 3)
        rays += 1e-9
        ground = np.array([self.slope, 0.0, 0.0])
        phase, out = rng.uniform(0, 6, 3), []
        for k in range(round(self.seconds / ODOM_S)):
            t = k * ODOM_S
            stamp, pose, (speed, turn) = START_NS + round(t * 1e9), self.pose(t), self.rates(t)
            odom = Odometry(stamp, planar(*pose), float(speed), 0.0, 0.0, float(turn), 0.0, np.eye(6))
            out.append((stamp, "odom", odom))
            out.append((stamp, "wheel", WheelSample(stamp, float(speed) * (1.0 + rng.normal(0.0, 0.02)), 0.0)))
            out.append((stamp, "imu", ImuSample(stamp, np.zeros(3), np.array([0.0, 0.0, turn + rng.normal(0, 0.01)]))))
            if k % round(PERIOD_S / ODOM_S):
                continue
            bump = math.radians(self.bump_deg) * np.sin(phase + 0.9 * self.speed_mps * t * np.array([1.0, 1.3, 0.7]))
            tilt = transform((0, 0, 0.05 * bump[2] * 20), (bump[0], bump[1] - math.atan(self.slope), 0.0))
            x, y, yaw = pose
            T = transform((x, y, self.slope * x), (0, 0, yaw)) @ tilt
            T_sensor = T @ transform(xyz, np.radians(rpy))
            directions = rays @ T_sensor[:3, :3].T
            acting = [(actor, actor.true_object(t, self.slope * actor.at(t)[0])) for actor in self.actors]
            boxes = [[*o.center_map_m, *(0.5 * o.size_m), o.yaw_rad] for actor, o in acting if actor.has_returns(t)]
            solid = np.concatenate([np.array(boxes).reshape(-1, 7), visible])
            distance = cast(T_sensor[:3, 3], directions, solid, ground, 70.0)
            distance += rng.normal(0.0, self.noise_m, len(distance))
            found = np.isfinite(distance)
            scan = list_scan(stamp, (rays[found] * distance[found, None]).astype(np.float32))
            machine = TrueMachine(stamp, T, float(speed), 0.0, float(turn), 0.0, np.zeros(3), 0.0, 0.0, False, 0, 0)
            objects = labelled = [*standing, *(true for _, true in acting)]
            if not self.truth_in_map:
                T_lidar = invert(T_sensor)
                objects = [
                    replace(o, center_map_m=T_lidar[:3, :3] @ o.center_map_m + T_lidar[:3, 3], yaw_rad=o.yaw_rad - yaw)
                    for o in labelled
                ]
            if self.has_truth:
                out += [(stamp, "truth_machine", machine), (stamp, "truth_objects", TrueObjects(stamp, tuple(objects)))]
            out.append((stamp, "lidar/top", scan))
        return [Envelope(topic, 0, stamp, message) for stamp, topic, message in out]

    def findings(self, change=lambda e: e, is_from_scans: bool = False) -> tuple[Finding, ...]:  # type: ignore[no-untyped-def]
        """Findings of the log after a change of each message (None drops it)."""
        lidar = self.lidar()
        frame = None if not self.has_truth else ("map" if self.truth_in_map else "top")
        setting = Setting(
            "log", {"top": lidar.mount.T_base_sensor}, 3.6, 1.8, 1.4, frame, math.pi, Outline((OUTLINE,)),
            Outline((OUTLINE,)), (), True,
        )  # fmt: skip
        observer = ConsistencyObserver(setting, {"top": lidar}, (OUTLINE,), is_from_scans, CONDITIONS, np.eye(4))
        changed = [c for e in self.envelopes() if (c := change(e)) is not None]
        truth = (TrueObjects, TrueMachine)
        early = [replace(e, receive_ns=e.receive_ns - 250_000_000 * isinstance(e.message, truth)) for e in changed]
        for envelope in sorted(early, key=lambda e: e.receive_ns):
            observer(envelope)
        return observer.finish()


@lru_cache(maxsize=8)
def _envelopes_of(drive: Drive) -> tuple[Envelope, ...]:
    return tuple(drive.generate())


def blocking(findings: tuple[Finding, ...]) -> set[str]:
    """Codes of the blocking findings."""
    return {f.code for f in findings if f.is_blocking}


def is_scan(envelope: Envelope) -> bool:
    """Whether an envelope holds a scan."""
    return isinstance(envelope.message, LidarScan)
