"""Point buffers with named fields (ROS, Foxglove, PCD) to scans."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.arrays import Float32, Float64, UInt8
from messages.errors import LogError
from messages.sensors import LidarScan

# field name → (offset in bytes, numpy type)
Fields = Mapping[str, tuple[int, str]]
TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
INTENSITY_FIELDS = ("intensity", "reflectivity", "i")
# A larger spread means that the unit of the time field is unknown: it is ignored.
MAX_SWEEP_S = 1.0


def read_points(fields: Fields, stride: int, count: int, data: bytes) -> npt.NDArray[Any]:
    """A structured array over the buffer; raises LogError when fields, stride, count and bytes do not agree."""
    for name in "xyz":
        if name not in fields:
            raise LogError(f"point cloud without field {name!r} (it has {', '.join(fields) or 'none'})")
    for name, (offset, kind) in fields.items():
        if offset < 0 or offset + np.dtype(kind).itemsize > stride:
            raise LogError(f"point cloud field {name!r} at byte {offset} lies outside a point of {stride} bytes")
    if len(data) < count * stride:
        raise LogError(f"point cloud of {count} points of {stride} bytes holds {len(data)} bytes only")
    layout = {
        "names": list(fields),
        "formats": [kind for _, kind in fields.values()],
        "offsets": [offset for offset, _ in fields.values()],
        "itemsize": stride,
    }
    return np.frombuffer(data, np.dtype(layout), count)  # type: ignore[call-overload]


def scan_of_points(points: npt.NDArray[Any], stamp_ns: int) -> LidarScan:
    """A scan from points, without non-finite ones; point times, if any, count from `stamp_ns` or are absolute.

    The stamp of the scan is the time of the last point.
    """
    xyz_m = np.stack([points[name].astype(np.float32) for name in "xyz"], axis=1)
    is_finite = np.isfinite(xyz_m).all(axis=1)
    points, xyz_m = points[is_finite], xyz_m[is_finite]
    offset_s = _offsets(points, stamp_ns)
    last_s = float(offset_s.max()) if len(offset_s) else 0.0
    return list_scan(stamp_ns + round(last_s * 1e9), xyz_m, intensity=_intensity(points), offset_s=(offset_s - last_s))


def list_scan(
    stamp_ns: int,
    xyz_m: Float32,
    intensity: UInt8 | None = None,
    offset_s: npt.NDArray[np.floating] | None = None,
) -> LidarScan:
    """A scan as a list of points (N, 3)."""
    return LidarScan(
        stamp_ns=stamp_ns,
        ranges_mm=np.zeros((0, 0), np.uint16),
        elevation_rad=np.zeros(0),
        azimuth_rad=np.zeros(0),
        xyz_m=np.ascontiguousarray(xyz_m, np.float32),
        intensity=np.zeros(0, np.uint8) if intensity is None else intensity,
        offset_s=np.zeros(0, np.float32) if offset_s is None else offset_s.astype(np.float32),
    )


def _offsets(points: npt.NDArray[Any], stamp_ns: int) -> Float64:
    """Seconds of each point against the stamp: integers are nanoseconds, floats seconds; empty without times."""
    name = next((n for n in TIME_FIELDS if n in (points.dtype.names or ())), None)
    if name is None or len(points) == 0:
        return np.zeros(0)
    raw = points[name]
    time_s: Float64 = raw * 1e-9 if np.issubdtype(raw.dtype, np.integer) else raw.astype(np.float64)
    if time_s.max() > 1e6:
        time_s = time_s - stamp_ns * 1e-9
    is_plausible = np.isfinite(time_s).all() and np.abs(time_s).max() <= MAX_SWEEP_S
    return time_s if is_plausible else np.zeros(0)


def _intensity(points: npt.NDArray[Any]) -> UInt8:
    """Intensity as 0 to 255; floats up to 1 are taken as shares."""
    name = next((n for n in INTENSITY_FIELDS if n in (points.dtype.names or ())), None)
    if name is None or len(points) == 0:
        return np.zeros(0, np.uint8)
    raw = np.nan_to_num(points[name].astype(np.float64))
    is_share = np.issubdtype(points[name].dtype, np.floating) and raw.max() <= 1.0
    out: UInt8 = np.round(raw * 255.0 if is_share else raw).clip(0, 255).astype(np.uint8)
    return out
