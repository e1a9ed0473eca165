"""Livox point lists, `CustomMsg` of livox_ros_driver and livox_ros_driver2, from their serialized bytes.

A list has up to 100,000 points of 19 bytes: offset_time (ns from the header's stamp), x, y, z, reflectivity, tag, line.
"""

import struct
from types import SimpleNamespace
from typing import Any

from datasets.importers.point_clouds import read_points, scan_of_points
from messages.errors import LogError
from messages.sensors import LidarScan

TYPES = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg")
POINT_BYTES = 19


def decode_ros1(data: bytes) -> Any:
    """A list in the serialization of ROS 1; raises struct.error or LogError."""
    _, seconds, nanoseconds, length = struct.unpack_from("<4I", data)
    at = 16 + length
    *_, count = struct.unpack_from("<QI4BI", data, at)
    return _list((seconds, nanoseconds), data[16:at], data[at + 20 :], count, POINT_BYTES, "<")


def decode_cdr(data: bytes) -> Any:
    """A list in CDR; raises struct.error or LogError."""
    order = "<" if data[1:2] == b"\1" else ">"
    body = data[4:]
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", body)
    at = -(-(12 + length) // 8) * 8  # the time base is aligned to 8 bytes
    *_, count = struct.unpack_from(f"{order}QI4BI", body, at)
    stride = POINT_BYTES + 1  # each point is aligned to 4 bytes
    return _list((seconds, nanoseconds), body[12 : 12 + length], body[at + 20 :] + b"\0", count, stride, order)


def scan_of_livox(ros: Any, receive_ns: int) -> LidarScan:
    """A decoded list as a scan."""
    stamp = ros.header.stamp
    return scan_of_points(ros.points, stamp.sec * 1_000_000_000 + stamp.nanosec or receive_ns, receive_ns)


def _list(stamp: tuple[int, int], frame: bytes, data: bytes, count: int, stride: int, order: str) -> Any:
    if count * stride > len(data):
        raise LogError(f"list of {count} points holds {len(data)} bytes only")
    fields = {name: (4 * k, f"{order}f4") for k, name in enumerate("xyz", 1)}
    fields |= {"offset_time": (0, f"{order}u4"), "reflectivity": (16, "u1")}
    header = SimpleNamespace(
        stamp=SimpleNamespace(sec=stamp[0], nanosec=stamp[1]), frame_id=frame.rstrip(b"\0").decode("utf-8", "replace")
    )
    return SimpleNamespace(header=header, points=read_points(fields, stride, count, data))
