"""ROS 1 and ROS 2 messages to Headland messages; frames and units of REP-103 on both sides."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from datasets.importers import images
from datasets.importers.captures import ars548
from datasets.importers.images import codec_of_video, decode_image, decode_raw, refusal
from datasets.importers.livox import scan_of_livox
from datasets.importers.point_clouds import (
    DOPPLER_FIELDS,
    Fields,
    list_scan,
    radar_scan_of_points,
    read_points,
    scan_of_points,
)
from datasets.importers.translation import NotRead, Translation
from geometry.arrays import Float64
from messages.errors import LogError
from messages.motion import Odometry
from messages.sensors import (
    CameraImage,
    GnssFix,
    GnssSolution,
    ImuSample,
    LidarScan,
    RadarScan,
    UltrasonicRange,
    WheelSample,
)

# sensor_msgs/PointField
_POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
# sensor_msgs/NavSatStatus
_SERVICES = {4: "BDS", 1: "GPS", 2: "GLONASS", 8: "Galileo"}
# Below this sigma a GBAS solution counts as RTK fixed.
FIXED_SIGMA_M = 0.05
_TO_ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
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


def fields_of_cloud(ros: Any) -> Fields:
    """Fields of a sensor_msgs/PointCloud2 with one number each."""
    order = ">" if ros.is_bigendian else "<"
    known = (f for f in ros.fields if f.datatype in _POINT_TYPES and f.count <= 1)
    return {f.name: (int(f.offset), order + _POINT_TYPES[f.datatype]) for f in known}


def points_of_cloud(ros: Any) -> npt.NDArray[Any]:
    """Points of a sensor_msgs/PointCloud2, also with padded rows; raises LogError."""
    step, width, height, data = int(ros.point_step), int(ros.width), int(ros.height), _bytes(ros)
    row, used = int(ros.row_step), width * step
    if height > 1 and row > used and len(data) >= height * row:
        data = np.frombuffer(data, np.uint8, height * row).reshape(height, row)[:, :used].tobytes()
    return read_points(fields_of_cloud(ros), step, width * height, data)


def scan_of_cloud(ros: Any, receive_ns: int) -> LidarScan:
    """sensor_msgs/PointCloud2 of a lidar."""
    return scan_of_points(points_of_cloud(ros), stamp_of(ros, receive_ns), receive_ns)


def radar_scan_of_cloud(ros: Any, receive_ns: int) -> RadarScan:
    """sensor_msgs/PointCloud2 with a Doppler field."""
    return radar_scan_of_points(points_of_cloud(ros), stamp_of(ros, receive_ns))


def radar_scan(ros: Any, receive_ns: int) -> RadarScan:
    """radar_msgs/RadarScan; Doppler receding positive, cross-section unknown (the amplitude is not calibrated)."""
    rows = [(r.range, r.azimuth, r.elevation, r.doppler_velocity) for r in ros.returns]
    range_m, azimuth, elevation, doppler = _columns(rows, 4)
    return RadarScan(stamp_of(ros, receive_ns), range_m, azimuth, elevation, doppler, np.full(len(rows), np.nan))


def scan_of_packets(ros: Any, receive_ns: int) -> RadarScan:
    """nebula_msgs/NebulaPackets: the detection list of an ARS548; raises LogError for other packets."""
    for packet in ros.packets:
        cycle = ars548.decode_detections(bytes(packet.data))
        if cycle is not None:
            return ars548.to_scan(cycle, cycle.stamp_ns if cycle.is_synchronized else stamp_of(ros, receive_ns))
    raise LogError(f"packets of a device, without a detection list of a {ars548.NAME}")


def ars548_scan(ros: Any, receive_ns: int) -> RadarScan:
    """continental_msgs/ContinentalArs548DetectionList, without detections that the device marks as invalid."""
    rows = [
        (d.range, d.azimuth_angle, math.nan if d.invalid_elevation else d.elevation_angle, d.range_rate, d.rcs)
        for d in ros.detections
        if not (d.invalid_distance or d.invalid_azimuth or d.invalid_range_rate)
    ]
    return RadarScan(stamp_of(ros, receive_ns), *_columns(rows, 5))


def _columns(rows: Sequence[tuple[float, ...]], count: int) -> Float64:
    return np.array(rows, np.float64).reshape(-1, count).T.copy()


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
    """sensor_msgs/Imu, in the IMU's own axes; NaN where its covariance begins with -1, which means not measured."""
    force = NAN3 if ros.linear_acceleration_covariance[0] == -1.0 else vector(ros.linear_acceleration)
    rate = NAN3 if ros.angular_velocity_covariance[0] == -1.0 else vector(ros.angular_velocity)
    return ImuSample(stamp_of(ros, receive_ns), force, rate)


def sigmas_of(covariance: Any) -> Float64:
    """Sigmas (3,) of a covariance (3, 3) in one row; NaN (unknown) for variances that are not positive."""
    variance = np.asarray(covariance, np.float64).reshape(3, 3).diagonal()
    return np.sqrt(np.where(variance > 0.0, variance, np.nan))


def gnss_fix(ros: Any, receive_ns: int) -> GnssFix:
    """sensor_msgs/NavSatFix; unknown values are NaN, the number of satellites None."""
    sigma_m = sigmas_of(ros.position_covariance) if ros.position_covariance_type else NAN3
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
        satellites=None,
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
    """sensor_msgs/CompressedImage in JPEG or PNG."""
    data = _bytes(ros)
    return CameraImage(stamp_of(ros, receive_ns), decode_image(data), data)


def image(ros: Any, receive_ns: int) -> CameraImage:
    """sensor_msgs/Image."""
    bgr = decode_raw(ros.encoding, int(ros.width), int(ros.height), int(ros.step), _bytes(ros), bool(ros.is_bigendian))
    return CameraImage(stamp_of(ros, receive_ns), bgr)


def video_frames() -> Callable[[Any, int], CameraImage]:
    """Translation of one stream of packets: sensor_msgs/CompressedImage or ffmpeg_image_transport_msgs/FFMPEGPacket."""
    return images.video_frames(lambda ros, ns: (_format_of(ros), _bytes(ros), stamp_of(ros, ns)))


def _format_of(ros: Any) -> str:
    return str(getattr(ros, "format", "") or getattr(ros, "encoding", ""))


def _bytes(ros: Any) -> bytes:
    return bytes(np.asarray(ros.data, np.uint8).tobytes())


# ROS type → topic kind and translation
TRANSLATIONS: dict[str, Translation] = {
    "sensor_msgs/msg/PointCloud2": Translation("lidar", scan_of_cloud),
    "sensor_msgs/msg/LaserScan": Translation("lidar", scan_of_laser),
    "livox_ros_driver/msg/CustomMsg": Translation("lidar", scan_of_livox),
    "livox_ros_driver2/msg/CustomMsg": Translation("lidar", scan_of_livox),
    "radar_msgs/msg/RadarScan": Translation("radar", radar_scan),
    "continental_msgs/msg/ContinentalArs548DetectionList": Translation("radar", ars548_scan),
    "nebula_msgs/msg/NebulaPackets": Translation("radar", scan_of_packets),
    "sensor_msgs/msg/Imu": Translation("imu", imu_sample),
    "sensor_msgs/msg/NavSatFix": Translation("gnss", gnss_fix),
    "nav_msgs/msg/Odometry": Translation("odom", odometry),
    "geometry_msgs/msg/TwistStamped": Translation("wheel", wheel_sample),
    "geometry_msgs/msg/TwistWithCovarianceStamped": Translation("wheel", wheel_sample),
    "sensor_msgs/msg/Range": Translation("ultrasonic", ultrasonic_range),
    "sensor_msgs/msg/CompressedImage": Translation("camera", compressed_image),
    "sensor_msgs/msg/Image": Translation("camera", image),
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": Translation("camera", make=video_frames),
}


def translation_of(kind: str, ros: Any) -> Translation:
    """Translation of a stream by its first message, where the type alone does not decide; raises NotRead."""
    if kind == "sensor_msgs/msg/PointCloud2":
        names = fields_of_cloud(ros).keys()
        if not ros.width * ros.height:
            raise LogError("a cloud without points")
        if names & set(DOPPLER_FIELDS):
            return Translation("radar", radar_scan_of_cloud)
        if {"vx", "vy"} <= names:
            raise NotRead("a cloud of objects with velocities (vx, vy), not of returns")
    if kind == "sensor_msgs/msg/CompressedImage" and codec_of_video(ros.format):
        return Translation("camera", make=video_frames)
    if kind in ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image") and refusal(_format_of(ros)):
        raise NotRead(refusal(_format_of(ros)))
    return TRANSLATIONS[kind]


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
