"""OXTS records of KITTI (combined GNSS and IMU) to fixes, IMU samples and odometry, in the frame of the device.

Fields as in KITTI's `dataformat.txt`; axes: x forward, y left, z up; yaw counter-clockwise from east. All speeds are
those of the inertial solution; the car's wheel speeds are not recorded, therefore there is no wheel sample.
"""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from datasets.importers.frame_streams import FrameStream, read_lines
from datasets.importers.recording import Sensor
from geometry.arrays import Float64
from geometry.geodesy import Datum
from geometry.transforms import transform
from messages.errors import LogError
from messages.motion import Odometry
from messages.sensors import GnssFix, GnssSolution, ImuSample

COLUMNS = 30
FRAME = "oxts"
SENSORS = tuple(Sensor(topic, FRAME, "oxts", "oxts") for topic in ("gnss/oxts", "imu/oxts", "odom/oxts"))
# OXTS "position modes": SPS, differential, RTK float and integer, SBAS, OmniSTAR HP and XP; post-processed from 13,
# of OxTS' own engine from 21 (gx) and 26 (ix). Source: support.oxts.com, article 115004221929.
SOLUTIONS = {
    **dict.fromkeys((3, 13, 21, 26), GnssSolution.SINGLE),
    **dict.fromkeys((4, 7, 8, 14, 18, 22, 27), GnssSolution.SBAS),
    **dict.fromkeys((9, 17), GnssSolution.PPP),
    **dict.fromkeys((5, 15, 23, 28), GnssSolution.RTK_FLOAT),
    **dict.fromkeys((6, 16, 24, 29), GnssSolution.RTK_FIXED),
}
# Modes without a velocity or heading of the GNSS receiver: none, search, no data, blanked, not recognized.
NO_MEASUREMENT = (-1, 0, 1, 10, 11, 19)


def read_oxts(line: str, where: str) -> Float64:
    """The 30 numbers of a record; raises LogError."""
    try:
        row = np.array(line.split(), np.float64)
    except ValueError as error:
        raise LogError(f"{where}: {error}") from error
    if len(row) != COLUMNS or not np.isfinite(row).all() or abs(row[0]) > 90.0 or abs(row[1]) > 180.0:
        raise LogError(f"{where}: not an OXTS record of {COLUMNS} numbers: {line[:60]!r}")
    return row


def read_oxts_file(path: Path) -> tuple[dict[int, Float64], tuple[str, ...]]:
    """Records by line (KITTI tracking), and the reasons for lines without one; raises LogError."""
    lines = read_lines(path)
    return _read((n, line, f"{path}:{n + 1}") for n, line in enumerate(lines) if line.strip())


def read_oxts_folder(files: dict[int, Path]) -> tuple[dict[int, Float64], tuple[str, ...]]:
    """Records by frame from one file each (KITTI raw), and the reasons for files without one."""
    lines, reasons = [], []
    for number, path in files.items():
        try:
            lines.append((number, " ".join(read_lines(path)), str(path)))
        except LogError as error:
            reasons.append(str(error))
    rows, others = _read(lines)
    return rows, (*reasons, *others)


def _read(lines: Iterable[tuple[int, str, str]]) -> tuple[dict[int, Float64], tuple[str, ...]]:
    rows, reasons = {}, []
    for number, line, where in lines:
        try:
            rows[number] = read_oxts(line, where)
        except LogError as error:
            reasons.append(str(error))
    return rows, tuple(reasons)


def oxts_stream(rows: dict[int, Float64], stamps: dict[int, int], unread: tuple[str, ...]) -> FrameStream:
    """Fix, sample and odometry of each record; the first is the origin of `odom`."""
    first = next(iter(rows.values()))
    datum = Datum(math.radians(first[0]), math.radians(first[1]), float(first[2]))

    def read(number: int, stamp_ns: int) -> tuple[GnssFix, ImuSample, Odometry]:
        row = rows[number]
        return gnss_fix(row, stamp_ns), imu_sample(row, stamp_ns), odometry(row, stamp_ns, datum)

    return FrameStream(SENSORS, stamps, read, unread)


def gnss_fix(row: Float64, stamp_ns: int) -> GnssFix:
    """Position and velocity of the inertial solution with the receiver's state; one accuracy for all directions.

    Without a measurement of the receiver its velocity or heading is NaN; negative or zero accuracies are unknown.
    """
    satellites, position_mode, velocity_mode, heading_mode = (int(v) for v in row[26:30])
    has_velocity = velocity_mode not in NO_MEASUREMENT
    return GnssFix(
        stamp_ns=stamp_ns,
        latitude_rad=math.radians(row[0]),
        longitude_rad=math.radians(row[1]),
        height_m=float(row[2]),
        sigma_enu_m=np.full(3, _known(row[23])),
        velocity_enu_mps=np.array([row[7], row[6], row[10]]) if has_velocity else np.full(3, np.nan),
        sigma_velocity_mps=_known(row[24]) if has_velocity else math.nan,
        heading_rad=float(row[5]) if heading_mode not in NO_MEASUREMENT else math.nan,
        sigma_heading_rad=math.nan,
        solution=SOLUTIONS.get(position_mode, GnssSolution.NONE),
        satellites=satellites if satellites >= 0 else None,
        hdop=math.nan,
        correction_age_s=math.nan,
        constellations="GPS",
    )


def _known(sigma: float) -> float:
    return float(sigma) if sigma > 0.0 else math.nan


def imu_sample(row: Float64, stamp_ns: int) -> ImuSample:
    """Specific force and angular rate in device axes."""
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
