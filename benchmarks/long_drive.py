"""Log of a long drive, generated as a stream: lidar of 64 rings, camera, odometry, IMU, GNSS and 20 true objects."""

import heapq
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from datasets.importers.recording import SOURCE, Description, Extrinsic, Sensor, describe
from datasets.log import LogWriter
from geometry.arrays import Float32, Float64
from geometry.geodesy import Datum
from geometry.jit import kernel
from geometry.transforms import invert, planar, transform
from messages.message import Envelope, Message
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.sensors import CameraImage, GnssFix, GnssSolution, ImuSample, LidarScan
from messages.truth import TrueObject, TrueObjects
from runtime.stack import load_stack

START_NS = 1_700_000_000_000_000_000
STANDSTILL_S = 4.0
SPEED_MPS = 3.0
WEAVE_M, WEAVE_LENGTH_M = 4.0, 60.0
RINGS, COLUMNS, MAX_RANGE_M = 64, 600, 80.0
GRID_PER_M = np.float32(512.0)  # 2 mm: the resolution of such lidars
ELEVATION_RAD = np.radians(np.linspace(-25.0, 3.0, RINGS))
AZIMUTH_RAD = np.linspace(-math.pi, math.pi, COLUMNS, endpoint=False)
T_BASE_LIDAR = transform((1.0, 0.0, 1.8))
SPACING_M = 7.0
OBJECTS = 20
IMAGE_PX = (640, 480)
IMAGES = 40
DATUM = Datum(0.85, 0.15, 400.0)
KINDS = {
    "person": (ObstacleClass.PERSON, (0.5, 0.6, 1.75)),
    "animal": (ObstacleClass.ANIMAL, (1.0, 0.4, 0.7)),
    "vehicle": (ObstacleClass.VEHICLE, (4.2, 1.8, 1.6)),
}
SENSORS = {"lidar/top": "top", "camera/front": "camera", "imu": "imu", "gnss/main": "gnss", "odom": "base"}
VEHICLE = f"""\
name: a generated vehicle
body: {{front_m: 3.6, rear_m: 1.0, width_m: 1.8, height_m: 1.5}}
sensors:
  lidar:
    top:
      mount: {{xyz_m: {T_BASE_LIDAR[:3, 3].tolist()}}}
      elevation_deg: {np.degrees(ELEVATION_RAD).round(4).tolist()}
      columns: {COLUMNS}
      rate_hz: 10
      range_m: [0.5, {MAX_RANGE_M}]
      range_sigma_m: 0.02
  camera:
    front: {{mount: {{xyz_m: [1.5, 0.0, 1.6]}}, size_px: [640, 480], focal_px: [500.0, 500.0],
      center_px: [319.5, 239.5], rate_hz: 10}}
"""


def write_drive(path: Path, seconds: float) -> None:
    """Writes the log; the same content for the same duration."""
    sensors = [Sensor(topic, frame, topic, "generated") for topic, frame in SENSORS.items()]
    sensors.append(Sensor("truth_objects/top", "top", "truth", "generated"))
    mounts = (Extrinsic("base", "top", T_BASE_LIDAR), Extrinsic("base", "gnss", transform((0.5, 0.0, 1.9))))
    about = Description("generated", tuple(sensors), mounts, truth_frame="top")
    metadata = {SOURCE: {"path": "generated", "description": json.dumps(describe(about))}}
    with LogWriter(path, metadata, load_stack().datasets.log) as log:
        for number, (stamp_ns, topic, message) in enumerate(messages(seconds)):
            log.write(Envelope(topic, number, stamp_ns, message))


def messages(seconds: float) -> Iterator[tuple[int, str, Message]]:
    """All messages in order of time."""
    rng = np.random.default_rng(7)
    noise = rng.normal(size=(1 << 20,)).astype(np.float32)
    images = [_image(rng) for _ in range(IMAGES)]
    streams = [
        _stream("odom", 50, seconds, lambda t, k: odometry(t)),
        _stream("imu", 100, seconds, lambda t, k: _imu(t, noise[6 * k % 1_000_000 :][:6])),
        _stream("gnss/main", 10, seconds, lambda t, k: _fix(t)),
        _stream("camera/front", 10, seconds, lambda t, k: CameraImage(stamp_of(t), *images[k % IMAGES])),
        _stream("truth_objects/top", 10, seconds, lambda t, k: _truth(t)),
        _stream("lidar/top", 10, seconds, lambda t, k: _scan(t, k, noise)),
    ]
    yield from heapq.merge(*streams, key=lambda row: row[0])


def _stream(
    topic: str, rate_hz: int, seconds: float, make: Callable[[float, int], Message]
) -> Iterator[tuple[int, str, Message]]:
    for k in range(round(seconds * rate_hz)):
        yield stamp_of(k / rate_hz), topic, make(k / rate_hz, k)


def stamp_of(t_s: float) -> int:
    """Stamp (ns) of a time since the start."""
    return START_NS + round(t_s * 1e9)


def motion(t_s: float) -> tuple[float, float, float, float, float]:
    """x, y and yaw in map, speed and yaw rate: a weaving line after a standstill."""
    moving_s = max(0.0, t_s - STANDSTILL_S)
    ramp_s = 3.0
    vx = SPEED_MPS * min(1.0, moving_s / ramp_s)
    x = 0.5 * SPEED_MPS / ramp_s * moving_s**2 if moving_s < ramp_s else SPEED_MPS * (moving_s - 0.5 * ramp_s)
    slope = WEAVE_M / WEAVE_LENGTH_M * math.sin(x / WEAVE_LENGTH_M)
    bend = WEAVE_M / WEAVE_LENGTH_M**2 * math.cos(x / WEAVE_LENGTH_M)
    y = WEAVE_M * (1.0 - math.cos(x / WEAVE_LENGTH_M))
    return x, y, math.atan(slope), vx * math.hypot(1.0, slope), vx * bend / (1.0 + slope**2)


def odometry(t_s: float) -> Odometry:
    """True odometry."""
    x, y, yaw, speed, turn = motion(t_s)
    curvature = turn / speed if speed > 0.0 else 0.0
    return Odometry(stamp_of(t_s), planar(x, y, yaw), speed, 0.0, 0.0, turn, curvature, 1e-4 * np.eye(6))


def _imu(t_s: float, noise: np.ndarray) -> ImuSample:
    *_, speed, turn = motion(t_s)
    force = np.array([0.0, speed * turn, 9.81]) + 0.01 * noise[:3]
    return ImuSample(stamp_of(t_s), force, np.array([0.0, 0.0, turn]) + 1e-3 * noise[3:])


def _fix(t_s: float) -> GnssFix:
    x, y, yaw, speed, _ = motion(t_s)
    p = planar(x, y, yaw) @ np.array([0.5, 0.0, 1.9, 1.0])
    velocity = np.array([speed * math.cos(yaw), speed * math.sin(yaw), 0.0])
    return GnssFix(
        stamp_of(t_s), *DATUM.to_ellipsoid(*p[:3].tolist()), np.array([0.01, 0.01, 0.02]), velocity, 0.03, math.nan,
        math.nan, GnssSolution.RTK_FIXED, 20, 0.8, 1.0, "GPS",
    )  # fmt: skip


def _truth(t_s: float) -> TrueObjects:
    T_lidar_map = invert(_lidar_pose(t_s))
    turn = math.atan2(T_lidar_map[1, 0], T_lidar_map[0, 0])
    some = []
    for number, (row, v) in sorted(objects_near(t_s).items()):
        label, size = KINDS[_kind(number)]
        center = T_lidar_map[:3, :3] @ np.array([row[0], row[1], 0.5 * size[2]]) + T_lidar_map[:3, 3]
        velocity = T_lidar_map[:2, :2] @ np.array([v, 0.0])
        name = f"{label.value} {number}"
        some.append(TrueObject(number, label, name, center, np.array(size), row[5] + turn, velocity, math.nan))
    return TrueObjects(stamp_of(t_s), tuple(some))


def _kind(number: int) -> str:
    return ("person", "person", "animal", "vehicle")[number % 4]


def objects_near(t_s: float) -> dict[int, tuple[Float64, float]]:
    """Objects about the vehicle by number: box in map (x, y, length, width, height, yaw), and speed along x."""
    nearest = round(motion(t_s)[0] / SPACING_M)
    out = {}
    for number in range(max(0, nearest - 5), max(0, nearest - 5) + OBJECTS):
        size = KINDS[_kind(number)][1]
        x, side = SPACING_M * number, 1.0 if number % 2 else -1.0
        line_y = WEAVE_M * (1.0 - math.cos(x / WEAVE_LENGTH_M))
        away = 3.0 + 1.7 * (number * 7 % 5) if number % 20 else 0.6  # every 20th stands in the path
        if number % 20 == 0 and number * SPACING_M - motion(t_s)[0] < 18.0:
            away = 4.0  # and left it before the vehicle came
        phase = 0.5 * t_s + number
        walk = (0.0 if number % 4 == 3 else 0.8) * math.sin(phase)
        v = 0.0 if number % 4 == 3 else 0.4 * math.cos(phase)
        out[number] = np.array([x + walk, line_y + side * away, *size, 0.0]), v
    return out


def structure_near(x_m: float) -> Float64:
    """Houses and poles about a position, as rows of boxes."""
    rows = []
    for number in range(math.floor(x_m / 12.0) - 6, math.floor(x_m / 12.0) + 8):
        line_y = WEAVE_M * (1.0 - math.cos(12.0 * number / WEAVE_LENGTH_M))
        for side in (-1.0, 1.0):
            rows.append([12.0 * number, line_y + side * (18.0 + number * 5 % 7), 8.0, 6.0, 4.0, 0.1 * (number % 3)])
            rows.append([12.0 * number + 5.0, line_y + side * 7.5, 0.2, 0.2, 3.0, 0.0])
    return np.array(rows)


def _lidar_pose(t_s: float) -> Float64:
    return planar(*motion(t_s)[:3]) @ T_BASE_LIDAR


def _scan(t_s: float, number: int, noise: np.ndarray) -> LidarScan:
    T = _lidar_pose(t_s)
    boxes = np.vstack([structure_near(float(T[0, 3])), [row for row, _ in objects_near(t_s).values()]])
    yaw = math.atan2(T[1, 0], T[0, 0])
    xyz, intensity, column = cast(T[:3, 3], yaw, boxes, ELEVATION_RAD, AZIMUTH_RAD, noise, number * 7919 % 900_000)
    xyz_m: Float32 = (np.round(xyz * GRID_PER_M) / GRID_PER_M).astype(np.float32)
    offset_s = (1e-6 * (column / COLUMNS - 1.0)).astype(np.float32)  # all rays at the stamp, within 1 µs
    no_image, no_angles = np.zeros((0, 0), np.uint16), np.zeros(0)
    return LidarScan(stamp_of(t_s), no_image, no_angles, no_angles, xyz_m, intensity, offset_s)


@kernel
def cast(
    origin: np.ndarray, yaw: float, boxes: np.ndarray, elevation: np.ndarray, azimuth: np.ndarray, noise: np.ndarray,
    first: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Returns (N, 3) in the lidar frame, intensities and columns of rays against level ground and upright boxes."""
    rings, columns = len(elevation), len(azimuth)
    best = np.full((columns, rings), np.inf)
    for ring in range(rings):
        if elevation[ring] < 0.0:
            best[:, ring] = -origin[2] / np.sin(elevation[ring])
    for row in boxes:
        away = np.hypot(row[0] - origin[0], row[1] - origin[1])
        half = np.arcsin(min(1.0, 0.5 * np.hypot(row[2], row[3]) / max(away, 0.1)))
        c, s = np.cos(row[5]), np.sin(row[5])
        ox, oy = origin[0] - row[0], origin[1] - row[1]
        sx, sy = c * ox + s * oy, c * oy - s * ox
        towards = np.arctan2(row[1] - origin[1], row[0] - origin[0]) - yaw
        middle = int(np.round((towards + np.pi) / (2.0 * np.pi) * columns))
        reach = int(half / (2.0 * np.pi) * columns) + 1
        for k in range(middle - reach, middle + reach + 1):
            column = k % columns
            heading = azimuth[column] + yaw - row[5]
            dx, dy = np.cos(heading), np.sin(heading)
            a, b = (-0.5 * row[2] - sx) / dx, (0.5 * row[2] - sx) / dx
            p, q = (-0.5 * row[3] - sy) / dy, (0.5 * row[3] - sy) / dy
            enter, leave = max(min(a, b), min(p, q)), min(max(a, b), max(p, q))
            if enter < leave and enter > 0.0:
                for ring in range(rings):
                    z = origin[2] + enter * np.tan(elevation[ring])
                    if 0.0 < z < row[4]:
                        best[column, ring] = min(best[column, ring], enter / np.cos(elevation[ring]))
    xyz = np.empty((columns * rings, 3), np.float32)
    intensity, at = np.empty(columns * rings, np.uint8), np.empty(columns * rings, np.int32)
    n = 0
    for column in range(columns):
        for ring in range(rings):
            if best[column, ring] < 80.0:
                k = column * rings + ring
                r = best[column, ring] + 0.01 * noise[first + k]
                level = r * np.cos(elevation[ring])
                xyz[n, 0], xyz[n, 1] = level * np.cos(azimuth[column]), level * np.sin(azimuth[column])
                xyz[n, 2] = r * np.sin(elevation[ring])
                intensity[n], at[n] = np.uint8(60.0 + 10.0 * np.tanh(noise[first + k])), column
                n += 1
    return xyz[:n].copy(), intensity[:n].copy(), at[:n].copy()


def _image(rng: np.random.Generator) -> tuple[np.ndarray, bytes]:
    """An image with texture, and its JPEG."""
    coarse = rng.integers(0, 255, (60, 80, 3), np.uint8)
    smooth = cv2.resize(coarse, IMAGE_PX, interpolation=cv2.INTER_CUBIC)
    encoded = cv2.imencode(".jpg", smooth, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
    return np.asarray(cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)), encoded
