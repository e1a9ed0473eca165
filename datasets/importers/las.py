"""LAS files (ASPRS, versions 1.0 to 1.4), read by laspy; LAZ only where one of its decoders is installed.

GPS time becomes the stamp as it is: seconds of the week, or with the "adjusted standard" bit seconds since 1980 without
leap seconds. Intensities above 255 are taken as shares of 16 bits (ASPRS: normalized).
"""

import io
import struct
from pathlib import Path

import laspy
import numpy as np
from laspy.errors import LaspyException

from datasets.importers.point_clouds import SWEEP_S
from datasets.importers.point_files import DAMAGED, PointFormat, Points
from datasets.importers.recording import read_head
from messages.errors import LogError

NAME = "LAS"
MAGIC = b"LASF"
# Sizes of the shortest header and of that of a variable length record, place of "offset to point data" (bytes).
MIN_HEADER, RECORD_HEADER, OFFSET_AT = 227, 54, 96
ADJUSTED_S = 1e9  # subtracted from GPS seconds in files with "adjusted standard" time
GPS_TIME = "times are GPS time (of the week, or since 1980-01-06 without leap seconds)"


def read_las(data: bytes) -> Points:
    """Points with x, y, z, intensity and, for those of one sweep, the time since the first point.

    Raises one of `DAMAGED`.
    """
    _check_header(data, len(data))
    try:
        with laspy.open(io.BytesIO(data), read_evlrs=False) as reader:
            header = reader.header
            if header.are_points_compressed and not laspy.LazBackend.detect_available():
                raise LogError("LAZ needs a decoder that is not installed (lazrs or laszip): convert it to LAS")
            size = header.point_count * header.point_format.size
            if not header.are_points_compressed and header.offset_to_point_data + size > len(data):
                raise LogError(f"{header.point_count} points of {header.point_format.size} bytes in {len(data)} bytes")
            las = reader.read()
    except LaspyException as error:
        raise LogError(str(error)) from error
    has_time = "gps_time" in header.point_format.dimension_names and len(las.points) > 0
    has_time = has_time and float(np.ptp(las.gps_time)) <= SWEEP_S[1]  # not of a survey
    fields = [("x", "f8"), ("y", "f8"), ("z", "f8"), ("intensity", "u1"), *([("time", "f8")] if has_time else [])]
    points = np.empty(len(las.points), fields)
    for name in "xyz":
        points[name] = getattr(las, name)
    intensity = np.asarray(las.intensity)
    points["intensity"] = intensity >> 8 if len(points) and intensity.max() > 255 else intensity
    if has_time:
        points["time"] = np.asarray(las.gps_time) - las.gps_time[0]
    return points


def begin_ns(path: Path) -> int | None:
    """GPS time of the first point; None without times or for a file that cannot be read."""
    try:
        _check_header(read_head(path), path.stat().st_size)
        with laspy.open(path, read_evlrs=False) as reader:
            header = reader.header
            if header.are_points_compressed or "gps_time" not in header.point_format.dimension_names:
                return None
            time_s = float(reader.read_points(1).gps_time[0])
            is_adjusted = header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
            ns = round((time_s + (ADJUSTED_S if is_adjusted else 0.0)) * 1e9)
    except (*DAMAGED, OSError, LaspyException):
        return None
    return ns if 0 <= ns < 2**62 else None


def _check_header(head: bytes, size: int) -> None:
    """Raises LogError if the records that the header announces before the points cannot be in a file of this size."""
    if len(head) < MIN_HEADER:
        raise LogError(f"{size} bytes are no header")
    points_at, records = struct.unpack_from("<II", head, OFFSET_AT)
    if points_at > size or records * RECORD_HEADER > points_at:
        raise LogError(f"{records} records before the points at byte {points_at} of {size}")


FORMAT = PointFormat("las", (".las", ".laz"), lambda head: head.startswith(MAGIC), read_las, begin_ns, (GPS_TIME,))
sniff = FORMAT.sniff
