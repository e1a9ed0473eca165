"""Labels of KITTI and View-of-Delft: boxes from the rectified camera frame to the lidar frame.

The position of a label is the bottom centre of its box in rectified camera coordinates (x right, y down, z forward);
its length is along x when `rotation_y`, about the y axis, is zero. Only the camera view is labelled (about ± 40°).
"""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from datasets.importers.frame_streams import read_lines
from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.transforms import apply, invert
from messages.errors import LogError
from messages.perception import ObstacleClass
from messages.truth import Occlusion, TrueObject, TrueObjects

# By lower-case name, of KITTI and View-of-Delft; another name is an unknown obstacle.
CLASSES = {
    **dict.fromkeys(("car", "van", "truck", "tram", "vehicle_other", "motor", "moped_scooter"), ObstacleClass.VEHICLE),
    **dict.fromkeys(("pedestrian", "person", "person_sitting", "cyclist", "rider"), ObstacleClass.PERSON),
}
# Image areas without labels: no box.
UNLABELLED = "DontCare"
# Column `occluded`; another value is unknown.
OCCLUSION = {0: Occlusion.NONE, 1: Occlusion.PARTLY, 2: Occlusion.LARGELY}
# Columns from the class to the rotation; in tracking they follow frame and track.
COLUMNS = 15
# Largest number of lines of one frame, for unique numbers of boxes.
MAX_BOXES = 1000
_DETECTED = {"1": "Pedestrian", "2": "Car", "3": "Cyclist"}


@dataclass(frozen=True)
class Label:
    """One box of a frame as in the file: size (height, width, length), bottom centre and rotation in the camera."""

    frame: int
    track: int
    name: str
    truncated: float
    occluded: int
    size_hwl_m: tuple[float, float, float]
    p_camera_m: tuple[float, float, float]
    rotation_y_rad: float


@dataclass
class LabelFile:
    """Boxes by frame without DontCare, and the reason for each frame with a line that is no label.

    The truth of such a frame is unknown: an object may be missing.
    """

    by_frame: dict[int, list[Label]] = field(default_factory=dict)
    unreadable: dict[int, str] = field(default_factory=dict)

    def of_frame(self, frame: int) -> list[Label]:
        """Boxes of a frame; raises LogError with line and value if one of its lines is no label."""
        if frame in self.unreadable:
            raise LogError(self.unreadable[frame])
        return self.by_frame.get(frame, [])


def read_labels(path: Path) -> LabelFile:
    """A label file of KITTI tracking, all frames; raises LogError for a line without its frame."""
    found = LabelFile()
    for number, line in enumerate(read_lines(path), start=1):
        words = line.split()
        if not words:
            continue
        try:
            frame = int(words[0])
        except ValueError as error:
            raise LogError(f"{path}:{number}: not a KITTI tracking label: {line[:60]!r}") from error
        try:
            if (label := _label(words[2:], frame, words[1])) is not None:
                found.by_frame.setdefault(frame, []).append(label)
        except (ValueError, IndexError) as error:
            found.unreadable[frame] = f"{path}:{number}: not a KITTI tracking label ({error}): {line[:60]!r}"
    return found


def read_frame_labels(path: Path, frame: int) -> list[Label]:
    """A label file of one frame (detection, View-of-Delft); raises LogError with the line.

    Tracks are numbered by frame and line: no box is known to be one of another frame. A score may come last.
    """
    labels = []
    for number, line in enumerate(read_lines(path), start=1):
        words = line.split()
        columns = words[:COLUMNS] if len(words) == COLUMNS + 1 else words
        try:
            if words and (label := _label(columns, frame, str(MAX_BOXES * frame + number))) is not None:
                labels.append(label)
        except (ValueError, IndexError) as error:
            raise LogError(f"{path}:{number}: not a KITTI label ({error}): {line[:60]!r}") from error
    return labels


def _label(words: list[str], frame: int, track: str) -> Label | None:
    """A label from its columns; None for DontCare. Raises ValueError."""
    if len(words) != COLUMNS:
        raise ValueError(f"{len(words)} columns instead of {COLUMNS}")
    if words[0] == UNLABELLED:
        return None
    h, w, length, x, y, z, turn = map(float, words[8:COLUMNS])
    if not all(map(math.isfinite, (h, w, length, x, y, z, turn))) or min(h, w, length) <= 0.0:
        raise ValueError(f"box of size {h} x {w} x {length} at ({x}, {y}, {z})")
    truncated, occluded = float(words[1]), int(float(words[2]))
    return Label(frame, int(track), words[0], truncated, occluded, (h, w, length), (x, y, z), turn)


def read_detections(path: Path) -> list[tuple[float, Label]]:
    """Detections with scores in the format of AB3DMOT; `track` is the line number.

    A line holds frame, class (1 pedestrian, 2 car, 3 cyclist), image box (4 values), score, height, width, length,
    bottom centre, rotation, alpha. Raises LogError with line and value.
    """
    found = []
    for number, line in enumerate(read_lines(path), start=1):
        words = line.split(",")
        if not line.strip():
            continue
        try:
            frame, kind = int(words[0]), _DETECTED[words[1]]
            score, h, w, length, x, y, z, turn, _ = map(float, words[6:])
        except (ValueError, KeyError, IndexError) as error:
            raise LogError(f"{path}:{number}: not a detection: {line[:60]!r}") from error
        found.append((score, Label(frame, number, kind, 0.0, 0, (h, w, length), (x, y, z), turn)))
    return found


def true_objects(
    labels: list[Label], stamp_ns: int, T_camera_lidar: Float64, is_about_lidar: bool = False
) -> TrueObjects:
    """Boxes of one frame in lidar coordinates (x forward, y left, z up); clearance and velocity are NaN.

    The rotation is about y of the camera, or with `is_about_lidar` about -z of the lidar (View-of-Delft).
    """
    T_lidar_camera = invert(T_camera_lidar)
    return TrueObjects(stamp_ns, tuple(_true_object(label, T_lidar_camera, is_about_lidar) for label in labels))


def _true_object(label: Label, T_lidar_camera: Float64, is_about_lidar: bool) -> TrueObject:
    h, w, length = label.size_hwl_m
    if is_about_lidar:
        bottom = np.asarray(apply(T_lidar_camera, np.array([label.p_camera_m]))[0], np.float64)
        center = bottom + np.array([0.0, 0.0, 0.5 * h])
        yaw_rad = wrap(-label.rotation_y_rad - 0.5 * math.pi)
    else:
        x, y, z = label.p_camera_m
        center = np.asarray(apply(T_lidar_camera, np.array([[x, y - 0.5 * h, z]]))[0], np.float64)
        turn = label.rotation_y_rad
        ahead = T_lidar_camera[:3, :3] @ np.array([math.cos(turn), 0.0, -math.sin(turn)])
        yaw_rad = math.atan2(ahead[1], ahead[0])
    return TrueObject(
        id=label.track,
        label=CLASSES.get(label.name.lower(), ObstacleClass.UNKNOWN),
        role=f"{label.name} {label.track}",
        center_map_m=center,
        size_m=np.array([length, w, h]),
        yaw_rad=yaw_rad,
        velocity_mps=np.full(2, np.nan),
        clearance_m=math.nan,
        occlusion=OCCLUSION.get(label.occluded, Occlusion.UNKNOWN),
    )
