"""ROS 1 and ROS 2 messages to Headland messages; frames and units of REP-103 on both sides."""

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from datasets.importers.point_clouds import list_scan, read_points, scan_of_points
from geometry.arrays import Float64
from messages.errors import LogError
from messages.message import Message
from messages.motion import Odometry
from messages.sensors import CameraImage, GnssFix, GnssSolution, ImuSample, LidarScan, UltrasonicRange, WheelSample

# sensor_msgs/PointField
_POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
# sensor_msgs/NavSatStatus
_SERVICES = {4: "BDS", 1: "GPS", 2: "GLONASS", 8: "Galileo"}
# Below this sigma a GBAS solution counts as RTK fixed.
FIXED_SIGMA_M = 0.05
_TO_ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
_COLORS = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "mono8": cv2.COLOR_GRAY2BGR,
}
NAN3 = np.full(3, np.nan)


def stamp_of(ros: Any, receive_ns: int) -> int:
    """Stamp of the header, or receive time without one."""
    stamp = ros.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec) or receive_ns


def vector(v: Any) -> Float64:
    """x, y and z of a Vector3 or Point."""
    return np.array([v.x, v.y, v.z], np.float64)


def pose_matrix(position: Any, q: Any) -> Float64:
    """Pose (4, 4) of a position and a quaternion; raises LogError for a zero quaternion."""
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    try:
        T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    except ValueError as error:
        raise LogError(f"orientation ({q.x}, {q.y}, {q.z}, {q.w}) is no rotation") from error
    T[:3, 3] = position.x, position.y, position.z
    return T


def scan_of_cloud(ros: Any, receive_ns: int) -> LidarScan:
    """sensor_msgs/PointCloud2."""
    order = ">" if ros.is_bigendian else "<"
    fields = {
        f.name: (int(f.offset), order + _POINT_TYPES[f.datatype])
        for f in ros.fields
        if f.datatype in _POINT_TYPES and f.count <= 1
    }
    count = int(ros.width) * int(ros.height)
    points = read_points(fields, int(ros.point_step), count, _bytes(ros))
    return scan_of_points(points, stamp_of(ros, receive_ns))


def scan_of_laser(ros: Any, receive_ns: int) -> LidarScan:
    """sensor_msgs/LaserScan: one horizontal ring."""
    range_m = np.asarray(ros.ranges, np.float64)
    angle = ros.angle_min + np.arange(len(range_m)) * ros.angle_increment
    offset_s = np.arange(len(range_m)) * float(ros.time_increment)
    is_finite = np.isfinite(range_m) & (range_m >= ros.range_min) & (range_m <= ros.range_max)
    flat = np.stack([range_m * np.cos(angle), range_m * np.sin(angle), np.zeros_like(range_m)], axis=1)[is_finite]
    last_s = float(offset_s[-1]) if len(offset_s) else 0.0
    stamp_ns = stamp_of(ros, receive_ns) + round(last_s * 1e9)
    return list_scan(stamp_ns, flat.astype(np.float32), offset_s=offset_s[is_finite] - last_s)


def imu_sample(ros: Any, receive_ns: int) -> ImuSample:
    """sensor_msgs/Imu, in the IMU's own axes."""
    return ImuSample(stamp_of(ros, receive_ns), vector(ros.linear_acceleration), vector(ros.angular_velocity))


def gnss_fix(ros: Any, receive_ns: int) -> GnssFix:
    """sensor_msgs/NavSatFix; missing values are NaN, the number of satellites -1."""
    variance = np.asarray(ros.position_covariance, np.float64).reshape(3, 3).diagonal()
    sigma_m = np.sqrt(variance) if ros.position_covariance_type else NAN3
    solution = {-1: GnssSolution.NONE, 0: GnssSolution.SINGLE, 1: GnssSolution.SBAS}.get(ros.status.status)
    if solution is None:
        solution = GnssSolution.RTK_FIXED if max(sigma_m[:2]) <= FIXED_SIGMA_M else GnssSolution.RTK_FLOAT
    return GnssFix(
        stamp_ns=stamp_of(ros, receive_ns),
        latitude_rad=math.radians(ros.latitude),
        longitude_rad=math.radians(ros.longitude),
        height_m=float(ros.altitude),
        sigma_enu_m=np.array(sigma_m),
        velocity_enu_mps=NAN3.copy(),
        sigma_velocity_mps=math.nan,
        heading_rad=math.nan,
        sigma_heading_rad=math.nan,
        solution=solution,
        satellites=-1,
        hdop=math.nan,
        correction_age_s=math.nan,
        constellations="+".join(name for bit, name in _SERVICES.items() if ros.status.service & bit),
    )


def odometry(ros: Any, receive_ns: int) -> Odometry:
    """nav_msgs/Odometry; covariance: that of the twist over one second."""
    twist = ros.twist.twist
    speed, turn = float(twist.linear.x), float(twist.angular.z)
    spread = np.asarray(ros.twist.covariance, np.float64).reshape(6, 6)
    return Odometry(
        stamp_ns=stamp_of(ros, receive_ns),
        T_odom_base=pose_matrix(ros.pose.pose.position, ros.pose.pose.orientation),
        speed_mps=speed,
        lateral_mps=float(twist.linear.y),
        acceleration_mps2=math.nan,
        yaw_rate_radps=turn,
        curvature_radpm=turn / speed if abs(speed) > 0.1 else math.nan,
        covariance=spread[np.ix_(_TO_ROTATION_FIRST, _TO_ROTATION_FIRST)],
    )


def wheel_sample(ros: Any, receive_ns: int) -> WheelSample:
    """geometry_msgs/TwistStamped: forward speed, no steering angle."""
    twist = ros.twist.twist if hasattr(ros.twist, "twist") else ros.twist
    return WheelSample(stamp_of(ros, receive_ns), float(twist.linear.x), math.nan)


def ultrasonic_range(ros: Any, receive_ns: int) -> UltrasonicRange:
    """sensor_msgs/Range; NaN outside its limits."""
    is_echo = ros.min_range <= ros.range <= ros.max_range
    return UltrasonicRange(stamp_of(ros, receive_ns), float(ros.range) if is_echo else math.nan)


def compressed_image(ros: Any, receive_ns: int) -> CameraImage:
    """sensor_msgs/CompressedImage."""
    data = _bytes(ros)
    return CameraImage(stamp_of(ros, receive_ns), decode_image(data), data)


def decode_image(data: bytes) -> Any:
    """JPEG or PNG to BGR; raises LogError."""
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if bgr is None:
        raise LogError(f"image of {len(data)} bytes is neither JPEG nor PNG (it begins with {data[:8]!r})")
    return bgr


def image(ros: Any, receive_ns: int) -> CameraImage:
    """sensor_msgs/Image with 8 bits per channel."""
    channels = {"bgr8": 3, "rgb8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}.get(ros.encoding)
    if channels is None:
        raise LogError(f"image encoding {ros.encoding!r} is not one of bgr8, rgb8, rgba8, bgra8, mono8")
    height, width, data = int(ros.height), int(ros.width), _bytes(ros)
    if len(data) < height * int(ros.step) or int(ros.step) < width * channels:
        raise LogError(f"image of {width} x {height} with {ros.step} bytes per row holds {len(data)} bytes only")
    rows = np.frombuffer(data, np.uint8, height * int(ros.step)).reshape(height, -1)[:, : width * channels]
    pixels = rows.reshape(height, width, channels)
    color = _COLORS.get(ros.encoding)
    bgr = pixels.copy() if color is None else cv2.cvtColor(pixels, color)
    return CameraImage(stamp_of(ros, receive_ns), np.asarray(bgr, np.uint8))


def _bytes(ros: Any) -> bytes:
    return bytes(np.asarray(ros.data, np.uint8).tobytes())


# ROS type → topic kind and translation
TRANSLATIONS: dict[str, tuple[str, Callable[[Any, int], Message]]] = {
    "sensor_msgs/msg/PointCloud2": ("lidar", scan_of_cloud),
    "sensor_msgs/msg/LaserScan": ("lidar", scan_of_laser),
    "sensor_msgs/msg/Imu": ("imu", imu_sample),
    "sensor_msgs/msg/NavSatFix": ("gnss", gnss_fix),
    "nav_msgs/msg/Odometry": ("odom", odometry),
    "geometry_msgs/msg/TwistStamped": ("wheel", wheel_sample),
    "geometry_msgs/msg/TwistWithCovarianceStamped": ("wheel", wheel_sample),
    "sensor_msgs/msg/Range": ("ultrasonic", ultrasonic_range),
    "sensor_msgs/msg/CompressedImage": ("camera", compressed_image),
    "sensor_msgs/msg/Image": ("camera", image),
}
TRANSFORMS = "tf2_msgs/msg/TFMessage"


def frame_of(ros: Any) -> str:
    """Frame of the data of a message; of odometry the child frame."""
    frame = getattr(ros, "child_frame_id", "") or ros.header.frame_id
    return str(frame).lstrip("/")


def edges_of(ros: Any) -> list[tuple[str, str, Float64]]:
    """(parent, child, pose) of each transform of a TFMessage."""
    return [
        (
            t.header.frame_id.lstrip("/"),
            t.child_frame_id.lstrip("/"),
            pose_matrix(t.transform.translation, t.transform.rotation),
        )
        for t in ros.transforms
    ]
