"""3-D view and camera images of the drive view: points of the lidars, machine, obstacles; coordinates in `base`, m."""

import math
from base64 import b64encode
from typing import Any

import cv2
import numpy as np

from configs.vehicle import Camera, Vehicle
from geometry.arrays import Float64
from geometry.pose2 import Pose2, from_frame, to_frame
from geometry.transforms import apply, invert, yaw_of
from hmi.drive_view.sensing import LIVING, near_tracks, track_text
from hmi.page_state import PageState
from hmi.scene import placed_outlines
from hmi.texts import Texts
from messages.command import MachineState, SupervisorState
from messages.motion import Odometry
from messages.perception import Track
from messages.sensors import CameraImage, LidarScan

MAP, SPACE, CAMERA = "map", "space", "camera/"
SHOWN = LidarScan, CameraImage
POINTS = 8000  # of all lidars
RANGE_M = 45.0
OLDEST_S = 3.0  # the log of `live` has a scan each 2 s
IMAGE_PX, QUALITY = 960, 70  # width, JPEG
MACHINE_LOW_M, IMPLEMENT_HIGH_M = 0.4, 0.9
MIN_DEPTH_M = 0.3
MOVING_MPS = 0.2
R_OPTICAL_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def panes(vehicle: Vehicle) -> tuple[str, ...]:
    """What can be shown in the place of the map: `map`, `space` with a lidar, and the topic of each camera."""
    space = (SPACE,) if vehicle.sensors.lidar else ()
    return (MAP, *space, *(f"{CAMERA}{name}" for name in vehicle.sensors.camera))


def watched(pane: str, vehicle: Vehicle) -> frozenset[str]:
    """Topics of scans and images that a pane shows."""
    if pane == SPACE:
        return frozenset(f"lidar/{name}" for name in vehicle.sensors.lidar)
    return frozenset({pane}) if pane.startswith(CAMERA) else frozenset()


def stamps(state: PageState, pane: str) -> tuple[int, ...]:
    """Stamps of the scans or images of a pane."""
    found = (state.newest(topic, kind) for topic in sorted(watched(pane, state.scene.vehicle)) for kind in SHOWN)
    return tuple(one.stamp_ns for one in found if one is not None and state.age_s(one) <= OLDEST_S)


def space(state: PageState, texts: Texts) -> dict[str, Any]:
    """Points (int16, cm, base64), boxes of machine and implement, protective field, and obstacles."""
    points = np.clip(np.rint(100.0 * lidar_points(state)), -32768, 32767).astype("<i2")
    supervisor = state.fresh("supervisor", SupervisorState)
    field = np.empty((0, 2)) if supervisor is None else supervisor.protective_field_base_m
    tracks = [
        {
            "at": _rounded(_center(state, track)), "size": _rounded(track.size_m),
            "yaw": round(_yaw(state, track), 3), **_named(track, texts),
        }
        for track, *_ in near_tracks(state)
    ]  # fmt: skip
    shown = np.isfinite(field).all(axis=1)
    return {
        "points": b64encode(points.tobytes()).decode(), "bodies": bodies(state), "tracks": tracks,
        "field": [_rounded(one) for one in field[shown]],
    }  # fmt: skip


def lidar_points(state: PageState) -> Float64:
    """Returns (N, 3) of the newest scan of each lidar, thinned, where they are seen from the machine now."""
    lidars, found = state.scene.vehicle.sensors.lidar, []
    machine = state.newest("machine", MachineState)
    hitch = 1.0 if machine is None or not math.isfinite(machine.hitch) else machine.hitch
    for name, lidar in lidars.items():
        scan = state.newest(f"lidar/{name}", LidarScan)
        if scan is None or state.age_s(scan) > OLDEST_S:
            continue
        points = scan.points_m[:: max(1, len(scan.points_m) * len(lidars) // POINTS)]
        points = points[(np.abs(points) <= RANGE_M).all(axis=1)]
        in_base = np.asarray(apply(lidar.mount.at_hitch(hitch), points), np.float64)
        in_base[:, :2] = from_frame(_moved(state, scan.stamp_ns), in_base[:, :2])
        found.append(in_base)
    return np.concatenate(found) if found else np.empty((0, 3))


def bodies(state: PageState) -> list[list[float]]:
    """Machine and implement as boxes: centre, then size, and the hitch angle of a trailed one."""
    scene, machine = state.scene, state.newest("machine", MachineState)
    is_folded = machine is not None and machine.fold_position > 0.5
    implement = scene.implement.folded if is_folded else scene.implement
    found, heights = [], ((MACHINE_LOW_M, scene.vehicle.body.height_m), (0.0, IMPLEMENT_HIGH_M))
    placed = placed_outlines(scene.vehicle.body, implement, state.hitch_rad)
    for (outline, carrier), (low_m, high_m) in zip(placed, heights, strict=False):
        low, high = outline.corners_m.min(axis=0), outline.corners_m.max(axis=0)
        center, size = to_frame(carrier, 0.5 * (low + high)[None])[0], high - low
        found.append(_rounded([*center, 0.5 * (low_m + high_m), *size, high_m - low_m, carrier.yaw_rad]))
    return found


def camera(state: PageState, topic: str, texts: Texts) -> dict[str, Any] | None:
    """Newest image of a camera as JPEG (base64) with its size and the boxes of obstacles in it, or None."""
    image = state.newest(topic, CameraImage)
    if image is None or image.bgr.size == 0 or state.age_s(image) > OLDEST_S:
        return None
    height, width = image.bgr.shape[:2]
    scale = min(1.0, IMAGE_PX / width)
    small = image.bgr if scale == 1.0 else cv2.resize(image.bgr, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    mount = state.scene.vehicle.sensors.camera[topic.removeprefix(CAMERA)]
    then, found = _moved(state, image.stamp_ns), []
    for track, *_ in near_tracks(state):
        corners = _corners(state, track)
        corners[:, :2] = to_frame(then, corners[:, :2])
        box = image_box(corners, mount, (width, height))
        if box is not None:
            found.append({"box": _rounded(box), **_named(track, texts)})
    return {"topic": topic, "jpeg": b64encode(jpeg.tobytes()).decode(), "size": [width, height], "boxes": found}


def image_box(points_base_m: Float64, camera_of: Camera, size_px: tuple[int, int]) -> Float64 | None:
    """Rectangle (left, top, right, bottom) of points (N, 3) in an image; None outside of it or too near."""
    T = invert(camera_of.mount.T_base_sensor)
    optical = np.asarray(apply(T, points_base_m), np.float64) @ R_OPTICAL_BODY.T
    if (optical[:, 2] < MIN_DEPTH_M).any():
        return None
    scale = np.array(size_px) / np.array(camera_of.size_px)
    (fx, fy), (cx, cy) = camera_of.focal_px, camera_of.center_px
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    flat = cv2.projectPoints(optical, np.zeros(3), np.zeros(3), K, np.array(camera_of.distortion))[0].reshape(-1, 2)
    low, high = flat.min(axis=0) * scale, flat.max(axis=0) * scale
    if (high <= 0.0).any() or (low >= size_px).any():
        return None
    return np.concatenate([np.maximum(low, 0.0), np.minimum(high, size_px)])


def _named(track: Track, texts: Texts) -> dict[str, Any]:
    """Class and text of an obstacle; `is_shown`: what lives or moves has its text beside it."""
    is_moving = float(np.hypot(*track.velocity_mps[:2])) > MOVING_MPS
    return {"class": str(track.label), "text": track_text(track, texts), "is_shown": track.label in LIVING or is_moving}


def _corners(state: PageState, track: Track) -> Float64:
    """Corners (8, 3) of the box of an obstacle."""
    signs = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], np.float64)
    corners = signs * 0.5 * track.size_m
    corners[:, :2] = to_frame(Pose2(0.0, 0.0, _yaw(state, track)), corners[:, :2])
    return corners + _center(state, track)


def _center(state: PageState, track: Track) -> Float64:
    """Centre (3,) of an obstacle; `base` is tilted with the machine."""
    odometry = state.newest("odom", Odometry)
    T = np.eye(4) if odometry is None else invert(odometry.T_odom_base)
    return np.asarray(T[:3, :3] @ track.p_odom_m + T[:3, 3])


def _yaw(state: PageState, track: Track) -> float:
    odometry = state.newest("odom", Odometry)
    return track.yaw_rad - (0.0 if odometry is None else yaw_of(odometry.T_odom_base))


def _moved(state: PageState, stamp_ns: int) -> Pose2:
    """Pose of `base` now in `base` at a time shortly before."""
    odometry = state.newest("odom", Odometry)
    if odometry is None or not (math.isfinite(odometry.speed_mps) and math.isfinite(odometry.yaw_rate_radps)):
        return Pose2(0.0, 0.0, 0.0)
    passed_s = max(0.0, (odometry.stamp_ns - stamp_ns) * 1e-9)
    turned_rad = odometry.yaw_rate_radps * passed_s
    way_m = odometry.speed_mps * passed_s
    return Pose2(way_m * math.cos(0.5 * turned_rad), way_m * math.sin(0.5 * turned_rad), turned_rad)


def _rounded(values: Any) -> list[float]:
    return [round(float(one), 2) for one in values]
