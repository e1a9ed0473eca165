"""OXTS records of KITTI (combined GNSS and IMU) to fixes, IMU samples and odometry, in the frame of the device.

Fields as in KITTI's `dataformat.txt`; axes: x forward, y left, z up; yaw counter-clockwise from east.
"""

import math
from pathlib import Path

import numpy as np

from datasets.importers.recording import Received
from geometry.arrays import Float64
from geometry.geodesy import Datum
from geometry.transforms import transform
from messages.errors import LogError
from messages.motion import Odometry
from messages.sensors import GnssFix, GnssSolution, ImuSample

COLUMNS = 30
TOPICS = ("gnss/oxts", "imu/oxts", "odom/oxts")
# OXTS "position mode": 3 SPS, 4 differential, 5 RTK float, 6 RTK integer, 7 WAAS, 8 to 10 OmniSTAR
SOLUTIONS = {
    **dict.fromkeys((0, 1, 2), GnssSolution.NONE),
    **dict.fromkeys((4, 7), GnssSolution.SBAS),
    5: GnssSolution.RTK_FLOAT,
    6: GnssSolution.RTK_FIXED,
    **dict.fromkeys((8, 9, 10), GnssSolution.PPP),
}


def read_oxts(line: str, where: str) -> Float64:
    """The 30 numbers of a record; raises LogError."""
    try:
        row = np.array(line.split(), np.float64)
    except ValueError as error:
        raise LogError(f"{where}: {error}") from error
    if len(row) != COLUMNS or not np.isfinite(row).all() or abs(row[0]) > 90.0:
        raise LogError(f"{where}: not an OXTS record of {COLUMNS} numbers: {line[:60]!r}")
    return row


def datum_of(row: Float64) -> Datum:
    """Position of a record as origin of `odom`."""
    return Datum(math.radians(row[0]), math.radians(row[1]), float(row[2]))


def oxts_messages(row: Float64, stamp_ns: int, datum: Datum) -> list[Received]:
    """Fix, sample and odometry of one record."""
    messages = (gnss_fix(row, stamp_ns), imu_sample(row, stamp_ns), odometry(row, stamp_ns, datum))
    return [(stamp_ns, topic, message) for topic, message in zip(TOPICS, messages, strict=True)]


def gnss_fix(row: Float64, stamp_ns: int) -> GnssFix:
    """GNSS fix; one accuracy for all directions, no heading accuracy."""
    return GnssFix(
        stamp_ns=stamp_ns,
        latitude_rad=math.radians(row[0]),
        longitude_rad=math.radians(row[1]),
        height_m=float(row[2]),
        sigma_enu_m=np.full(3, row[23]),
        velocity_enu_mps=np.array([row[7], row[6], row[10]]),
        sigma_velocity_mps=float(row[24]),
        heading_rad=float(row[5]),
        sigma_heading_rad=math.nan,
        solution=SOLUTIONS.get(int(row[27]), GnssSolution.SINGLE),
        satellites=int(row[26]),
        hdop=math.nan,
        correction_age_s=math.nan,
        constellations="GPS",
    )


def imu_sample(row: Float64, stamp_ns: int) -> ImuSample:
    """Acceleration and rate in device axes."""
    return ImuSample(stamp_ns, row[11:14].copy(), row[17:20].copy())


def odometry(row: Float64, stamp_ns: int, datum: Datum) -> Odometry:
    """Pose in `odom` (east, north, up from the first record) and motion; covariance NaN."""
    p_m = datum.to_map(math.radians(row[0]), math.radians(row[1]), float(row[2]))
    speed, turn = float(row[8]), float(row[22])
    return Odometry(
        stamp_ns=stamp_ns,
        T_odom_base=transform(p_m, row[3:6]),
        speed_mps=speed,
        lateral_mps=float(row[9]),
        acceleration_mps2=float(row[14]),
        yaw_rate_radps=turn,
        curvature_radpm=turn / speed if abs(speed) > 0.1 else math.nan,
        covariance=np.full((6, 6), np.nan),
    )


def read_oxts_folder(files: list[Path]) -> list[Float64]:
    """One record per file (KITTI raw)."""
    return [read_oxts(_text(path).strip(), str(path)) for path in files]


def read_oxts_file(path: Path) -> list[Float64]:
    """One record per line (KITTI tracking)."""
    return [read_oxts(line, f"{path}:{n}") for n, line in enumerate(_text(path).splitlines(), start=1) if line.strip()]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: cannot be read ({error})") from error
