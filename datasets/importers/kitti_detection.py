"""KITTI detection (object) folders: independent frames with boxes.

The frames are in no order of time: they are set 10 s apart, so that no motion is derived between them.
"""

from collections.abc import Iterable
from pathlib import Path

from datasets.importers.frame_streams import FolderContents, nominal_times, numbered_files, unread_entries
from datasets.importers.kitti import VEHICLE, VIEW_DEG
from datasets.importers.kitti_frames import add_images, add_truth, common_calibration
from datasets.importers.kitti_oxts import FRAME as OXTS_FRAME
from datasets.importers.kitti_scans import LIDAR_FRAME, add_scans, has_frames
from datasets.importers.recording import Open, Recording

NAME = "KITTI detection folder"
PERIOD_NS = 10_000_000_000
INDEPENDENT = "independent frames, no drive: frame N is at N × 10 s, there is no motion between frames"
KNOWN = ("velodyne", "calib", "label_2", "image_2", "image_3")


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens `training` or `testing`, or the folder above them; `training` of both."""
    root = _root(path)
    return None if root is None or is_view_of_delft(root) else open_frames


def open_frames(path: Path, _: Path | None = None) -> Recording:
    """Frames with scans, images and boxes; raises LogError."""
    root = _root(path) or path
    contents = FolderContents(path, "kitti detection", notes=[INDEPENDENT])
    calibrations, _unread = numbered_files((root / "calib").glob("*.txt"))
    calibration = common_calibration(contents, calibrations)
    if calibration is not None:
        contents.extrinsics += calibration.extrinsics(LIDAR_FRAME, OXTS_FRAME)
    scans = numbered_files((root / "velodyne").glob("*.bin"))
    add_scans(contents, scans, (_times(scans[0]), ()))
    has_truth = add_truth(contents, root / "label_2", calibrations, _times)
    add_images(contents, root, _times, calibration, is_one_size=False)  # frames of several days
    contents.ignored += unread_entries(root, KNOWN)
    return contents.recording(LIDAR_FRAME if has_truth else None, VIEW_DEG, VEHICLE)


def is_view_of_delft(root: Path) -> bool:
    """Whether `training` or `testing` is that of View-of-Delft: with poses, or with a radar in place of the lidar."""
    return (root / "pose").is_dir() or (root.parent.name == "lidar" and (root.parent.parent / "radar").is_dir())


def _root(path: Path) -> Path | None:
    return next((root for root in (path, path / "training", path / "testing") if has_frames(root)), None)


def _times(frames: Iterable[int]) -> dict[int, int]:
    return nominal_times(frames, PERIOD_NS)
