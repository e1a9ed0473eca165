"""IMU and GNSS of a KITTI drive as text tables, as gtsam ships them: `Time dt accelX ...` beside `Time,X,Y,Z`.

The second table is the file beside it with those columns. Its positions are metres east, north and up of an unknown
place; they are put at `PLACE`, near the place of KITTI's drives, whose gravity they need.
"""

import heapq
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from datasets.importers.gnss.fix import fix_of
from datasets.importers.recording import Description, Open, Received, Recording, Sensor, Skipped
from geometry.arrays import Float64
from geometry.geodesy import Datum
from messages.errors import LogError
from messages.sensors import GnssSolution, ImuSample

NAME = "KITTI text tables"
IMU_HEAD, GNSS_HEAD = b"Time dt accelX accelY accelZ omegaX omegaY omegaZ", b"Time,X,Y,Z"
PLACE = Datum(math.radians(49.0), math.radians(8.4), 110.0)
SIGMA_M = 0.07  # IMUKittiExampleGPS of gtsam
FRAME = "oxts"
IMU, GNSS = Sensor("imu", FRAME, "imu", NAME), Sensor("gnss/oxts", FRAME, "gnss", NAME)
NOTES = (
    "GNSS: metres about an unknown place, put at 49.0 deg north, 8.4 deg east",
    f"GNSS: solution unknown, taken as PPP; sigma {SIGMA_M} m as in gtsam's example",
)


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens the table of the IMU."""
    return open_tables if head.startswith(IMU_HEAD) else None


def open_tables(path: Path, _: Path | None = None) -> Recording:
    """The table of the IMU, and that of the fixes beside it if there is one."""
    fixes = next((p for p in sorted(path.parent.glob("*.txt")) if _begins(p, GNSS_HEAD)), None)
    sensors = (IMU,) if fixes is None else (IMU, GNSS)
    notes = NOTES if fixes is not None else (f"no table of fixes ({GNSS_HEAD.decode()}) beside it",)
    about = Description(NAME, sensors, notes=notes, vehicle="kitti_oxts")
    return Recording(path, about, partial(_messages, path, fixes))


def _begins(path: Path, head: bytes) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(head)) == head
    except OSError:
        return False


def _messages(imu: Path, fixes: Path | None) -> Iterator[Received | Skipped]:
    parts = [_samples(imu)] if fixes is None else [_samples(imu), _fixes(fixes)]
    yield from heapq.merge(*parts, key=lambda item: item[0])


def _rows(path: Path, columns: int, separator: str | None, source: str) -> Iterator[Float64 | Skipped]:
    last_ns = 0
    try:
        with path.open(encoding="ascii", errors="replace") as file:
            next(file, None)
            for number, line in enumerate(file, start=2):
                try:
                    row = np.array(line.split(separator), np.float64)
                except ValueError:
                    row = np.zeros(0)
                if len(row) != columns or not np.isfinite(row).all():
                    yield Skipped(last_ns, source, NAME, f"row {number} is not {columns} numbers")
                    continue
                last_ns = round(float(row[0]) * 1e9)
                yield row
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error


def _samples(path: Path) -> Iterator[Received | Skipped]:
    for row in _rows(path, 8, None, IMU.source):
        if isinstance(row, Skipped):
            yield row
            continue
        stamp_ns = round(float(row[0]) * 1e9)
        yield stamp_ns, IMU.topic, ImuSample(stamp_ns, row[2:5].copy(), row[5:8].copy())


def _fixes(path: Path) -> Iterator[Received | Skipped]:
    for row in _rows(path, 4, ",", GNSS.source):
        if isinstance(row, Skipped):
            yield row
            continue
        stamp_ns = round(float(row[0]) * 1e9)
        latitude, longitude, height = PLACE.to_ellipsoid(*row[1:].tolist())
        place = {"latitude_rad": latitude, "longitude_rad": longitude, "height_m": height}
        fix = fix_of({**place, "sigma_enu_m": np.full(3, SIGMA_M), "solution": GnssSolution.PPP}, stamp_ns)
        yield stamp_ns, GNSS.topic, fix
