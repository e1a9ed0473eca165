"""KITTI detection and View-of-Delft: geometry, times and motion; what cannot be read is skipped with its reason."""

import json
import math
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from datasets.importers.formats import open_recording
from datasets.importers.view_of_delft import read_pose
from geometry.transforms import apply, invert, yaw_of
from messages.errors import LogError
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.sensors import CameraImage, RadarScan
from messages.truth import Occlusion, TrueObjects
from tests.datasets import folder_samples as samples
from tests.datasets.folder_samples import NS
from tests.datasets.imported import reason_text
from tests.datasets.test_kitti_folders import check_box, of_type, skipped

# --- KITTI detection


def test_detection_frames_are_independent(tmp_path: Path) -> None:
    root = samples.write_detection(tmp_path)
    for path in (root, root / "training"):
        source = open_recording(path)
        about = source.description
        assert (about.format, about.vehicle, about.truth_view_deg) == ("kitti detection", "kitti_car", 40.0)
        assert "independent frames" in about.notes[0]
        check_box(source)
        received = list(source.read())
        assert sorted({t for t, _, _ in received}) == [0, 10 * NS, 20 * NS]
        assert not [m for _, _, m in received if isinstance(m, Odometry)]
    ids = [box.id for truth in of_type(source, TrueObjects) for box in truth.objects]
    assert ids == [1, 1001, 2001]
    assert [m.bgr.shape[1] for m in of_type(source, CameraImage)] == [124, 125, 126]  # as in KITTI, by day
    assert skipped(source) == {}


def test_detection_with_changing_calibration_has_no_common_mounts(tmp_path: Path) -> None:
    root = samples.write_detection(tmp_path)
    other = samples.T_CAMERA_LIDAR.copy()
    other[0, 3] += 0.5
    (root / "training" / "calib" / "000001.txt").write_text(samples.calibration_text(other))
    source = open_recording(root)
    assert source.description.extrinsics == ()
    assert "differs between frames" in " ".join(source.description.notes)
    moved = [t.objects[0].center_map_m for t in of_type(source, TrueObjects)]
    np.testing.assert_allclose(moved[2], moved[0])
    assert np.linalg.norm(moved[1] - moved[0]) == pytest.approx(0.5, abs=1e-6)


DETECTION_DAMAGE: list[tuple[str, bytes | None, str, dict[str, int]]] = [
    ("velodyne/000001.bin", b"\1" * 17, "17 bytes", {"lidar/velodyne": 2, "truth_objects/velodyne": 3}),
    ("label_2/000001.txt", b"Car 0 0 0 0 0 9 9 1 1 nan 0 0 9 0\n", "000001.txt:1", {"truth_objects/velodyne": 2}),
    ("label_2/000001.txt", b"Car 0 0 0\n", "4 columns", {"truth_objects/velodyne": 2}),
    ("label_2/000001.txt", b"", "", {"truth_objects/velodyne": 3}),
    ("label_2/000001.txt", b"\xff\xfe", "no ASCII", {"truth_objects/velodyne": 2}),
    ("calib/000001.txt", b"P2: 1 2 3\n", "no row 'R0_rect'", {"truth_objects/velodyne": 2, "lidar/velodyne": 3}),
    ("calib/000001.txt", None, "without a calibration", {"truth_objects/velodyne": 2, "lidar/velodyne": 3}),
    ("velodyne/x.bin", b"", "x.bin: its name is no frame number", {"lidar/velodyne": 3}),
    ("velodyne/99999999999.bin", b"", "is no frame number below", {"lidar/velodyne": 3}),
    ("velodyne/1.bin", b"", "frame 1 is 000001.bin", {"lidar/velodyne": 3}),
]


@pytest.mark.parametrize(("name", "content", "says", "left"), DETECTION_DAMAGE)
def test_damaged_detection_file(
    tmp_path: Path, name: str, content: bytes | None, says: str, left: dict[str, int]
) -> None:
    training = samples.write_detection(tmp_path) / "training"
    (training / name).unlink(missing_ok=True)
    if content is not None:
        (training / name).write_bytes(content)
    source = open_recording(tmp_path)
    counts = Counter(topic for _, topic, _ in source.read())
    assert {topic: counts[topic] for topic in left} == left
    assert says in reason_text(source)


# --- View-of-Delft


def test_view_of_delft_geometry(tmp_path: Path) -> None:
    root = samples.write_view_of_delft(tmp_path / "vod")
    for path in (root, root / "lidar", root / "lidar" / "training"):
        source = open_recording(path)
        about = source.description
        assert (about.format, about.vehicle, about.truth_view_deg) == ("view of delft", "view_of_delft_prius", 32.0)
        check_box(source, "view_of_delft_prius", moved_m=0.5)
        received = list(source.read())
        assert Counter(topic for _, topic, _ in received) == dict.fromkeys(
            ("lidar/velodyne", "truth_objects/velodyne", "radar/front", "odom/velodyne", "camera/image_2"), 4
        )
        assert [t for t, topic, _ in received if topic == "radar/front"] == [k * NS // 10 for k in range(4)]
        assert skipped(source) == {}
    poses = {e.child: e.T_parent_child for e in about.extrinsics}
    np.testing.assert_allclose(invert(poses["velodyne"]) @ poses["radar"], samples.T_LIDAR_RADAR, atol=1e-8)
    np.testing.assert_allclose(poses["velodyne"], samples.T_VOD_CAMERA_LIDAR, atol=1e-8)
    assert about.cameras[0].size_px == samples.SIZE_PX
    (truth, *_) = of_type(source, TrueObjects)
    assert truth.objects[0].occlusion == Occlusion.LARGELY


def test_view_of_delft_radar_detects_the_approaching_box(tmp_path: Path) -> None:
    mount = samples.lidar_mount("view_of_delft_prius") @ samples.T_LIDAR_RADAR
    for k, scan in enumerate(of_type(open_recording(samples.write_view_of_delft(tmp_path)), RadarScan)):
        assert len(scan.range_m) == 1  # that of the earlier scan is left out
        el, az = scan.elevation_rad[0], scan.azimuth_rad[0]
        direction = np.array([math.cos(el) * math.cos(az), math.cos(el) * math.sin(az), math.sin(el)])
        point = apply(mount, (scan.range_m[0] * direction)[None])[0]
        np.testing.assert_allclose(point, samples.CENTER_M - (0.5 * k, 0.0, 0.0), atol=0.01)
        assert scan.doppler_mps[0] == pytest.approx(-samples.SPEED_MPS * (mount[:3, :3] @ direction)[0], abs=1e-3)
        assert scan.doppler_mps[0] < 0.0
        assert scan.rcs_dbsm[0] == 7.5


def test_view_of_delft_odometry_is_that_of_the_lidar(tmp_path: Path) -> None:
    odometry = of_type(open_recording(samples.write_view_of_delft(tmp_path)), Odometry)
    for before, after in pairwise(odometry):
        step = invert(before.T_odom_base) @ after.T_odom_base
        np.testing.assert_allclose(step[:3, 3], (0.5, 0.0, 0.0), atol=1e-6)
    assert yaw_of(odometry[0].T_odom_base) == pytest.approx(1.0)
    assert math.isnan(odometry[0].speed_mps)


def test_view_of_delft_drives_are_set_apart(tmp_path: Path) -> None:
    root = samples.write_view_of_delft(tmp_path)
    for k in (2, 3):
        path = root / f"lidar/training/pose/{k:05d}.json"
        values = json.loads(path.read_text().split("\n")[0])["odomToCamera"]
        values[3] += 900.0
        path.write_text(json.dumps({"odomToCamera": values}))
    source = open_recording(root)
    assert "at the frames 2" in " ".join(source.description.notes)
    stamps = {t for t, _, _ in source.read()}
    assert sorted(stamps) == [0, NS // 10, 10 * NS + 2 * NS // 10, 10 * NS + 3 * NS // 10]


def box_line(name: str, first: str, x: float) -> str:
    return f"{name} {first} 0 0 0 0 9 9 1.8 0.6 1.9 {x} 1.9 9.0 0.1 1\n"


def test_view_of_delft_classes_riders_and_tracks(tmp_path: Path) -> None:
    root = samples.write_view_of_delft(tmp_path / "vod", 2)
    names = (
        "Cyclist",
        "rider",
        "rider",
        "Pedestrian",
        "Car",
        "bicycle",
        "moped_scooter",
        "human_depiction",
        "DontCare",
    )
    places = (0.0, 0.1, 5.0, 1.0, 2.0, 3.0, 4.0, 6.0, 7.0)
    boxes = list(zip(names, places, strict=True))
    (root / "lidar/training/label_2/00000.txt").write_text("".join(box_line(n, "1", x) for n, x in boxes))
    source = open_recording(root)
    (truth, other) = of_type(source, TrueObjects)
    found = [(box.role.split()[0], box.label) for box in truth.objects]
    person, vehicle, unknown = ObstacleClass.PERSON, ObstacleClass.VEHICLE, ObstacleClass.UNKNOWN
    assert found == [
        ("Cyclist", person), ("rider", person), ("Pedestrian", person), ("Car", vehicle), ("bicycle", unknown),
        ("moped_scooter", vehicle), ("human_depiction", unknown)
    ]  # fmt: skip
    assert len({box.id for t in (truth, other) for box in t.objects}) == 8
    assert "without track ids" in " ".join(source.description.notes)
    tracks = tmp_path / "label_2_with_track_ids"
    tracks.mkdir()
    for k in range(2):
        lines = (box_line(name, str(11 + n), x) for n, (name, x) in enumerate(boxes))
        (tracks / f"{k:05d}.txt").write_text("".join(lines))
    source = open_recording(root, tracks)
    (truth, other) = of_type(source, TrueObjects)
    assert [box.id for box in truth.objects] == [box.id for box in other.objects] == [11, 13, 14, 15, 16, 17, 18]
    assert "without track ids" not in " ".join(source.description.notes)
    with pytest.raises(LogError, match="no label files"):
        open_recording(root, tmp_path)


VOD_DAMAGE: list[tuple[str, bytes, str, dict[str, int]]] = [
    ("radar/training/velodyne/00001.bin", b"\1" * 27, "27 bytes are no radar scan", {"radar/front": 3}),
    ("radar/training/velodyne/00001.bin", b"", "", {"radar/front": 4}),
    ("radar/training/velodyne/00001.bin", np.full(7, np.inf, "<f4").tobytes(), "not finite", {"radar/front": 3}),
    ("lidar/training/pose/00001.json", b"{}", "no line odomToCamera", {"odom/velodyne": 3}),
    ("lidar/training/pose/00001.json", b'{"odomToCamera": [1, 2]}', "no pose", {"odom/velodyne": 3}),
    ("lidar/training/pose/00001.json", b'{"odomToCamera": ' + b"[" * 9999, "no pose", {"odom/velodyne": 3}),
    ("lidar/training/pose/00001.json", b"[1]", "no pose", {"odom/velodyne": 3}),
    ("lidar/training/image_2/00001.jpg", b"\xff\xd8\xff", "neither JPEG nor PNG", {"camera/image_2": 3}),
]


@pytest.mark.parametrize(("name", "content", "says", "left"), VOD_DAMAGE)
def test_damaged_view_of_delft_file(tmp_path: Path, name: str, content: bytes, says: str, left: dict[str, int]) -> None:
    (samples.write_view_of_delft(tmp_path) / name).write_bytes(content)
    source = open_recording(tmp_path)
    counts = Counter(topic for _, topic, _ in source.read())
    assert {topic: counts[topic] for topic in left} == left
    assert counts["lidar/velodyne"] == 4
    assert says in reason_text(source)


def test_published_pose_is_the_place_of_the_camera(tmp_path: Path) -> None:
    """Pose of frame 01047 of the data set's public example: the camera 1.30 m above ground, looking 6.9 degrees up."""
    values = [-0.51206276, -0.11078144, -0.85177415, -25.46347509, 0.85879908, -0.0475638, -0.51009982, -27.53975629,
              0.01599597, -0.99270598, 0.11949465, 1.29940025, 0.0, 0.0, 0.0, 1.0]  # fmt: skip
    (tmp_path / "01047.json").write_text(json.dumps({"odomToCamera": values}) + '\n{"mapToCamera": []}\n')
    T = read_pose(tmp_path / "01047.json")
    assert T[2, 3] == pytest.approx(1.2994)
    assert math.degrees(math.asin(T[2, 2])) == pytest.approx(6.86, abs=0.01)
