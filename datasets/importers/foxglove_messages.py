"""Foxglove messages in protobuf or JSON to Headland messages."""

import base64
import binascii
import json
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from datasets.importers import images
from datasets.importers.images import decode_image, decode_raw, refusal
from datasets.importers.point_clouds import DOPPLER_FIELDS, list_scan, read_points, scan_of_points
from datasets.importers.ros_messages import FIXED_SIGMA_M, NAN3, pose_matrix, sigmas_of
from datasets.importers.translation import NotRead, Translation
from geometry.arrays import Float64
from geometry.transforms import apply
from messages.errors import LogError
from messages.sensors import CameraImage, GnssFix, GnssSolution, LidarScan

# foxglove.PackedElementField.NumericType
_POINT_TYPES = {1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<f4", 8: "<f8"}


def from_json(data: bytes) -> Any:
    """A JSON message as an object with the attributes of its protobuf form; raises LogError."""
    try:
        out = json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))
        stamp = getattr(out, "timestamp", None)
        if stamp is not None:
            out.timestamp = SimpleNamespace(seconds=stamp.sec, nanos=stamp.nsec)
        if isinstance(getattr(out, "data", None), str):
            out.data = base64.b64decode(out.data, validate=True)
    except (ValueError, AttributeError, TypeError, binascii.Error) as error:
        raise LogError(f"not a Foxglove message in JSON ({error})") from error
    return out


def stamp_of(proto: Any, receive_ns: int) -> int:
    """Stamp of the message, or receive time without one."""
    return int(proto.timestamp.seconds) * 1_000_000_000 + int(proto.timestamp.nanos) or receive_ns


def scan_of_cloud(proto: Any, receive_ns: int) -> LidarScan:
    """foxglove.PointCloud, points transformed by its pose."""
    fields = {f.name: (int(f.offset), _POINT_TYPES[f.type]) for f in proto.fields if f.type in _POINT_TYPES}
    stride = int(proto.point_stride)
    points = read_points(fields, stride, len(proto.data) // max(stride, 1), proto.data)
    scan = scan_of_points(points, stamp_of(proto, receive_ns), receive_ns)
    T = _pose_of(proto)
    if np.array_equal(T, np.eye(4)):
        return scan
    return list_scan(scan.stamp_ns, np.asarray(apply(T, scan.xyz_m), np.float32), scan.intensity, scan.offset_s)


def _pose_of(proto: Any) -> Float64:
    pose = getattr(proto, "pose", None)
    if pose is None or not any((pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w)):
        return np.eye(4)
    return pose_matrix(pose.position, pose.orientation)


def gnss_fix(proto: Any, receive_ns: int) -> GnssFix:
    """foxglove.LocationFix; RTK fixed when its sigma is that small, since it has no solution type."""
    sigma_m = sigmas_of(list(proto.position_covariance)) if proto.position_covariance_type else NAN3
    is_fixed = bool(max(sigma_m[:2]) <= FIXED_SIGMA_M)
    return GnssFix(
        stamp_ns=stamp_of(proto, receive_ns),
        latitude_rad=math.radians(proto.latitude),
        longitude_rad=math.radians(proto.longitude),
        height_m=float(proto.altitude),
        sigma_enu_m=np.array(sigma_m),
        velocity_enu_mps=NAN3.copy(),
        sigma_velocity_mps=math.nan,
        heading_rad=math.nan,
        sigma_heading_rad=math.nan,
        solution=GnssSolution.RTK_FIXED if is_fixed else GnssSolution.SINGLE,
        satellites=None,
        hdop=math.nan,
        correction_age_s=math.nan,
        constellations="",
    )


def compressed_image(proto: Any, receive_ns: int) -> CameraImage:
    """foxglove.CompressedImage."""
    return CameraImage(stamp_of(proto, receive_ns), decode_image(proto.data), bytes(proto.data))


def raw_image(proto: Any, receive_ns: int) -> CameraImage:
    """foxglove.RawImage."""
    bgr = decode_raw(proto.encoding, int(proto.width), int(proto.height), int(proto.step), bytes(proto.data))
    return CameraImage(stamp_of(proto, receive_ns), bgr)


def video_frames() -> Callable[[Any, int], CameraImage]:
    """Translation of one stream of foxglove.CompressedVideo."""
    return images.video_frames(lambda proto, ns: (proto.format, bytes(proto.data), stamp_of(proto, ns)))


TRANSLATIONS: dict[str, Translation] = {
    "foxglove.PointCloud": Translation("lidar", scan_of_cloud),
    "foxglove.LocationFix": Translation("gnss", gnss_fix),
    "foxglove.CompressedImage": Translation("camera", compressed_image),
    "foxglove.RawImage": Translation("camera", raw_image),
    "foxglove.CompressedVideo": Translation("camera", make=video_frames),
}


def translation_of(kind: str, proto: Any) -> Translation:
    """Translation of a stream by its first message; raises NotRead."""
    if kind == "foxglove.RawImage" and refusal(proto.encoding):
        raise NotRead(refusal(proto.encoding))
    if kind == "foxglove.PointCloud" and {f.name for f in proto.fields} & set(DOPPLER_FIELDS):
        raise NotRead("a cloud of a radar: read from sensor_msgs/PointCloud2 only")
    return TRANSLATIONS[kind]


TRANSFORMS = {"foxglove.FrameTransform", "foxglove.FrameTransforms"}


def frame_of(proto: Any) -> str:
    """Frame of the data of a message."""
    return str(proto.frame_id)


def edges_of(proto: Any) -> list[tuple[str, str, Float64]]:
    """(parent, child, pose) of each transform."""
    some = proto.transforms if hasattr(proto, "transforms") else (proto,)
    return [(t.parent_frame_id, t.child_frame_id, pose_matrix(t.translation, t.rotation)) for t in some]
