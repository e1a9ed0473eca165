"""Animation of a drive from its log: machine, lidar points, tracks and protective field in a perspective view.

The camera follows the machine in `odom`, behind and above it. All positions come from the log's messages; the machine's
dimensions come from the configuration that the log carries.
"""

import io
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import yaml
from PIL import Image

from configs.strict import parse
from configs.vehicle import FOLDED, Implement, ImplementFile, Vehicle
from datasets.reader import LogScan, decode, is_ours
from geometry.arrays import Float32, Float64, UInt8
from geometry.transforms import apply, invert, planar
from messages.command import MachineState, SafeCommand, SupervisorState
from messages.errors import LogError
from messages.message import Message
from messages.motion import MapPose, Odometry
from messages.perception import ObstacleClass, Tracks
from messages.plan import Path as DrivePath
from messages.sensors import LidarScan

SIZE_PX = (640, 400)
FOCAL_PX = 430.0
CAMERA_BASE_M = (-15.0, 0.0, 9.0)  # behind and above the rear axle
CAMERA_PITCH_RAD = math.radians(24.0)
AXIS_ROW = 0.58  # row of the optical axis, share of the height
NEAR_M, FAR_M = 1.0, 60.0
POINTS_PER_SCAN = 5000
PATH_AHEAD_M = 40.0
BACKGROUND, GROUND_POINT, HIGH_POINT = (30, 26, 24), (110, 105, 80), (120, 220, 235)  # BGR
MACHINE, IMPLEMENT, PATH = (90, 200, 90), (80, 140, 190), (60, 210, 240)
FIELD_FREE, FIELD_HIT, TEXT = (235, 150, 60), (60, 60, 240), (235, 235, 235)
CLASS_COLOURS = {
    ObstacleClass.PERSON: (60, 90, 255),
    ObstacleClass.ANIMAL: (40, 160, 255),
    ObstacleClass.VEHICLE: (255, 150, 80),
}
OTHER_TRACK = (60, 210, 255)
EDGES = [(0, 1), (1, 3), (3, 2), (2, 0), (4, 5), (5, 7), (7, 6), (6, 4), (0, 4), (1, 5), (2, 6), (3, 7)]


@dataclass
class Snapshot:
    """Newest message of each kind; `scans` by sensor name with the pose (4, 4) of `base` in `odom` at their stamp."""

    odometry: Odometry | None = None
    map_pose: MapPose | None = None
    tracks: Tracks | None = None
    supervisor: SupervisorState | None = None
    command: SafeCommand | None = None
    machine: MachineState | None = None
    path: DrivePath | None = None
    scans: dict[str, tuple[LidarScan, Float64]] = field(default_factory=dict)

    def update(self, topic: str, message: Message) -> None:
        """Takes one message of the log; other topics are ignored."""
        if isinstance(message, LidarScan) and self.odometry is not None:
            self.scans[topic.partition("/")[2]] = (message, self.odometry.T_odom_base)
        for name, kind in KINDS.items():
            if topic == name and isinstance(message, kind):
                setattr(self, ATTRIBUTES.get(name, name), message)


KINDS: dict[str, type[Message]] = {
    "odom": Odometry, "map_pose": MapPose, "tracks": Tracks, "supervisor": SupervisorState,
    "safe_command": SafeCommand, "machine": MachineState, "path": DrivePath,
}  # fmt: skip
ATTRIBUTES = {"odom": "odometry", "safe_command": "command"}


class View:
    """Draws on an image of SIZE_PX as seen from a camera that is fixed to `base` at one moment."""

    def __init__(self, T_odom_base: Float64) -> None:
        self.image: UInt8 = np.full((SIZE_PX[1], SIZE_PX[0], 3), BACKGROUND, np.uint8)
        yaw = math.atan2(T_odom_base[1, 0], T_odom_base[0, 0])
        level = planar(float(T_odom_base[0, 3]), float(T_odom_base[1, 3]), yaw)
        level[2, 3] = T_odom_base[2, 3]
        self._T_level_odom = invert(level)

    def project(self, points_odom: Float64) -> tuple[Float64, Float64]:
        """Pixels (N, 2) and depth (N,) in metres of points (N, 3) in `odom`."""
        p = np.asarray(apply(self._T_level_odom, points_odom)) - CAMERA_BASE_M
        c, s = math.cos(CAMERA_PITCH_RAD), math.sin(CAMERA_PITCH_RAD)
        depth, up = c * p[:, 0] - s * p[:, 2], s * p[:, 0] + c * p[:, 2]
        scale = FOCAL_PX / np.maximum(depth, 1e-3)
        return np.column_stack([0.5 * SIZE_PX[0] - scale * p[:, 1], AXIS_ROW * SIZE_PX[1] - scale * up]), depth

    def points(self, points_odom: Float64, colours: UInt8) -> None:
        """Points (N, 3) with BGR colours (N, 3), each one or two pixels wide."""
        pixels, depth = self.project(points_odom)
        columns, rows = np.round(pixels).astype(int).T
        inside = (depth > NEAR_M) & (depth < FAR_M + 15.0) & (columns >= 0) & (columns < SIZE_PX[0] - 1)
        inside &= (rows >= 0) & (rows < SIZE_PX[1] - 1)
        for k in np.flatnonzero(inside)[np.argsort(-depth[inside])]:
            wide = 2 if depth[k] < 25.0 else 1
            self.image[rows[k] : rows[k] + wide, columns[k] : columns[k] + wide] = colours[k]

    def line(self, points_odom: Float64, colour: tuple[int, int, int], width: int, is_closed: bool = False) -> None:
        """Polyline (N, 3); parts behind the camera are left out."""
        pixels, depth = self.project(points_odom)
        ends = list(range(len(pixels))) + ([0] if is_closed else [])
        for a, b in pairwise(ends):
            if min(depth[a], depth[b]) > NEAR_M:
                self._segment(pixels[a], pixels[b], colour, width)

    def area(self, points_odom: Float64, colour: tuple[int, int, int], opacity: float) -> None:
        """Filled polygon (N, 3)."""
        pixels, depth = self.project(points_odom)
        if len(pixels) < 3 or depth.min() < NEAR_M:
            return
        layer = self.image.copy()
        cv2.fillPoly(layer, [np.round(pixels).astype(np.int32)], colour, cv2.LINE_AA)
        self.image = np.asarray(cv2.addWeighted(layer, opacity, self.image, 1.0 - opacity, 0.0), np.uint8)

    def box(self, T_odom_box: Float64, low: Float64, high: Float64, colour: tuple[int, int, int]) -> None:
        """Edges of a box between two corners (3,) in its own frame."""
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        pixels, depth = self.project(np.asarray(apply(T_odom_box, corners)))
        if depth.min() > NEAR_M:
            for a, b in EDGES:
                self._segment(pixels[a], pixels[b], colour, 1)

    def text(self, text: str, at_px: tuple[float, float], colour: tuple[int, int, int], scale: float = 0.42) -> None:
        """Text with its lower left corner at a pixel."""
        at = (round(at_px[0]), round(at_px[1]))
        cv2.putText(self.image, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)

    def _segment(self, a: Float64, b: Float64, colour: tuple[int, int, int], width: int) -> None:
        if max(abs(a).max(), abs(b).max()) < 1e4:
            ends = [(round(float(p[0])), round(float(p[1]))) for p in (a, b)]
            cv2.line(self.image, ends[0], ends[1], colour, width, cv2.LINE_AA)


def animate(log: Path, start_s: float, duration_s: float, rate: float, fps: float) -> list[UInt8]:
    """Images (H, W, 3) BGR of `duration_s` of a drive from `start_s` after its start, `rate` times real time.

    Raises LogError when the log has no odometry in that interval or carries no machine configuration.
    """
    scan = LogScan(log)
    snapshot, images = Snapshot(), list[UInt8]()
    first_ns: int | None = None
    vehicle: Vehicle | None = None
    implement: Implement | None = None
    for entry in scan:
        if not is_ours(entry) or (entry.topic not in KINDS and not entry.topic.startswith("lidar/")):
            continue
        first_ns = entry.receive_ns if first_ns is None else first_ns
        at_s = (entry.receive_ns - first_ns) * 1e-9 - start_s
        if at_s > duration_s:
            break
        if at_s < -1.0 and entry.topic not in ("path", "map_pose"):
            continue
        snapshot.update(entry.topic, decode(entry).message)
        if vehicle is None:
            vehicle, implement = machine_of(scan, log)
        if at_s >= len(images) * rate / fps and snapshot.odometry is not None:
            images.append(frame_of(snapshot, vehicle, implement, start_s + at_s))
    if not images:
        raise LogError(f"{log}: no odometry from {start_s} s to {start_s + duration_s} s")
    return images


def machine_of(scan: LogScan, log: Path) -> tuple[Vehicle, Implement]:
    """Machine and implement of the configuration that a log carries; raises LogError."""
    text = scan.metadata.get("config", {}).get("yaml")
    if text is None:
        raise LogError(f"{log}: carries no configuration of its machine; only logs of `headland run` can be animated")
    values = yaml.load(text, yaml.CSafeLoader)
    where = f"{log}: configuration"
    implement = parse(ImplementFile, {"implement": values["implement"]}, where).implement
    return parse(Vehicle, values["machine"], where), implement


def frame_of(snapshot: Snapshot, vehicle: Vehicle, implement: Implement | None, t_s: float) -> UInt8:
    """One image of a snapshot."""
    assert snapshot.odometry is not None
    T = snapshot.odometry.T_odom_base
    view = View(T)
    for name, (scan, T_odom_base) in snapshot.scans.items():
        if name in vehicle.sensors.lidar:
            view.points(*scan_points(scan, T_odom_base @ vehicle.sensors.lidar[name].mount.T_base_sensor, T))
    _draw_path(view, snapshot, T)
    state = snapshot.supervisor
    if state is not None and len(state.protective_field_base_m) > 2:
        outline = np.column_stack([state.protective_field_base_m, np.zeros(len(state.protective_field_base_m))])
        colour = FIELD_HIT if len(state.triggering_points_base_m) else FIELD_FREE
        view.area(np.asarray(apply(T, outline)), colour, 0.3)
        view.line(np.asarray(apply(T, outline)), colour, 1, is_closed=True)
        if len(state.triggering_points_base_m):
            hits = np.asarray(apply(T, state.triggering_points_base_m.astype(np.float64)))
            view.points(hits, np.full((len(hits), 3), FIELD_HIT, np.uint8))
    _draw_machine(view, snapshot, vehicle, implement, T)
    _draw_tracks(view, snapshot)
    _draw_state(view, snapshot, t_s)
    return view.image


def scan_points(scan: LidarScan, T_odom_lidar: Float64, T_odom_base: Float64) -> tuple[Float64, UInt8]:
    """At most POINTS_PER_SCAN returns (N, 3) in `odom` and their BGR colours (N, 3) by height above `base`."""
    points: Float32 = scan.points_m[:: max(1, len(scan.points_m) // POINTS_PER_SCAN)]
    odom = np.asarray(apply(T_odom_lidar, points.astype(np.float64)))
    height = np.asarray(apply(invert(T_odom_base), odom))[:, 2]
    share = np.clip((height - 0.15) / 1.5, 0.0, 1.0)[:, None]
    return odom, ((1.0 - share) * GROUND_POINT + share * HIGH_POINT).astype(np.uint8)


def _draw_path(view: View, snapshot: Snapshot, T_odom_base: Float64) -> None:
    path, pose = snapshot.path, snapshot.map_pose
    if path is None or pose is None or not len(path.p_map_m):
        return
    T_odom_map = invert(pose.T_map_odom)
    odom = np.asarray(apply(T_odom_map, np.column_stack([path.p_map_m[::5], np.zeros(len(path.p_map_m[::5]))])))
    odom[:, 2] = T_odom_base[2, 3]
    near = np.hypot(*(odom[:, :2] - T_odom_base[:2, 3]).T) < PATH_AHEAD_M
    for run in np.split(np.arange(len(odom)), np.flatnonzero(np.diff(near.astype(int))) + 1):
        if len(run) > 1 and near[run[0]]:
            view.line(odom[run], PATH, 1)


def _draw_machine(
    view: View, snapshot: Snapshot, vehicle: Vehicle, implement: Implement | None, T_odom_base: Float64
) -> None:
    body = vehicle.body
    half, low = 0.5 * body.width_m, 0.5 * body.height_m
    view.box(T_odom_base, np.array([-body.rear_m, -half, 0.4]), np.array([body.front_m, half, low]), MACHINE)
    cab = np.array([-0.6 * body.rear_m, -0.8 * half, low]), np.array([0.35 * body.front_m, 0.8 * half, body.height_m])
    view.box(T_odom_base, *cab, MACHINE)
    if implement is not None:
        is_folded = snapshot.machine is not None and snapshot.machine.fold_position >= FOLDED
        carried = implement.folded if is_folded else implement
        ends = sorted(carried.ends_m)
        corner = np.array([ends[0], -0.5 * carried.width_m, 0.1])
        view.box(T_odom_base, corner, np.array([ends[1], 0.5 * carried.width_m, 0.9]), IMPLEMENT)


def _draw_tracks(view: View, snapshot: Snapshot) -> None:
    for track in snapshot.tracks.tracks if snapshot.tracks is not None else ():
        if not track.is_confirmed or track.label not in CLASS_COLOURS:
            continue
        colour = CLASS_COLOURS.get(track.label, OTHER_TRACK)
        T = planar(float(track.p_odom_m[0]), float(track.p_odom_m[1]), track.yaw_rad)
        T[2, 3] = track.p_odom_m[2]
        view.box(T, -0.5 * track.size_m, 0.5 * track.size_m, colour)
        top = track.p_odom_m[None] + np.array([0.0, 0.0, 0.5 * track.size_m[2] + 0.3])
        pixels, depth = view.project(top)
        if NEAR_M < depth[0] < FAR_M:
            speed = math.hypot(*track.velocity_mps[:2].tolist())
            view.text(f"{track.label} {speed:.1f} m/s", (pixels[0, 0] - 30, pixels[0, 1]), colour, 0.38)


def _draw_state(view: View, snapshot: Snapshot, t_s: float) -> None:
    assert snapshot.odometry is not None
    speed_kmh = 3.6 * snapshot.odometry.speed_mps
    view.text(f"{t_s:6.1f} s   {speed_kmh:4.1f} km/h", (10, 20), TEXT)
    state = snapshot.supervisor
    if state is not None:
        is_stop = state.mode.endswith("_stop")
        colour = FIELD_HIT if is_stop else TEXT
        reason = f": {state.reason}" if state.reason and state.reason != state.mode else ""
        view.text(f"{state.mode}{reason}", (10, 40), colour)
        clear = f"{state.clearance_m:.1f} m" if math.isfinite(state.clearance_m) else "-"
        view.text(f"stopping distance {state.stopping_distance_m:.1f} m   clearance {clear}", (10, 60), TEXT)


def webp(images: list[UInt8], fps: float, quality: int) -> bytes:
    """Animated WebP, endless loop."""
    frames: Iterator[Image.Image] = (Image.fromarray(np.ascontiguousarray(image[:, :, ::-1])) for image in images)
    first, rest = next(frames), list(frames)
    out = io.BytesIO()
    first.save(
        out, "WEBP", save_all=True, append_images=rest, duration=round(1000.0 / fps), loop=0, quality=quality, method=4
    )
    return out.getvalue()
