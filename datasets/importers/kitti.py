"""KITTI folders: tracking, raw and packed frames, and plain folders of velodyne scans.

Frame of the lidar: `velodyne`; of the GNSS/IMU unit: `oxts`. Without time stamps the time of a frame is its number at
10 Hz, taken as the end of its scan.
"""

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from datasets.importers import kitti_labels as labels
from datasets.importers import kitti_oxts as oxts
from datasets.importers.kitti_scans import is_packed, nominal_times, numbered_files, read_bin, read_packed, read_times
from datasets.importers.recording import Description, Extrinsic, Open, Received, Recording, Sensor
from geometry.arrays import Float64
from messages.errors import LogError
from messages.sensors import LidarScan

NAME = "KITTI folder"
TAKES_LABELS = True
VEHICLE = "kitti_car"  # configs/vehicles/; recorded all of KITTI but plain velodyne folders
VIEW_DEG = 40.0  # labelled half angle: the view of the camera
LIDAR_TOPIC = "lidar/velodyne"
LIDAR_FRAME = "velodyne"
OXTS_FRAME = "oxts"
TRUTH_TOPIC = f"truth_objects/{LIDAR_FRAME}"
NO_TIMES = "no time stamps: the time of a frame is its number at 10 Hz, the rate of KITTI"
PLAIN = "kitti velodyne"


@dataclass(frozen=True)
class Sequence:
    """Files of one drive; `times` maps frame numbers to stamps (ns)."""

    path: Path
    format: str
    scans: dict[int, Path]
    read_scan: Callable[[Path, int], LidarScan]
    times: dict[int, int]
    oxts: dict[int, Float64] = field(default_factory=dict)
    oxts_times: dict[int, int] = field(default_factory=dict)
    calibration: labels.Calibration | None = None
    label_file: Path | None = None
    notes: tuple[str, ...] = ()


def open_kitti(path: Path, truth: Path | None = None) -> Recording:
    """Any KITTI folder; `truth` is a label file, or a folder that holds one and its calibration. Raises LogError."""
    sequence = _find_sequence(path)
    label_file, calibration = sequence.label_file, sequence.calibration
    if truth is not None:
        label_file, calibration = find_truth(truth, sequence.path.name)
    by_frame: dict[int, list[labels.Label]] = {}
    if label_file is not None:
        for label in labels.read_labels(label_file):
            by_frame.setdefault(label.frame, []).append(label)
        if calibration is None:
            raise LogError(f"{label_file}: labels without a calibration; boxes cannot be transformed to the lidar")
    description = _describe(sequence, calibration, label_file)
    T_camera_lidar = calibration.T_camera_lidar if calibration is not None and label_file is not None else None
    return Recording(path, description, lambda: _read(sequence, by_frame, T_camera_lidar))


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a folder with a KITTI layout."""
    if not path.is_dir():
        return None
    if (path / "velodyne_points" / "data").is_dir() or _tracking_root(path) is not None:
        return open_kitti
    packed = _packed_files(path)
    return open_kitti if (packed and is_packed(packed[0])) or _bin_files(path) else None


def find_truth(truth: Path, name: str) -> tuple[Path, labels.Calibration]:
    """Label file and calibration below a folder, of several sequences those of `name`; raises LogError."""
    files = [truth] if truth.is_file() else sorted(p for p in truth.glob("**/label*/*.txt") if p.stem.isdigit())
    chosen = [p for p in files if p.stem == name] or files
    if len(chosen) != 1:
        some = ", ".join(p.name for p in chosen[:5]) or "none"
        raise LogError(f"{truth}: needs one label file ({some} found); name the file itself")
    roots = [truth] if truth.is_dir() else list(truth.parents)[:5]
    for root in roots:
        for calibration in sorted(root.glob(f"**/calib*/{chosen[0].name}")):
            return chosen[0], labels.read_calibration(calibration)
    raise LogError(f"{truth}: no calibration (calib/{chosen[0].name}) for the labels")


def _describe(sequence: Sequence, calibration: labels.Calibration | None, label_file: Path | None) -> Description:
    sensors = [Sensor(LIDAR_TOPIC, LIDAR_FRAME, str(next(iter(sequence.scans.values())).parent), sequence.format)]
    if sequence.oxts:
        sensors += [Sensor(topic, OXTS_FRAME, "oxts", "oxts") for topic in oxts.TOPICS]
    if label_file is not None:
        sensors.append(Sensor(TRUTH_TOPIC, LIDAR_FRAME, str(label_file), "labels"))
    mounts = []
    if calibration is not None:
        mounts.append(Extrinsic("camera", LIDAR_FRAME, calibration.T_camera_lidar))
        mounts.append(Extrinsic(LIDAR_FRAME, OXTS_FRAME, calibration.T_lidar_imu))
    truth_frame = LIDAR_FRAME if label_file is not None else None
    vehicle = None if sequence.format == PLAIN else VEHICLE
    view_deg = 180.0 if sequence.format == PLAIN else VIEW_DEG
    return Description(
        sequence.format, tuple(sensors), tuple(mounts), (), truth_frame, sequence.notes, view_deg, vehicle
    )


def _read(
    sequence: Sequence, by_frame: dict[int, list[labels.Label]], T_camera_lidar: Float64 | None
) -> Iterator[Received]:
    """Scans with truth, and OXTS records, in time order."""
    return heapq.merge(_scans(sequence, by_frame, T_camera_lidar), _oxts(sequence), key=lambda r: r[0])


def _scans(
    sequence: Sequence, by_frame: dict[int, list[labels.Label]], T_camera_lidar: Float64 | None
) -> Iterator[Received]:
    for number, path in sequence.scans.items():
        stamp_ns = sequence.times[number]
        yield stamp_ns, LIDAR_TOPIC, sequence.read_scan(path, stamp_ns)
        if T_camera_lidar is not None:
            truth = labels.true_objects(by_frame.get(number, []), stamp_ns, T_camera_lidar)
            yield stamp_ns, TRUTH_TOPIC, truth


def _oxts(sequence: Sequence) -> Iterator[Received]:
    rows = sequence.oxts
    if rows:
        datum = oxts.datum_of(next(iter(rows.values())))
        for number, row in rows.items():
            yield from oxts.oxts_messages(row, sequence.oxts_times[number], datum)


def _find_sequence(path: Path) -> Sequence:
    if (path / "velodyne_points" / "data").is_dir():
        return _raw(path)
    root = _tracking_root(path)
    if root is not None:
        return _tracking(path, root)
    packed = _packed_files(path)
    if packed:
        scans = numbered_files(packed)
        return Sequence(path, "kitti packed", scans, read_packed, nominal_times(scans), notes=(NO_TIMES,))
    scans = numbered_files(_bin_files(path))
    return Sequence(path, PLAIN, scans, read_bin, nominal_times(scans), notes=(NO_TIMES,))


def _raw(path: Path) -> Sequence:
    points, unit = path / "velodyne_points", path / "oxts"
    scans = numbered_files(sorted((points / "data").glob("*.bin")))
    if not scans:
        raise LogError(f"{points / 'data'}: no scans (*.bin)")
    end = points / "timestamps_end.txt"
    times = read_times(end if end.is_file() else points / "timestamps.txt", scans)
    files = numbered_files(sorted((unit / "data").glob("*.txt")))
    rows = dict(zip(files, oxts.read_oxts_folder(list(files.values())), strict=True))
    unit_times = read_times(unit / "timestamps.txt", files) if files else {}
    calibration = labels.read_raw_calibration(path.parent) or labels.read_raw_calibration(path)
    notes = () if calibration is not None else ("no calibration (calib_*.txt) beside the drive",)
    return Sequence(path, "kitti raw", scans, read_bin, times, rows, unit_times, calibration, None, notes)


def _tracking_root(path: Path) -> Path | None:
    """The `training` or `testing` folder for a tracking sequence or its root."""
    for root in (path, path / "training", path / "testing", path.parent.parent):
        if (root / "velodyne").is_dir() and (root / "calib").is_dir():
            return root
    return None


def _tracking(path: Path, root: Path) -> Sequence:
    folders = (
        [path] if path.parent == root / "velodyne" else sorted(p for p in (root / "velodyne").iterdir() if p.is_dir())
    )
    if len(folders) != 1:
        some = ", ".join(f.name for f in folders[:5]) or "none"
        raise LogError(f"{root / 'velodyne'}: {len(folders)} sequences ({some}); name one of them")
    (folder,) = folders
    scans, name = numbered_files(sorted(folder.glob("*.bin"))), f"{folder.name}.txt"
    if not scans:
        raise LogError(f"{folder}: no scans (*.bin)")
    unit, label_file = root / "oxts" / name, root / "label_02" / name
    rows = dict(enumerate(oxts.read_oxts_file(unit))) if unit.is_file() else {}
    calibration = labels.read_calibration(root / "calib" / name) if (root / "calib" / name).is_file() else None
    found = label_file if label_file.is_file() else None
    return Sequence(
        folder,
        "kitti tracking",
        scans,
        read_bin,
        nominal_times(scans),
        rows,
        nominal_times(rows),
        calibration,
        found,
        (NO_TIMES,),
    )


def _packed_files(path: Path) -> list[Path]:
    return sorted((path / "frames" if (path / "frames").is_dir() else path).glob("*.npz"))


def _bin_files(path: Path) -> list[Path]:
    for folder in (path, path / "velodyne", path / "data"):
        if files := sorted(folder.glob("*.bin")):
            return files
    return []
