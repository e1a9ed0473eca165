"""Point buffers with named fields (ROS, Foxglove, PCD) to scans."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.arrays import Float32, Float64, UInt8
from messages.errors import LogError
from messages.sensors import LidarScan, RadarScan

# field name → (offset in bytes, numpy type)
Fields = Mapping[str, tuple[int, str]]
TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
INTENSITY_FIELDS = ("reflectivity", "intensity", "i")
DOPPLER_FIELDS = ("vrad", "doppler", "doppler_velocity", "range_rate", "radial_velocity", "v_r")
RCS_FIELDS = ("rcs", "RCS", "amplitude", "power", "snr")
# Units of point times (s), a factor of 1000 apart; the duration of a sweep, within a factor of 200, determines one.
UNITS_S = (1e-9, 1e-6, 1e-3, 1.0)
SWEEP_S = (0.005, 1.0)
# A point measured later than the cloud was received by more than this: the stamp is the end of the sweep.
CLOCK_SLACK_S = 0.005
# A cloud received sooner than this after its stamp was received when it was stamped: nothing follows from it.
MIN_LATENCY_S = 0.001
# Farther points are none.
MAX_RANGE_M = 10_000.0


def read_points(fields: Fields, stride: int, count: int, data: bytes) -> npt.NDArray[Any]:
    """A structured array over the buffer; raises LogError when fields, stride, count and bytes do not agree."""
    if stride <= 0 or count < 0:
        raise LogError(f"point cloud of {count} points of {stride} bytes")
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


def returns_of(points: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], Float32]:
    """Points with a return and their coordinates (N, 3), without non-finite ones and those at the origin."""
    with np.errstate(over="ignore", invalid="ignore"):
        xyz_m = np.stack([points[name].astype(np.float32) for name in "xyz"], axis=1)
    farthest_m = np.abs(xyz_m).max(axis=1, initial=0.0)  # NaN where a coordinate is NaN
    is_return = (farthest_m > 0.0) & (farthest_m <= MAX_RANGE_M)
    return points[is_return], xyz_m[is_return]


def scan_of_points(points: npt.NDArray[Any], stamp_ns: int, receive_ns: int | None = None) -> LidarScan:
    """A scan from points, without those that are no returns; the stamp of the scan is the time of the last point.

    Point times count from `stamp_ns` or are absolute, in any of `UNITS_S`. Times after the reception show that the
    stamp is the end of the sweep. Times of another clock count from the last point, which then has the stamp.
    """
    points, xyz_m = returns_of(points)
    offset_s = _offsets(points, stamp_ns)
    last_s = float(offset_s.max()) if len(offset_s) else 0.0
    end_ns = stamp_ns + round(last_s * 1e9)
    if receive_ns is not None and _is_end(stamp_ns, receive_ns, last_s):
        end_ns = stamp_ns
    return list_scan(end_ns, xyz_m, intensity=_intensity(points), offset_s=offset_s - last_s)


def radar_scan_of_points(points: npt.NDArray[Any], stamp_ns: int) -> RadarScan:
    """A radar scan from points with a Doppler field (receding positive); cross-section NaN without such a field."""
    points, xyz_m = returns_of(points)
    names = points.dtype.names or ()
    xyz = xyz_m.astype(np.float64)
    flat_m = np.hypot(xyz[:, 0], xyz[:, 1])
    doppler = points[next(n for n in DOPPLER_FIELDS if n in names)].astype(np.float64)
    rcs = next((points[n].astype(np.float64) for n in RCS_FIELDS if n in names), np.full(len(xyz), np.nan))
    azimuth, elevation = np.arctan2(xyz[:, 1], xyz[:, 0]), np.arctan2(xyz[:, 2], flat_m)
    return RadarScan(stamp_ns, np.hypot(flat_m, xyz[:, 2]), azimuth, elevation, doppler, rcs)


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
    """Seconds of each point against the stamp; empty without times or where they are not plausible."""
    name = next((n for n in TIME_FIELDS if n in (points.dtype.names or ())), None)
    if name is None or len(points) == 0:
        return np.zeros(0)
    raw = points[name][np.isfinite(points[name])]
    if len(raw) < len(points):
        return np.zeros(0)
    is_whole = np.issubdtype(raw.dtype, np.integer)
    first = int(raw.min()) if is_whole else float(raw.min())
    since_first: Float64 = (raw - raw.min()).astype(np.float64)
    span = float(since_first.max())
    unit_s = time_unit_s(span, is_whole)
    if not 0.0 < span * unit_s <= SWEEP_S[1]:  # also without a number
        return np.zeros(0)
    since_first *= unit_s
    if abs(first) * unit_s <= SWEEP_S[1]:
        return since_first + first * unit_s
    begin_s = (first * round(unit_s * 1e9) - stamp_ns) * 1e-9
    return since_first + begin_s if abs(begin_s) <= SWEEP_S[1] else since_first - since_first.max()


def time_unit_s(span: float, is_whole: bool) -> float:
    """Unit (s) of the times of points that span `span` of it: that of a sweep, else ns for whole numbers or s."""
    return next((u for u in UNITS_S if SWEEP_S[0] <= span * u <= SWEEP_S[1]), 1e-9 if is_whole else 1.0)


def _is_end(stamp_ns: int, receive_ns: int, last_s: float) -> bool:
    """Whether points after the stamp were measured after the reception, by clocks that agree."""
    latency_s = (receive_ns - stamp_ns) * 1e-9
    return MIN_LATENCY_S <= latency_s < last_s - CLOCK_SLACK_S


def _intensity(points: npt.NDArray[Any]) -> UInt8:
    """Intensity as 0 to 255; floats up to 1 are taken as shares."""
    name = next((n for n in INTENSITY_FIELDS if n in (points.dtype.names or ())), None)
    if name is None or len(points) == 0:
        return np.zeros(0, np.uint8)
    raw = np.nan_to_num(points[name].astype(np.float64))
    is_share = np.issubdtype(points[name].dtype, np.floating) and raw.max() <= 1.0
    out: UInt8 = np.round(raw * 255.0 if is_share else raw).clip(0, 255).astype(np.uint8)
    return out
