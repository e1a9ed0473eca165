"""Ouster lidar packets: layouts of the UDP profiles, and metadata of the sensor (flat and nested JSON).

All values are little-endian. Source: Ouster sensor documentation, chapter "Sensor Data".
"""

import json
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.arrays import Float64
from messages.errors import LogError

# field of a pixel → (32-bit word, mask, shift to the left in mm or counts)
Layout = dict[str, tuple[int, int, int]]
_FULL: Layout = {"RANGE": (0, 0x7FFFF, 0), "REFLECTIVITY": (0, 0xFF000000, -24)}
_FULL_2: Layout = {"RANGE2": (1, 0x7FFFF, 0), "REFLECTIVITY2": (1, 0xFF000000, -24)}
_LOW: Layout = {"RANGE": (0, 0x7FFF, 3), "REFLECTIVITY": (0, 0xFF0000, -16)}
_LOW_2: Layout = {"RANGE2": (1, 0x7FFF, 3), "REFLECTIVITY2": (1, 0xFF0000, -16)}
_SINGLE: Layout = {"RANGE": (0, 0x7FFFF, 0), "REFLECTIVITY": (1, 0xFF, 0)}
# UDP profile → (words per pixel, fields)
PROFILES: dict[str, tuple[int, Layout]] = {
    "LEGACY": (3, {"RANGE": (0, 0xFFFFF, 0), "REFLECTIVITY": (1, 0xFFFF, 0)}),
    "RNG19_RFL8_SIG16_NIR16": (3, _SINGLE),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": (3, _SINGLE),
    "RNG19_RFL8_SIG16_NIR16_DUAL": (4, _FULL | _FULL_2),
    "FIVE_WORD_PIXEL": (5, _FULL | _FULL_2),
    "RNG15_RFL8_NIR8": (1, _LOW),
    "RNG15_RFL8_WIN8": (1, _LOW),
    "RNG15_RFL8_NIR8_ZONE16": (2, _LOW),
    "RNG15_RFL8_NIR8_DUAL": (2, _LOW | _LOW_2),
    "FUSA_RNG15_RFL8_NIR8_DUAL": (2, _LOW | _LOW_2),
}
ENCODER = 90_112  # counts of a turn
FUSA = "FUSA_RNG15_RFL8_NIR8_DUAL"
# Distance (mm) from the axis of rotation to the origin of the beams, for metadata without it: by product line.
BEAM_ORIGIN_MM = {"OS-0": 27.67, "OS-1": 15.806, "OS-2": 13.762}
FIRST_GENERATION_MM = 12.163
LIDAR_TO_SENSOR_MM = (-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1)


@dataclass(frozen=True)
class Format:
    """Layout of the lidar packets of one sensor; it sends `window` of the columns of a frame."""

    profile: str
    pixels: int
    columns_per_packet: int
    columns_per_frame: int
    window: int

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """One packet: header, columns, footer."""
        words, is_legacy = PROFILES[self.profile][0], self.profile == "LEGACY"
        pixels = ("pixels", "<u4", (self.pixels, words))
        head: list[Any] = [("timestamp_ns", "<u8"), ("measurement", "<u2")]
        if is_legacy:
            column = [*head, ("frame", "<u2"), ("encoder", "<u4"), pixels, ("status", "<u4")]
            return np.dtype([("columns", column, self.columns_per_packet)])
        column = [*head, ("status", "<u2"), pixels]
        return np.dtype([("header", "V32"), ("columns", column, self.columns_per_packet), ("footer", "V32")])

    def columns(self, payload: bytes) -> npt.NDArray[Any]:
        """The columns of a packet (columns_per_packet,); raises LogError for another length or content."""
        if len(payload) != self.dtype.itemsize:
            raise LogError(f"lidar packet of {len(payload)} bytes instead of {self.dtype.itemsize}")
        columns: npt.NDArray[Any] = np.frombuffer(payload, self.dtype)[0]["columns"]
        if int(columns["measurement"].max()) >= self.columns_per_frame:
            raise LogError(f"column {columns['measurement'].max()} of {self.columns_per_frame}")
        return columns

    def sent_columns(self, payload: bytes) -> int:
        """Columns of a turn by the encoder, which only packets of the legacy profile have; else `columns_per_frame`."""
        if self.profile != "LEGACY":
            return self.columns_per_frame
        columns = np.frombuffer(payload, self.dtype)[0]["columns"]
        counts, numbers = (np.diff(columns[name].astype(np.int64)) for name in ("encoder", "measurement"))
        is_next = (counts > 0) & (numbers == 1)
        return round(ENCODER / float(np.median(counts[is_next]))) if is_next.any() else self.columns_per_frame

    def frame_id(self, payload: bytes) -> int:
        """Number of the frame, which wraps at 65536."""
        start, size = {"LEGACY": (10, 2), FUSA: (4, 4)}.get(self.profile, (2, 2))
        return int.from_bytes(payload[start : start + size], "little") & 0xFFFF

    def serial(self, payload: bytes) -> str | None:
        """Serial number of the sensor; None in the legacy profile."""
        if self.profile == "LEGACY":
            return None
        start = 11 if self.profile == FUSA else 7
        return str(int.from_bytes(payload[start : start + 5], "little"))

    def fields(self, pixels: npt.NDArray[np.uint32]) -> dict[str, npt.NDArray[np.uint32]]:
        """Fields of pixels (..., words) by name; ranges in mm."""
        out = {}
        for name, (word, mask, shift) in PROFILES[self.profile][1].items():
            value = pixels[..., word] & np.uint32(mask)
            out[name] = value << np.uint32(shift) if shift >= 0 else value >> np.uint32(-shift)
        return out


@dataclass(frozen=True, eq=False)
class Metadata:
    """Description of one sensor: packet format, beams and mounts; lengths in m, angles in rad.

    `T_lidar_beam` (4, 4) is the beam origin at encoder angle 0, `T_sensor_lidar` and `T_sensor_imu` (4, 4) are poses in
    the sensor frame (x forward, y left, z up); `assumed` names values that the file does not contain.
    """

    path: Path
    line: str
    serial: str
    format: Format
    azimuth_rad: Float64
    altitude_rad: Float64
    T_lidar_beam: Float64
    T_sensor_lidar: Float64
    T_sensor_imu: Float64 | None
    assumed: tuple[str, ...]


def read_metadata(path: Path) -> Metadata:
    """Metadata as written by the sensor or ouster-sdk, flat (firmware before 2.1) or nested; raises LogError."""
    try:
        nested = json.loads(path.read_text(encoding="utf-8"))
        flat = dict(nested)
        for key in ("sensor_info", "beam_intrinsics", "imu_intrinsics", "lidar_intrinsics", "config_params"):
            flat |= nested.get(key) or {}
        return _metadata(path, flat)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise LogError(f"{path}: is no metadata of an Ouster sensor ({error!r})") from error


def _metadata(path: Path, values: dict[str, Any]) -> Metadata:
    line = str(values.get("prod_line", ""))
    altitude, azimuth = _angles(values, "beam_altitude_angles"), _angles(values, "beam_azimuth_angles")
    assumed: list[str] = []
    form = _format(values, len(altitude), assumed)
    if not len(altitude) == len(azimuth) == form.pixels > 0:
        raise ValueError(f"{len(altitude)} altitude and {len(azimuth)} azimuth angles for {form.pixels} pixels")
    if "beam_to_lidar_transform" in values:
        T_beam = _pose(values["beam_to_lidar_transform"])
    else:
        T_beam = np.eye(4)
        origin = values.get("lidar_origin_to_beam_origin_mm")
        if origin is None:
            origin = BEAM_ORIGIN_MM.get(line[:4], FIRST_GENERATION_MM)
            assumed.append(f"lidar_origin_to_beam_origin_mm {origin}")
        T_beam[0, 3] = float(origin) * 1e-3
    if "lidar_to_sensor_transform" not in values:
        assumed.append("lidar_to_sensor_transform")
    T_lidar = _pose(values.get("lidar_to_sensor_transform", LIDAR_TO_SENSOR_MM))
    imu = values.get("imu_to_sensor_transform")
    T_imu = _pose(imu) if imu is not None else None
    serial = str(values.get("prod_sn", ""))
    return Metadata(path, line, serial, form, azimuth, altitude, T_beam, T_lidar, T_imu, tuple(assumed))


def _format(values: dict[str, Any], beams: int, assumed: list[str]) -> Format:
    """Packet format; sensors without a description of it send the legacy profile."""
    form = values.get("lidar_data_format") or values.get("data_format")
    if form is None:
        assumed.append("packet format LEGACY")
        form = {"pixels_per_column": beams, "columns_per_packet": 16,
                "columns_per_frame": int(str(values["lidar_mode"]).partition("x")[0])}  # fmt: skip
    profile = str(form.get("udp_profile_lidar", "LEGACY"))
    if profile not in PROFILES:
        raise ValueError(f"UDP profile {profile} is not one of {', '.join(PROFILES)}")
    pixels, packet, frame = (int(form[k]) for k in ("pixels_per_column", "columns_per_packet", "columns_per_frame"))
    if not (0 < pixels <= 256 and 0 < packet <= 64 and 0 < frame <= 8192):
        raise ValueError(f"{pixels} pixels, {packet} columns per packet and {frame} per frame")
    first, last = form.get("column_window") or (0, frame - 1)
    return Format(profile, pixels, packet, frame, (int(last) - int(first)) % frame + 1)


def _angles(values: dict[str, Any], key: str) -> Float64:
    angles = np.array(values[key], np.float64)
    if angles.ndim != 1 or not np.isfinite(angles).all():
        raise ValueError(f"{key} is no list of angles")
    return angles * (math.pi / 180.0)


def _pose(values: Any) -> Float64:
    """A pose from 16 values in mm, row by row."""
    T: Float64 = np.array(values, np.float64).reshape(4, 4)
    if not np.isfinite(T).all():
        raise ValueError("a transform is not finite")
    T[:3, 3] *= 1e-3
    return T
