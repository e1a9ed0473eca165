"""Frames in the layout of KITTI detection: `velodyne`, `calib`, `label_2`, `image_2` with one file per frame each."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from datasets.importers.camera_files import image_files
from datasets.importers.frame_streams import FolderContents, FrameStream, numbered_files
from datasets.importers.kitti_calibration import Calibration, add_camera, read_calibration
from datasets.importers.kitti_labels import Label, read_frame_labels, true_objects
from datasets.importers.kitti_scans import LIDAR_FRAME, TRUTH_TOPIC
from datasets.importers.recording import Sensor
from messages.errors import LogError
from messages.truth import TrueObjects

SAME_POSE = 1e-6
# Stamps (ns) of frames.
Stamps = Callable[[Iterable[int]], dict[int, int]]


def add_images(
    contents: FolderContents, folder: Path, stamps: Stamps, calibration: Calibration | None, is_one_size: bool = True
) -> None:
    """Adds the images of the colour cameras at their stamps."""
    for number in (2, 3):
        images = image_files(folder / f"image_{number}")
        add_camera(contents, number, images, (stamps(images[0]), ()), calibration, is_one_size)


def add_truth(
    contents: FolderContents,
    labels: Path,
    calibrations: dict[int, Path],
    stamps: Stamps,
    is_about_lidar: bool = False,
    edit: Callable[[list[Label]], list[Label]] = lambda boxes: boxes,
) -> bool:
    """Adds the boxes of a folder of label files after the scans; False without any file."""
    files, unread = numbered_files(labels.glob("*.txt"))

    def read(frame: int, stamp_ns: int) -> tuple[TrueObjects]:
        if frame not in calibrations:
            raise LogError(f"{files[frame]}: labels without a calibration; boxes cannot be transformed to the lidar")
        boxes = edit(read_frame_labels(files[frame], frame))
        return (true_objects(boxes, stamp_ns, read_calibration(calibrations[frame]).T_camera_lidar, is_about_lidar),)

    if files:
        sensor = Sensor(TRUTH_TOPIC, LIDAR_FRAME, str(labels), "labels")
        contents.streams.insert(1, FrameStream((sensor,), stamps(files), read, unread))
    return bool(files)


def common_calibration(contents: FolderContents, files: dict[int, Path]) -> Calibration | None:
    """The calibration of all frames; None, with a note, where it is not one and the same."""
    first: Calibration | None = None
    bad = 0
    for path in files.values():
        try:
            calibration = read_calibration(path)
        except LogError as error:
            bad += 1
            if bad == 1:
                contents.notes.append(str(error))
            continue
        first = first or calibration
        if not _is_same(first, calibration):
            contents.notes.append("the calibration differs between frames: no mounts and intrinsics for all")
            return None
    return first


def _is_same(a: Calibration, b: Calibration) -> bool:
    poses = np.abs(a.T_camera_lidar - b.T_camera_lidar).max()
    return bool(poses <= SAME_POSE) and [m.K.tolist() for m in a.models] == [m.K.tolist() for m in b.models]
