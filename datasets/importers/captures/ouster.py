"""Ouster lidars OS0, OS1, OS2 and OSDome: lidar and IMU packets, decoded with the metadata of the sensor.

The metadata is a JSON file in the folder of the capture. Of `drive.pcap`, the first one whose packet length and serial
number fit is taken from: `drive.json`; `drive.*.json` and `drive*.json`; files whose name begins the capture's name,
longest first; the only JSON file of the folder.

Points are in the sensor frame of the manual (x forward, away from the connector, y left, z up), computed as in "3D
Transformations": origin of the beams, azimuth and altitude of each beam, lidar to sensor. They are lists, as beams of a
column differ in azimuth and origin. Both returns are kept. The stamp is the time of the last received column.
"""

import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from datasets.importers.captures.clock import SensorClock
from datasets.importers.captures.devices import Decoder, Lost, Stream
from datasets.importers.captures.ouster_format import FUSA, PROFILES, Format, Metadata, read_metadata
from datasets.importers.point_clouds import list_scan
from datasets.importers.recording import Extrinsic
from geometry.arrays import Float32, Float64, Int64, UInt8, UInt32
from messages.errors import LogError
from messages.message import Message
from messages.sensors import ImuSample, LidarScan

IMU, LIDAR = "Ouster IMU", "Ouster lidar"
IMU_SIZE = 48
GRAVITY = 9.80665
# Stamps of one IMU packet differ by less than this.
IMU_SPREAD_NS = 1_000_000_000
LIDAR_PACKET = 1
# Columns of one frame are fired within less than this.
FRAME_NS = 1_000_000_000
# Frames before the current one whose late packets are dropped; an earlier number, or a jump in time, is a restart.
LATE_FRAMES = 8
SIZES: dict[int, list[Format]] = {}
for _profile in PROFILES:
    for _pixels in (16, 32, 64, 128):
        _format = Format(_profile, _pixels, 16, 8192, 8192)
        SIZES.setdefault(_format.dtype.itemsize, []).append(_format)


def recognize(payload: bytes) -> str | None:
    """An IMU packet, or a lidar packet with its size and serial number."""
    if len(payload) == IMU_SIZE:
        return IMU if _is_imu(payload) else None
    for form in SIZES.get(len(payload), ()):
        if _is_lidar(payload, form):
            serial = form.serial(payload)
            return f"{LIDAR}, {len(payload)} bytes" + (f", serial number {serial}" if serial else "")
    return None


def _is_imu(payload: bytes) -> bool:
    times = struct.unpack_from("<QQQ", payload)
    values = np.frombuffer(payload, "<f4", 6, 24)
    is_plausible = bool(np.isfinite(values).all() and np.abs(values[:3]).max() < 100 and np.abs(values).max() < 1e4)
    return is_plausible and max(times) > 0 and max(times[1:]) - min(times[1:]) < IMU_SPREAD_NS


def _is_lidar(payload: bytes, form: Format) -> bool:
    """Whether columns follow each other, at two of three places, and the packet type is that of the profile."""
    if form.profile != "LEGACY" and payload[0] != LIDAR_PACKET:
        return False
    if form.profile not in ("LEGACY", FUSA) and payload[1] != 0:
        return False
    size, last = form.dtype["columns"].base.itemsize, form.columns_per_packet - 1
    first = (0 if form.profile == "LEGACY" else 32) + 8
    starts = [first + k * size for k in (0, last // 2, last - 1)]
    follows = [_number(payload, at + size) == _number(payload, at) + 1 for at in starts]
    return sum(follows) >= 2


def _number(payload: bytes, at: int) -> int:
    return int.from_bytes(payload[at : at + 2], "little")


def open_decoder(stream: Stream, payload: bytes, capture: Path) -> Decoder:
    """The decoder of an IMU or lidar stream; raises LogError without suitable metadata."""
    if stream.model == IMU:
        return OusterImu()
    return OusterLidar(find_metadata(capture, payload))


def find_metadata(capture: Path, payload: bytes) -> Metadata:
    """Metadata for a lidar packet, by the rule of this module; raises LogError naming the files tried."""
    reasons = []
    for path in _candidates(capture):
        try:
            metadata = read_metadata(path)
        except LogError as error:
            reasons.append(str(error).removeprefix(f"{path.parent}/"))
            continue
        size, serial = metadata.format.dtype.itemsize, metadata.format.serial(payload)
        if size != len(payload):
            reasons.append(f"{path.name}: for packets of {size} bytes")
        elif serial is not None and metadata.serial not in ("", serial):
            reasons.append(f"{path.name}: of the sensor {metadata.serial}")
        elif (sent := metadata.format.sent_columns(payload)) != metadata.format.columns_per_frame:
            reasons.append(
                f"{path.name}: columns_per_frame {metadata.format.columns_per_frame}, the packets have {sent}"
            )
        else:
            return metadata
    tried = "; ".join(reasons) or "none found"
    raise LogError(f"needs the metadata of the sensor as {capture.with_suffix('.json').name} beside it ({tried})")


def _candidates(capture: Path) -> list[Path]:
    stem = capture.stem
    files = sorted(capture.parent.glob("*.json"), key=lambda p: (len(p.name), p.name))
    exact = [p for p in files if p.stem == stem]
    dotted = [p for p in files if p.name.startswith(f"{stem}.") and p not in exact]
    longer = [p for p in files if p.stem.startswith(stem) and p not in (*exact, *dotted)]
    shorter = [p for p in reversed(files) if stem.startswith(p.stem) and p not in exact]
    return exact + dotted + longer + shorter or (files if len(files) == 1 else [])


class OusterImu:
    """IMU packets: specific force and angular rate in the IMU frame, at the time of the accelerometer."""

    kind = "imu"
    frame = "os_imu"
    notes: tuple[str, ...] = ()
    extrinsics: tuple[Extrinsic, ...] = ()

    def __init__(self) -> None:
        self._clock = SensorClock()

    def receive(self, payload: bytes, receive_ns: int) -> Iterator[Message | Lost]:
        _, time_ns, _ = struct.unpack_from("<QQQ", payload)
        values = np.frombuffer(payload, "<f4", 6, 24).astype(np.float64)
        stamp_ns = self._clock.stamp_ns(time_ns, receive_ns)
        yield ImuSample(stamp_ns, values[:3] * GRAVITY, values[3:] * (math.pi / 180.0))

    def finish(self) -> Iterator[Message | Lost]:
        yield from ()


class OusterLidar:
    """Frames of one lidar; packets of an earlier frame that come late are refused."""

    kind = "lidar"
    frame = "os_sensor"

    def __init__(self, metadata: Metadata) -> None:
        self.metadata = metadata
        self.notes = (f"{metadata.line or 'Ouster'} with metadata {metadata.path.name}", *self._assumptions())
        imu = metadata.T_sensor_imu
        self.extrinsics: tuple[Extrinsic, ...] = (
            (Extrinsic(self.frame, OusterImu.frame, imu),) if imu is not None else ()
        )
        self._clock = SensorClock()
        self._frame_id: int | None = None
        self._last_ns: int | None = None
        self._receive_ns = 0
        self.columns = self._no_columns()
        directions, offsets = beams(metadata)
        self._directions = directions.reshape(-1, 3).astype(np.float32)
        self._offsets = offsets.reshape(-1, 3).astype(np.float32)

    def _assumptions(self) -> tuple[str, ...]:
        assumed = self.metadata.assumed
        return (f"{self.metadata.path.name} lacks {', '.join(assumed)}: values of the manual",) if assumed else ()

    def _no_columns(self) -> np.ndarray:
        return np.zeros(self.metadata.format.columns_per_frame, self.metadata.format.dtype["columns"].base)

    def receive(self, payload: bytes, receive_ns: int) -> Iterator[Message | Lost]:
        form = self.metadata.format
        columns = form.columns(payload)
        frame_id = form.frame_id(payload)
        valid = columns[columns["status"] & 1 == 1]
        times_ns = valid["timestamp_ns"].astype(np.int64)
        if len(valid) and np.ptp(times_ns) > FRAME_NS:
            raise LogError("times of the columns of a packet differ by more than 1 s")
        is_jump = len(valid) > 0 and self._last_ns is not None and abs(times_ns[0] - self._last_ns) > FRAME_NS
        if self._frame_id is not None and not is_jump and 0 < (self._frame_id - frame_id) % 65_536 <= LATE_FRAMES:
            raise LogError(f"packet of frame {frame_id} after the start of frame {self._frame_id}")
        if frame_id != self._frame_id or is_jump:
            yield from self.finish()
            self._frame_id = frame_id
        self.columns[valid["measurement"]] = valid
        self._last_ns, self._receive_ns = int(times_ns[-1]) if len(valid) else self._last_ns, receive_ns

    def finish(self) -> Iterator[Message | Lost]:
        count = np.count_nonzero(self.columns["status"] & 1)
        if count:
            yield self._scan()
            if count < self.metadata.format.window:
                yield Lost("frame with missing columns")
        self.columns = self._no_columns()

    def _scan(self) -> LidarScan:
        fields = self.metadata.format.fields(self.columns["pixels"])
        time_ns = self.columns["timestamp_ns"].astype(np.int64)
        end_ns = int(time_ns.max())
        parts = [
            self._returns(fields[f"RANGE{n}"], fields[f"REFLECTIVITY{n}"], end_ns - time_ns)
            for n in ("", "2")
            if f"RANGE{n}" in fields
        ]
        xyz_m, intensity, age_ns = (np.concatenate(values) for values in zip(*parts, strict=True))
        stamp_ns = self._clock.stamp_ns(end_ns, self._receive_ns)
        return list_scan(stamp_ns, xyz_m, intensity, age_ns * -1e-9)

    def _returns(self, range_mm: UInt32, reflectivity: UInt32, age_ns: Int64) -> tuple[Float32, UInt8, Int64]:
        """Points (N, 3), reflectivity and age of the returns in images (columns, pixels)."""
        at = np.flatnonzero(range_mm)
        range_m = range_mm.ravel()[at] * np.float32(1e-3)
        xyz_m = self._directions.take(at, axis=0) * range_m[:, None] + self._offsets.take(at, axis=0)
        return xyz_m, reflectivity.ravel()[at].clip(0, 255).astype(np.uint8), age_ns[at // range_mm.shape[1]]


def beams(metadata: Metadata) -> tuple[Float64, Float64]:
    """Direction and offset (columns, pixels, 3) of every measurement in the sensor frame: point = range · d + o."""
    count = metadata.format.columns_per_frame
    encoder = 2.0 * math.pi * (1.0 - np.arange(count) / count)[:, None]
    azimuth = encoder - metadata.azimuth_rad
    altitude = np.broadcast_to(metadata.altitude_rad, azimuth.shape)
    flat = np.cos(altitude)
    directions = np.stack([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(altitude)], axis=-1)
    T = metadata.T_lidar_beam
    origin = np.stack([np.cos(encoder) * T[0, 3], np.sin(encoder) * T[0, 3], np.full_like(encoder, T[2, 3])], axis=-1)
    offsets = origin - directions * math.hypot(T[0, 3], T[2, 3])
    R, t = metadata.T_sensor_lidar[:3, :3], metadata.T_sensor_lidar[:3, 3]
    return directions @ R.T, offsets @ R.T + t
