"""Segments of comma2k19: arrays of a car's GNSS, IMU and wheel speeds (axes of the device: forward, right, down).

Source: github.com/commaai/comma2k19, "Log format". The true poses in `global_pose/` are no part of the recording:
`localize --truth SEGMENT/global_pose` reads them.
"""

import heapq
import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from datasets.importers.gnss.fix import NAN3, fix_of
from datasets.importers.recording import Description, Ignored, Open, Received, Recording, Sensor
from geometry.arrays import Float64
from messages.errors import LogError
from messages.message import Message
from messages.sensors import GnssFix, GnssSolution, ImuSample, WheelSample

NAME = "comma2k19"
FOLDER = "processed_log"
GNSS, ACCELERATION, RATE, WHEELS = "GNSS/live_gnss_ublox", "IMU/accelerometer", "IMU/gyro", "CAN/wheel_speed"
DEVICE = "device"
SENSORS = (
    Sensor("gnss/ublox", DEVICE, GNSS, NAME),
    Sensor("imu", DEVICE, "IMU", NAME),
    Sensor("wheel", "base", WHEELS, NAME),
)
UNREAD = "GNSS/live_gnss_qcom", "GNSS/raw_gnss_ublox", "CAN/radar", "CAN/steering_angle", "IMU/magnetometer"
NOTES = (
    "times are those since the device was started; fixes are stamped by their UTC, shifted to the shortest delay",
    "steering angle: that of the steering wheel, not used",
)


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens the folder of a segment."""
    is_segment = path.is_dir() and any((path / FOLDER / name / "t").is_file() for name in (GNSS, ACCELERATION, WHEELS))
    return open_segment if is_segment else None


def open_segment(path: Path, _: Path | None = None) -> Recording:
    """The streams of a segment that exist; raises LogError for an array that is damaged, or without any stream."""
    streams, sensors = [], []
    for sensor, read in zip(SENSORS, (_fixes, _samples, _wheels), strict=True):
        if (stream := read(path / FOLDER)) is not None:
            streams.append((sensor.topic, *stream))
            sensors.append(sensor)
    if not streams:
        raise LogError(f"{path}: {NAME} without {GNSS}, {ACCELERATION} or {WHEELS}")
    ignored = [Ignored(n, NAME, "arrays of this kind are not read") for n in UNREAD if (path / FOLDER / n).is_dir()]
    about = Description(NAME, tuple(sensors), ignored=tuple(ignored), notes=NOTES, vehicle="comma2k19_car")
    return Recording(path, about, partial(_messages, streams))


Stream = tuple[Float64, Callable[[int], Message]]  # receive times (N,), and the message by row


def _messages(streams: list[tuple[str, Float64, Callable[[int], Message]]]) -> Iterator[Received]:
    parts = [_rows(*stream) for stream in streams]
    yield from heapq.merge(*parts, key=lambda row: row[0])


def _rows(topic: str, times_s: Float64, read: Callable[[int], Message]) -> Iterator[Received]:
    for row in np.argsort(times_s, kind="stable").tolist():
        yield _ns(times_s[row]), topic, read(row)


def _ns(time_s: float) -> int:
    return round(float(time_s) * 1e9)


def read_array(path: Path) -> Float64:
    """An array of numbers without a suffix; raises LogError."""
    try:
        return np.asarray(np.load(path, allow_pickle=False), np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise LogError(f"{path}: not an array of numbers ({error})") from error


def _pair(folder: Path, name: str, columns: int) -> tuple[Float64, Float64] | None:
    """Times (N,) and values (N, columns or more), None without the stream; raises LogError."""
    if not (folder / name / "t").is_file():
        return None
    times, values = read_array(folder / name / "t"), read_array(folder / name / "value")
    if times.ndim != 1 or values.ndim != 2 or len(times) != len(values) or values.shape[1] < columns:
        raise LogError(f"{folder / name}: times {times.shape} and values {values.shape} do not fit")
    is_real = np.isfinite(times)
    return times[is_real], values[is_real]


def _fixes(folder: Path) -> Stream | None:
    """Fixes: latitude and longitude (deg), speed, UTC (ms), height, bearing (deg)."""
    if (pair := _pair(folder, GNSS, 6)) is None or not len(pair[0]):
        return None
    times, values = pair
    utc = values[:, 3] * 1e-3
    stamps = utc + float(np.nanmin(times - utc))

    def read(row: int) -> GnssFix:
        latitude, longitude, speed, _, height, bearing = values[row, :6].tolist()
        east, north = speed * math.sin(math.radians(bearing)), speed * math.cos(math.radians(bearing))
        is_place = abs(latitude) <= 90.0 and abs(longitude) <= 180.0
        place = {"latitude_rad": math.radians(latitude), "longitude_rad": math.radians(longitude), "height_m": height}
        solution = GnssSolution.SINGLE if is_place and math.isfinite(height) else GnssSolution.NONE
        velocity = np.array([east, north, NAN3[0]])
        stamp = stamps[row] if math.isfinite(stamps[row]) else times[row]
        return fix_of({**place, "velocity_enu_mps": velocity, "solution": solution}, _ns(stamp))

    return times, read


def _samples(folder: Path) -> Stream | None:
    acceleration, rate = _pair(folder, ACCELERATION, 3), _pair(folder, RATE, 3)
    if acceleration is None or rate is None:
        return None
    times, force = acceleration
    order = np.argsort(rate[0], kind="stable")
    turn = np.column_stack([np.interp(times, rate[0][order], rate[1][order, k]) for k in range(3)])
    return times, lambda row: ImuSample(_ns(times[row]), force[row, :3].copy(), turn[row].copy())


def _wheels(folder: Path) -> Stream | None:
    """Mean of the rear wheels, whose axle is base; the speeds have no sign."""
    if (pair := _pair(folder, WHEELS, 4)) is None:
        return None
    times, speeds = pair
    return times, lambda row: WheelSample(_ns(times[row]), float(speeds[row, 2:4].mean()), math.nan)
