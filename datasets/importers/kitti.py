"""KITTI drives: tracking, raw and packed frames, and plain folders of velodyne scans.

Frame of the lidar: `velodyne`; of the GNSS/IMU unit: `oxts`; of the images: their folder, such as `image_02`. Without
time stamps the time of a frame is its number at 10 Hz, taken as the end of its scan.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from datasets.importers import kitti_oxts as oxts
from datasets.importers.camera_files import image_files
from datasets.importers.frame_streams import (
    NO_TIMES,
    FolderContents,
    FrameStream,
    Times,
    nominal_times,
    numbered_files,
    read_times,
    unread_entries,
)
from datasets.importers.kitti_calibration import (
    RAW_FILES,
    Calibration,
    add_camera,
    read_calibration,
    read_raw_calibration,
)
from datasets.importers.kitti_labels import read_labels, true_objects
from datasets.importers.kitti_scans import (
    LIDAR_FRAME,
    TRUTH_TOPIC,
    add_scans,
    has_frames,
    is_packed,
    read_bin,
    read_packed,
)
from datasets.importers.recording import Ignored, Open, Recording, Sensor
from geometry.arrays import Float64
from messages.errors import LogError

NAME = "KITTI folder"
TAKES_LABELS = True
VEHICLE = "kitti_car"  # configs/vehicles/; recorded all of KITTI but plain velodyne folders
VIEW_DEG = 40.0  # labelled half angle: the view of the camera
PLAIN = "kitti velodyne"
CAMERAS = (2, 3, 0, 1)  # colour first
# Files in which packed frames are looked for.
PROBED = 5
T = TypeVar("T")


@dataclass
class Drive(FolderContents):
    """Files of one drive, named as its folder; `stamps` are those of the scans."""

    stamps: dict[int, int] = field(default_factory=dict)
    calibration: Calibration | None = None
    label_file: Path | None = None

    def add_oxts(self, rows: dict[int, Float64], stamps: dict[int, int], unread: tuple[str, ...], path: Path) -> None:
        """Adds the GNSS/IMU unit; without a single record its file is ignored."""
        if rows:
            self.streams.append(oxts.oxts_stream(rows, stamps, unread))
        elif unread:
            self.ignored.append(Ignored(str(path), "oxts", unread[0], len(unread)))

    def optional(self, path: Path, kind: str, read: Callable[[], T]) -> T | None:
        """Result of `read`, or None where the file cannot be read, which is then ignored with the reason."""
        try:
            return read()
        except LogError as error:
            self.ignored.append(Ignored(str(path), kind, str(error)))
            return None


def open_kitti(path: Path, truth: Path | None = None) -> Recording:
    """Any KITTI drive; `truth` is a label file, or a folder that holds one and its calibration. Raises LogError.

    Labels of the drive itself that cannot be read are ignored with the reason.
    """
    drive = _find_drive(path)
    labels: FrameStream | None = None
    if truth is not None:
        label_file, calibration = find_truth(truth, drive.path.name)
        labels = _labels(label_file, calibration, drive.stamps)
        drive.calibration = drive.calibration or calibration
    elif (own := drive.label_file) is not None:
        labels = drive.optional(own, "labels", lambda: _labels(own, drive.calibration, drive.stamps))
    if labels is not None:
        drive.streams.insert(1, labels)  # after the scan of the same time
    if drive.calibration is not None:
        drive.extrinsics[:0] = drive.calibration.extrinsics(LIDAR_FRAME, oxts.FRAME)
    is_plain = drive.format == PLAIN
    drive.path = path
    return drive.recording(
        LIDAR_FRAME if labels is not None else None, 180.0 if is_plain else VIEW_DEG, None if is_plain else VEHICLE
    )


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a folder with a KITTI layout."""
    if not path.is_dir():
        return None
    if _is_raw(path) or _tracking_root(path) is not None:
        return open_kitti
    return open_kitti if any(map(is_packed, _packed_files(path)[:PROBED])) or _bin_files(path) else None


def find_truth(truth: Path, name: str) -> tuple[Path, Calibration]:
    """Label file and calibration below a folder, of several sequences those of `name`; raises LogError."""
    files = [truth] if truth.is_file() else sorted(p for p in truth.glob("**/label*/*.txt") if p.stem.isdigit())
    chosen = [p for p in files if p.stem == name] or files
    if len(chosen) != 1:
        some = ", ".join(str(p.relative_to(truth)) for p in chosen[:5]) or "none"
        raise LogError(f"{truth}: needs one label file ({some} found); name the file itself")
    roots = [truth] if truth.is_dir() else list(truth.parents)[:5]
    for root in roots:
        for calibration in sorted(root.glob(f"**/calib*/{chosen[0].name}")):
            return chosen[0], read_calibration(calibration)
    raise LogError(f"{truth}: no calibration (calib/{chosen[0].name}) for the labels")


def _labels(path: Path, calibration: Calibration | None, stamps: dict[int, int]) -> FrameStream:
    """True objects at the stamps of the scans; raises LogError."""
    if calibration is None:
        raise LogError(f"{path}: labels without a calibration; boxes cannot be transformed to the lidar")
    file, T_camera_lidar = read_labels(path), calibration.T_camera_lidar
    sensor = Sensor(TRUTH_TOPIC, LIDAR_FRAME, str(path), "labels")
    return FrameStream((sensor,), stamps, lambda n, ns: (true_objects(file.of_frame(n), ns, T_camera_lidar),))


def _find_drive(path: Path) -> Drive:
    if _is_raw(path):
        return _raw(path)
    root = _tracking_root(path)
    if root is not None:
        return _tracking(path, root)
    packed = _packed_files(path)
    is_plain = not any(map(is_packed, packed[:PROBED]))
    files = numbered_files(_bin_files(path) if is_plain else packed)
    if not files[0]:
        raise LogError(f"{path}: no scan whose name is its number")
    drive = Drive(path, PLAIN if is_plain else "kitti packed", notes=[NO_TIMES], stamps=nominal_times(files[0]))
    add_scans(drive, files, (drive.stamps, ()), read_bin if is_plain else read_packed)
    folder = next(iter(files[0].values())).parent
    drive.ignored += unread_entries(folder, (p.name for p in folder.glob("*.bin" if is_plain else "*.npz")))
    return drive


def _is_raw(path: Path) -> bool:
    return any((path / name / "data").is_dir() for name in ("velodyne_points", *(f"image_{k:02d}" for k in CAMERAS)))


def _raw(path: Path) -> Drive:
    drive, points, unit = Drive(path, "kitti raw"), path / "velodyne_points", path / "oxts"
    date = path if (path / "calib_cam_to_cam.txt").is_file() else path.parent
    drive.calibration = drive.optional(date, "calibration", lambda: read_raw_calibration(date))
    if drive.calibration is None:
        drive.notes.append("no calibration (calib_*.txt) beside the drive")
    scans = numbered_files((points / "data").glob("*.bin"))
    end = points / "timestamps_end.txt"
    drive.stamps, untimed = _times(end if end.is_file() else points / "timestamps.txt", scans[0])
    add_scans(drive, scans, (drive.stamps, untimed))
    files, unnumbered = numbered_files((unit / "data").glob("*.txt"))
    rows, bad = oxts.read_oxts_folder(files)
    stamps, untimed = _times(unit / "timestamps.txt", rows)
    drive.add_oxts(rows, stamps, (*unnumbered, *bad, *untimed), unit)
    for k in CAMERAS:
        images = image_files(path / f"image_{k:02d}" / "data")
        add_camera(drive, k, images, _times(path / f"image_{k:02d}" / "timestamps.txt", images[0]), drive.calibration)
    known = ("velodyne_points", "oxts", *(f"image_{k:02d}" for k in CAMERAS), *RAW_FILES)
    drive.ignored += unread_entries(path, known)
    return drive


def _times(path: Path, frames: dict[int, T]) -> Times:
    """Stamps of the frames and reasons for those without; of a file that cannot be read the same reason for all."""
    try:
        return read_times(path, frames) if frames else ({}, ())
    except LogError as error:
        return {}, (str(error),) * len(frames)


def _tracking_root(path: Path) -> Path | None:
    """The `training` or `testing` folder for a tracking sequence or its root."""
    for root in (path, path / "training", path / "testing", path.parent.parent):
        if (root / "calib").is_dir() and _sequences(root):
            return root
    return None


def _sequences(root: Path) -> list[Path]:
    return sorted(p for p in (root / "velodyne").glob("*") if p.is_dir() and not p.suffix)


def _tracking(path: Path, root: Path) -> Drive:
    is_one = path.parent == root / "velodyne"
    folders = [path] if is_one else _sequences(root)
    if len(folders) != 1:
        some = ", ".join(f.name for f in folders[:5]) or "none"
        raise LogError(f"{root / 'velodyne'}: {len(folders)} sequences ({some}); name one of them")
    (folder,) = folders
    scans, name = numbered_files(folder.glob("*.bin")), f"{folder.name}.txt"
    drive = Drive(folder, "kitti tracking", notes=[NO_TIMES], stamps=nominal_times(scans[0]))
    add_scans(drive, scans, (drive.stamps, ()))
    calib, unit, labels = root / "calib" / name, root / "oxts" / name, root / "label_02" / name
    if calib.is_file():
        drive.calibration = drive.optional(calib, "calibration", lambda: read_calibration(calib))
    found = drive.optional(unit, "oxts", lambda: oxts.read_oxts_file(unit)) if unit.is_file() else None
    if found is not None:
        rows, unread = found
        drive.add_oxts(rows, nominal_times(rows), unread, unit)
    drive.label_file = labels if labels.is_file() else None
    for k in CAMERAS:
        images = image_files(root / f"image_{k:02d}" / folder.name)
        add_camera(drive, k, images, (nominal_times(images[0]), ()), drive.calibration)
    return drive


def _packed_files(path: Path) -> list[Path]:
    return sorted((path / "frames" if (path / "frames").is_dir() else path).glob("*.npz"))


def _bin_files(path: Path) -> list[Path]:
    if has_frames(path):
        return []
    for folder in (path, path / "velodyne", path / "data"):
        if files := sorted(folder.glob("*.bin")):
            return files
    return []
