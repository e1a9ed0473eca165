"""View-of-Delft: lidar, camera, radar, poses and boxes of frames at 10 Hz, in a layout like that of KITTI detection.

Differences from KITTI: the rotation of a label is about -z of the lidar; a label of a rider belongs to that of its
cyclist; the column `truncated` holds something else, in the labels with track ids the id. Clouds and images are
compensated for the motion to the same time. Sources: github.com/tudelft-iv/view-of-delft-dataset, SENSORS_AND_DATA.md,
ANNOTATION.md, vod/frame and vod/visualization. Doppler receding positive follows from vod/visualization only.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from datasets.importers.frame_streams import (
    NO_TIMES,
    FolderContents,
    FrameStream,
    nominal_times,
    numbered_files,
    read_bytes,
    read_lines,
    unread_entries,
)
from datasets.importers.kitti_calibration import CAMERA_FRAME, Calibration
from datasets.importers.kitti_detection import PERIOD_NS, is_view_of_delft
from datasets.importers.kitti_frames import add_images, add_truth, common_calibration
from datasets.importers.kitti_labels import Label
from datasets.importers.kitti_scans import LIDAR_FRAME, add_scans
from datasets.importers.recording import Extrinsic, Open, Recording, Sensor
from geometry.arrays import Float64
from messages.errors import LogError
from messages.motion import Odometry
from messages.sensors import RadarScan

NAME = "View-of-Delft folder"
TAKES_LABELS = True
VEHICLE = "view_of_delft_prius"  # configs/vehicles/
VIEW_DEG = 32.0  # labelled half angle: the view of the camera, to 50 m
RADAR_FRAME = "radar"
RADAR = Sensor("radar/front", RADAR_FRAME, "radar", "view of delft")
ODOMETRY = Sensor("odom/velodyne", LIDAR_FRAME, "pose", "view of delft")
RADAR_COLUMNS = 7  # x, y, z, RCS, v_r, v_r compensated, time (0 = this scan)
MAX_RANGE_M = 250.0
# A larger step of the pose between two frames is the start of another drive.
MAX_STEP_M = 5.0
# A rider at most this far from a cyclist (over ground) is part of it.
RIDER_M = 0.5
NO_TRACKS = "labels without track ids: each box is an object of its own (--truth takes label_2_with_track_ids)"


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens the root of the data set, its `lidar`, or `training` or `testing` in it."""
    return None if _root(path) is None else open_view_of_delft


def open_view_of_delft(path: Path, truth: Path | None = None) -> Recording:
    """All frames of the data set; `truth` is a folder of label files, such as those with track ids. Raises LogError."""
    lidar = _root(path) or path
    radar = lidar.parent.parent / "radar" / lidar.name
    contents = FolderContents(path, "view of delft", notes=[NO_TIMES])
    calibrations, _unread = numbered_files((lidar / "calib").glob("*.txt"))
    calibration = common_calibration(contents, calibrations)
    if calibration is not None:
        contents.extrinsics.append(Extrinsic(CAMERA_FRAME, LIDAR_FRAME, calibration.T_camera_lidar))
    poses = _read_poses(next((p for p in (lidar / "pose", radar / "pose") if p.is_dir()), lidar / "pose"))
    stamps = _Stamps(tuple(_starts(poses.by_frame)))
    if stamps.starts:
        starts = ", ".join(map(str, stamps.starts))
        contents.notes.append(f"the pose jumps at the frames {starts}: other drives, each set 10 s later")
    scans = numbered_files((lidar / "velodyne").glob("*.bin"))
    add_scans(contents, scans, (stamps.of(scans[0]), ()))
    has_truth = _add_truth(contents, truth, lidar, calibrations, stamps)
    _add_radar(contents, radar, stamps)
    _add_odometry(contents, poses, stamps, calibration)
    add_images(contents, lidar, stamps.of, calibration)
    contents.ignored += unread_entries(lidar, ("velodyne", "calib", "label_2", "image_2", "pose"))
    contents.ignored += unread_entries(lidar.parent.parent, ("lidar", "radar"))
    return contents.recording(LIDAR_FRAME if has_truth else None, VIEW_DEG, VEHICLE)


def _root(path: Path) -> Path | None:
    """`lidar/training` or `lidar/testing` for itself or a folder above it."""
    places = (path, path / "training", path / "testing", path / "lidar/training", path / "lidar/testing")
    return next((p for p in places if is_view_of_delft(p) and any((p / "velodyne").glob("*.bin"))), None)


@dataclass(frozen=True)
class _Stamps:
    """Times of frames: 10 Hz, and 10 s more from each of the frames `starts` on."""

    starts: tuple[int, ...]

    def of(self, frames: Iterable[int]) -> dict[int, int]:
        before = np.array(self.starts, np.int64)
        return {n: ns + PERIOD_NS * int((before <= n).sum()) for n, ns in nominal_times(frames).items()}


def _add_truth(
    contents: FolderContents, truth: Path | None, lidar: Path, calibrations: dict[int, Path], stamps: _Stamps
) -> bool:
    labels = truth if truth is not None else lidar / "label_2"
    has_tracks = _has_tracks(labels)

    def edit(boxes: list[Label]) -> list[Label]:
        cyclists = [np.array(box.p_camera_m)[[0, 2]] for box in boxes if box.name == "Cyclist"]
        kept = [b for b in boxes if b.name != "rider" or not _is_near(np.array(b.p_camera_m)[[0, 2]], cyclists)]
        return [replace(box, track=int(box.truncated)) for box in kept] if has_tracks else kept

    has_truth = add_truth(contents, labels, calibrations, stamps.of, is_about_lidar=True, edit=edit)
    if truth is not None and not has_truth:
        raise LogError(f"{truth}: no label files (such as 00000.txt)")
    if has_truth and not has_tracks:
        contents.notes.append(NO_TRACKS)
    return has_truth


def _is_near(p: Float64, others: list[Float64]) -> bool:
    return any(float(np.hypot(*(p - other))) <= RIDER_M for other in others)


def _has_tracks(labels: Path) -> bool:
    """Whether `truncated` is a track id: an integer, different for all boxes of a frame, and not 0 and 1 only."""
    largest = 0.0
    for path in numbered_files(labels.glob("*.txt"))[0].values():
        try:
            ids = [float(line.split()[1]) for line in read_lines(path) if line.strip()]
        except (LogError, ValueError, IndexError):
            continue  # counted when it is read
        if len(set(ids)) < len(ids) or not all(i.is_integer() and i >= 0.0 for i in ids):
            return False
        largest = max([largest, *ids])
    return largest > 1.0


def _add_radar(contents: FolderContents, radar: Path, stamps: _Stamps) -> None:
    files, unread = numbered_files((radar / "velodyne").glob("*.bin"))
    if not files:
        return
    contents.streams.append(FrameStream((RADAR,), stamps.of(files), lambda n, ns: (read_radar(files[n], ns),), unread))
    calibrations, _unread = numbered_files((radar / "calib").glob("*.txt"))
    calibration = common_calibration(contents, calibrations)
    if calibration is not None:
        contents.extrinsics.append(Extrinsic(CAMERA_FRAME, RADAR_FRAME, calibration.T_camera_lidar))


def read_radar(path: Path, stamp_ns: int) -> RadarScan:
    """Detections of the scan itself, without those accumulated from earlier scans; raises LogError.

    `v_r` is the measured radial velocity, receding positive.
    """
    raw = read_bytes(path)
    if len(raw) % (4 * RADAR_COLUMNS):
        raise LogError(f"{path}: {len(raw)} bytes are no radar scan ({RADAR_COLUMNS} x float32 per detection)")
    rows = np.frombuffer(raw, "<f4").reshape(-1, RADAR_COLUMNS).astype(np.float64)
    range_m = np.linalg.norm(rows[:, :3], axis=1)
    if not np.isfinite(rows).all() or (range_m > MAX_RANGE_M).any():
        raise LogError(f"{path}: detections beyond {MAX_RANGE_M:.0f} m or not finite: this is no radar scan")
    rows, range_m = rows[rows[:, 6] > -0.5], range_m[rows[:, 6] > -0.5]
    elevation_rad = np.arctan2(rows[:, 2], np.hypot(rows[:, 0], rows[:, 1]))
    return RadarScan(stamp_ns, range_m, np.arctan2(rows[:, 1], rows[:, 0]), elevation_rad, rows[:, 4], rows[:, 3])


@dataclass(frozen=True)
class _Poses:
    """`T_odom_camera` by frame, and the reasons for files without one."""

    by_frame: dict[int, Float64]
    unread: tuple[str, ...]


def _read_poses(folder: Path) -> _Poses:
    files, unread = numbered_files(folder.glob("*.json"))
    found, reasons = {}, list(unread)
    for frame, path in files.items():
        try:
            found[frame] = read_pose(path)
        except LogError as error:
            reasons.append(str(error))
    return _Poses(found, tuple(reasons))


def read_pose(path: Path) -> Float64:
    """`T_odom_camera` (4, 4) of a pose file, its line `odomToCamera`; raises LogError."""
    try:
        for line in read_lines(path):
            if line.strip() and "odomToCamera" in (values := json.loads(line)):
                T = np.array(values["odomToCamera"], np.float64).reshape(4, 4)
                if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() <= 1e-3 and np.isfinite(T).all():
                    return T
                raise ValueError(f"{values['odomToCamera']} is no pose")
    except (ValueError, TypeError, RecursionError) as error:
        raise LogError(f"{path}: no pose ({error})") from error
    raise LogError(f"{path}: no pose (no line odomToCamera)")


def _starts(poses: dict[int, Float64]) -> Iterable[int]:
    """Frames at which the pose jumps."""
    for (before, T_before), (after, T_after) in pairwise(sorted(poses.items())):
        if np.linalg.norm(T_after[:3, 3] - T_before[:3, 3]) > MAX_STEP_M * (after - before):
            yield after


def _add_odometry(contents: FolderContents, poses: _Poses, stamps: _Stamps, calibration: Calibration | None) -> None:
    """Adds poses of the lidar in `odom`; the data set has no speeds, they are NaN."""
    if calibration is None or not poses.by_frame:
        return
    T_camera_lidar, nan = calibration.T_camera_lidar, math.nan

    def read(frame: int, stamp_ns: int) -> tuple[Odometry]:
        T = poses.by_frame[frame] @ T_camera_lidar
        return (Odometry(stamp_ns, T, nan, nan, nan, nan, nan, np.full((6, 6), nan)),)

    contents.streams.append(FrameStream((ODOMETRY,), stamps.of(poses.by_frame), read, poses.unread))
