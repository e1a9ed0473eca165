"""Foxglove messages for the viewer topics: pure functions."""

import math
from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration as CalibrationMessage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from configs.site import Shed, Site
from configs.vehicle import Camera, Implement, MountedImplement, Ultrasonic, Vehicle
from datasets.importers.recording import CameraCalibration
from datasets.plots import PlottedEvent
from datasets.primitives import Rgba, cube, frame, line, scene, text, time_of
from geometry.arrays import Float32, Float64
from geometry.polyline import simplified
from geometry.transforms import apply, planar
from messages.command import SupervisorState
from messages.faults import Fault, Severity
from messages.perception import ObstacleClass, Tracks
from messages.plan import Path
from messages.sensors import GnssFix, RadarScan, UltrasonicRange
from messages.truth import TrueObjects

WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)
GREY: Rgba = (0.6, 0.6, 0.6, 0.6)
GREEN: Rgba = (0.2, 0.7, 0.25, 0.8)
BROWN: Rgba = (0.55, 0.4, 0.2, 0.8)
RED: Rgba = (0.9, 0.1, 0.1, 0.9)
BLUE: Rgba = (0.2, 0.5, 1.0, 0.9)
YELLOW: Rgba = (1.0, 0.8, 0.1, 0.9)
CLASS_COLORS: dict[ObstacleClass, Rgba] = {
    ObstacleClass.PERSON: (1.0, 0.3, 0.2, 0.7),
    ObstacleClass.ANIMAL: (1.0, 0.6, 0.1, 0.7),
    ObstacleClass.VEHICLE: (0.3, 0.5, 1.0, 0.7),
}
MAX_TRIGGERING_POINTS = 60
BAY_MARK_M = 3.0
ARC_POINTS = 7
T_BODY_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def implement_x_m(implement: Implement) -> float:
    """Working point along x of `base`, of a trailed implement in line with the machine."""
    if isinstance(implement, MountedImplement):
        return implement.working_point_m
    return implement.hitch_m - implement.working_length_m


def T_base_implement(implement: Implement, hitch_rad: float) -> Float64:
    """Pose of the implement's working point in `base`, of a trailed one at a hitch angle."""
    if isinstance(implement, MountedImplement):
        return planar(implement.working_point_m, 0.0, 0.0)
    return planar(implement.hitch_m, 0.0, hitch_rad) @ planar(-implement.working_length_m, 0.0, 0.0)


def mounts(
    stamp_ns: int, vehicle: Vehicle, implement: Implement | None, hitch_rad: float = 0.0
) -> list[FrameTransform]:
    """Poses of sensors and implement in `base`; a sensor frame has the name of its topic."""
    sensors = vehicle.sensors
    poses = {
        f"{kind}/{name}": one.mount.T_base_sensor
        for kind, named in sensors
        if isinstance(named, dict)
        for name, one in named.items()
    }
    optical = {f"camera/{name}": optical_frame(f"camera/{name}") for name in sensors.camera}
    if sensors.imu is not None:
        poses["imu"] = sensors.imu.mount.T_base_sensor
    if implement is not None:
        poses["implement"] = T_base_implement(implement, hitch_rad)
    links = [frame(stamp_ns, "base", child, T) for child, T in poses.items()]
    return links + [frame(stamp_ns, body, child, T_BODY_OPTICAL) for body, child in optical.items()]


def optical_frame(topic: str) -> str:
    """Frame of the images of a camera topic."""
    return f"{topic}/optical"


def machine_scene(stamp_ns: int, vehicle: Vehicle) -> SceneUpdate:
    """Machine as a box."""
    body = vehicle.body
    low = 0.4
    center = (0.5 * (body.front_m - body.rear_m), 0.0, 0.5 * (low + body.height_m))
    box = cube(center, (body.front_m + body.rear_m, body.width_m, body.height_m - low), 0.0, GREEN)
    return scene(stamp_ns, "machine", "base", [box])


def implement_scene(stamp_ns: int, implement: Implement) -> SceneUpdate:
    """The implement as a flat box about its working point."""
    if isinstance(implement, MountedImplement):
        front, rear = implement.front_end_m, implement.rear_end_m
    else:
        front, rear = implement.hitch_m, implement.hitch_m - implement.total_length_m
    center = (0.5 * (front + rear) - implement_x_m(implement), 0.0, 0.5)
    box = cube(center, (front - rear, implement.width_m, 0.8), 0.0, BROWN)
    return scene(stamp_ns, "implement", "implement", [box])


def site_scene(stamp_ns: int, site: Site) -> SceneUpdate:
    """Boundary, yard, no-go areas and lanes."""
    lines = [line(np.array(site.boundary_m), 0.15, GREEN, True), line(np.array(site.yard.outline_m), 0.1, GREY, True)]
    lines += [line(np.array(area.outline_m), 0.15, RED, True) for area in site.no_go]
    lines += [line(np.array(lane.center_m), 0.1, GREY) for lane in site.lanes]
    return scene(stamp_ns, "site", "map", lines=lines)


def shed_scene(stamp_ns: int, shed: Shed) -> SceneUpdate:
    """Roof, walls and posts, the free width of each bay at its dock pose, and the UWB anchors."""
    lines = [line(lifted(shed.outline_m, shed.height_m), 0.05, GREY, True)]
    for wall in shed.walls_m:
        lines += [line(lifted(wall, z), shed.wall_thickness_m, BROWN) for z in (0.1, 0.5 * shed.height_m)]
    posts = [cube((*post.at_m,), (2.0 * post.radius_m,) * 2 + (shed.height_m,), 0.0, BROWN) for post in shed.posts]
    anchors = [cube(p, (0.2, 0.2, 0.2), 0.0, BLUE) for p in shed.anchors.values()]
    texts = [text(name, (x, y, z + 0.4), 0.4, WHITE) for name, (x, y, z) in shed.anchors.items()]
    for bay in shed.bays:
        T = planar(bay.dock.x_m, bay.dock.y_m, math.radians(bay.dock.heading_deg))
        mark = np.array([[0.0, -0.5, 0.0], [0.0, 0.5, 0.0], [BAY_MARK_M, 0.0, 0.0]]) * [1.0, bay.width_m, 1.0]
        lines.append(line(np.asarray(apply(T, mark))[:, :2], 0.08, GREEN, True))
        texts.append(text(f"bay {bay.name}", (bay.dock.x_m, bay.dock.y_m, 0.5), 0.5, WHITE))
    return scene(stamp_ns, "shed", "map", [*posts, *anchors], lines, texts)


def lifted(outline_m: Sequence[tuple[float, float]], z_m: float) -> Float64:
    """Points (N, 3) of an outline at a height."""
    return np.array([(x, y, z_m) for x, y in outline_m])


def radar_points(scan: RadarScan) -> Float32:
    """Detections (N, 3) in the radar's frame."""
    level = scan.range_m * np.cos(scan.elevation_rad)
    columns = (
        level * np.cos(scan.azimuth_rad),
        level * np.sin(scan.azimuth_rad),
        scan.range_m * np.sin(scan.elevation_rad),
    )
    return np.column_stack(columns).astype(np.float32)


def echo_scene(echo: UltrasonicRange, topic: str, sensor: Ultrasonic) -> SceneUpdate:
    """Arc of the echo in yellow; the full cone in grey without an echo."""
    is_echo = math.isfinite(echo.range_m)
    angles = np.radians(np.linspace(-0.5, 0.5, ARC_POINTS) * sensor.cone_deg)
    reach = echo.range_m if is_echo else sensor.range_m[1]
    arc = reach * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(ARC_POINTS)])
    ring = np.vstack([np.zeros((1, 3)), arc])
    return scene(echo.stamp_ns, topic, topic, lines=[line(ring, 0.04, YELLOW if is_echo else GREY, True)])


def tracks_scene(stamp_ns: int, message: Tracks) -> SceneUpdate:
    """Tracks as boxes with class and speed; unconfirmed ones in grey."""
    cubes, texts = [], []
    for track in message.tracks:
        p, size = track.p_odom_m.tolist(), track.size_m.tolist()
        rgba = CLASS_COLORS.get(track.label, YELLOW) if track.is_confirmed else GREY
        cubes.append(cube(p, size, track.yaw_rad, rgba))
        if track.is_confirmed:
            label = f"{track.label} {math.hypot(*track.velocity_mps[:2].tolist()):.1f} m/s"
            texts.append(text(label, (p[0], p[1], size[2] + 0.8), 0.5, WHITE))
    return scene(stamp_ns, "tracks", "odom", cubes, texts=texts)


def truth_scene(stamp_ns: int, message: TrueObjects, frame_id: str) -> SceneUpdate:
    """True objects as pale boxes."""
    pale: Rgba = (1.0, 1.0, 1.0, 0.25)
    cubes = [cube(o.center_map_m.tolist(), o.size_m.tolist(), o.yaw_rad, pale) for o in message.objects]
    return scene(stamp_ns, "truth", frame_id, cubes)


def field_scene(stamp_ns: int, state: SupervisorState, height_m: float) -> SceneUpdate:
    """Protective field, triggering points, mode and reason."""
    is_triggered = len(state.triggering_points_base_m) > 0
    lines = (
        [line(state.protective_field_base_m, 0.12, RED if is_triggered else BLUE, True)]
        if len(state.protective_field_base_m) > 1
        else []
    )
    hits = [
        cube(p, (0.15, 0.15, 0.15), 0.0, RED) for p in state.triggering_points_base_m[:MAX_TRIGGERING_POINTS].tolist()
    ]
    label = f"{state.mode}: {state.reason}" if state.reason else str(state.mode)
    return scene(stamp_ns, "field", "base", hits, lines, [text(label, (0.0, 0.0, height_m + 1.0), 0.6, WHITE)])


def path_scene(stamp_ns: int, path: Path) -> SceneUpdate:
    """The path to drive."""
    return scene(stamp_ns, "path", "map", lines=[line(simplified(path.p_map_m), 0.1, YELLOW)])


def calibration(stamp_ns: int, frame_id: str, camera: Camera | CameraCalibration) -> CalibrationMessage:
    """Intrinsics of a camera; its frame is the optical frame (x right, y down, z forward)."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.center_px
    width, height = camera.size_px
    return CalibrationMessage(
        timestamp=time_of(stamp_ns), frame_id=frame_id, width=width, height=height, distortion_model="plumb_bob",
        D=camera.distortion, K=(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0), R=np.eye(3).ravel().tolist(),
        P=(fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0),
    )  # fmt: skip


def event_line(stamp_ns: int, event: PlottedEvent) -> Log:
    """A stop or encounter as a line in the viewer's log panel."""
    return Log(timestamp=time_of(stamp_ns), level=Log.WARNING, message=event.text, name=event.kind)


def location(stamp_ns: int, fix: GnssFix, frame_id: str) -> LocationFix:
    """The antenna on a street map."""
    out = LocationFix(timestamp=time_of(stamp_ns), frame_id=frame_id, altitude=fix.height_m)
    out.latitude, out.longitude = math.degrees(fix.latitude_rad), math.degrees(fix.longitude_rad)
    out.position_covariance.extend(np.diag(fix.sigma_enu_m**2).ravel().tolist())
    out.position_covariance_type = LocationFix.DIAGONAL_KNOWN
    return out


def log_line(stamp_ns: int, fault: Fault) -> Log:
    """A fault as a line in the viewer's log panel."""
    levels = {Severity.NOTICE: Log.INFO, Severity.WARNING: Log.WARNING, Severity.ALARM: Log.ERROR}
    label = f"{fault.code}: {fault.text_en}" if fault.is_active else f"{fault.code}: over"
    return Log(timestamp=time_of(stamp_ns), level=levels[fault.severity], message=label, name=fault.source)
