"""KITTI folders: geometry, times and calibration of every layout; what cannot be read is skipped with its reason."""

import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from datasets.importers import kitti_labels
from datasets.importers.formats import open_recording
from datasets.importers.recording import Recording, describe
from datasets.importers.write_recording import write_recording
from datasets.reader import read_log
from datasets.summary import summarize_log
from geometry.transforms import apply, invert, transform
from messages.errors import LogError
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.sensors import GnssFix, GnssSolution, ImuSample, LidarScan
from messages.truth import Occlusion, TrueObject, TrueObjects
from tests.datasets import folder_samples as samples
from tests.datasets.folder_samples import NS, OXTS
from tests.datasets.imported import reason_text
from tests.datasets.log_samples import bits
from tests.datasets.test_log_importers import LOG, VIEW
from tests.recordings import recording


def test_label_box_from_camera_to_lidar() -> None:
    T_camera_lidar = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, -0.3], [0, 0, 0, 1]])
    label = kitti_labels.Label(0, 7, "Car", 0, 0, (1.5, 1.6, 4.0), (2.0, 1.7, 10.0), -np.pi / 2)
    (box,) = kitti_labels.true_objects([label], 5, T_camera_lidar).objects
    np.testing.assert_allclose(box.center_map_m, [10.3, -2.0, -1.7 + 0.75])
    assert box.size_m.tolist() == [4.0, 1.6, 1.5]
    assert box.occlusion is Occlusion.NONE
    assert box.yaw_rad == pytest.approx(0.0)  # along the camera's z, the lidar's x
    across = kitti_labels.Label(0, 7, "Car", 0, 2, (1.5, 1.6, 4.0), (2.0, 1.7, 10.0), 0.0)
    (box,) = kitti_labels.true_objects([across], 5, T_camera_lidar).objects
    assert (box.yaw_rad, box.occlusion) == (pytest.approx(-np.pi / 2), Occlusion.LARGELY)


def inside(box: TrueObject, points_m: np.ndarray) -> int:
    """Returns in a box above its lowest 20 cm (ground)."""
    local = points_m @ invert(transform(box.center_map_m, (0, 0, box.yaw_rad)))[:3, :3].T
    local = local + invert(transform(box.center_map_m, (0, 0, box.yaw_rad)))[:3, 3]
    half = 0.5 * box.size_m
    return int(((np.abs(local) < half).all(axis=1) & (local[:, 2] > 0.2 - half[2])).sum())


def test_packed_kitti_returns_lie_in_label_boxes() -> None:
    source = open_recording(recording("kitti-seq-pcd"), recording("kitti-tracking-truth"))
    assert source.description.truth_frame == "velodyne"
    received = list(source.read())
    scans = {m.stamp_ns: m for _, _, m in received if isinstance(m, LidarScan)}
    truths = [m for _, _, m in received if isinstance(m, TrueObjects)]
    assert sorted(scans) == [k * NS // 10 for k in range(40)]
    assert len(truths) == 40
    for truth in truths[::13]:
        assert {o.role for o in truth.objects} >= {"Van 0", "Cyclist 1"}
        for box in truth.objects:
            wide = TrueObject(**(vars(box) | {"size_m": box.size_m + np.array([0.6, 0.6, 0.0])}))
            count, around = inside(box, scans[truth.stamp_ns].points_m), inside(wide, scans[truth.stamp_ns].points_m)
            assert count >= 10
            assert count >= 0.9 * around  # a rotation of 0.3 rad loses a quarter of a van


def test_kitti_import_to_log(tmp_path: Path) -> None:
    frames = recording("kitti-seq-pcd") / "frames"
    for k in (4, 5, 7):
        (tmp_path / f"{k:06d}.npz").symlink_to(frames / f"{k:06d}.npz")
    source = open_recording(tmp_path, recording("kitti-tracking-truth"))
    counts = write_recording(source, tmp_path / "kitti.mcap", LOG, VIEW)
    assert counts == {"lidar/velodyne": 3, "truth_objects/velodyne": 3}
    summary = summarize_log(tmp_path / "kitti.mcap")
    assert summary.is_complete
    assert summary.undecoded == 0
    again = open_recording(tmp_path / "kitti.mcap").description
    assert describe(again) == describe(source.description)
    for (_, topic, message), envelope in zip(source.read(), read_log(tmp_path / "kitti.mcap"), strict=True):
        assert (topic, bits(message)) == (envelope.topic, bits(envelope.message))


def test_detections_of_ab3dmot(tmp_path: Path) -> None:
    folder = recording("kitti-tracking-truth") / "data" / "KITTI" / "detection"
    (score, car), *_ = kitti_labels.read_detections(folder / "pointrcnn_Car_val" / "0000.txt")
    assert (score, car.frame, car.name, car.size_hwl_m) == (8.2981, 0, "Car", (1.9605, 1.8137, 4.7549))
    assert car.p_camera_m == (-4.5720, 1.8435, 13.5308)  # the van of the labels
    (tmp_path / "bad.txt").write_text("0,2,1,2\n")
    with pytest.raises(LogError, match=r"bad\.txt:1"):
        kitti_labels.read_detections(tmp_path / "bad.txt")


def of_type(source: Recording, kind: type) -> list:
    return [m for _, _, m in source.read() if isinstance(m, kind)]


def skipped(source: Recording) -> dict[str, int | None]:
    """Rows of the table with skipped messages, by the end of their source."""
    return {Path(row.source).name: row.skipped for row in source.table() if row.skipped != 0}


def check_box(source: Recording, vehicle: str = "kitti_car", moved_m: float = 0.0) -> None:
    """The box of `samples` comes out at its place in `base`, within 1 cm, and its returns lie in it."""
    mount = samples.lidar_mount(vehicle)
    received = list(source.read())
    scans = {m.stamp_ns: m for _, _, m in received if isinstance(m, LidarScan)}
    truths = [m for _, _, m in received if isinstance(m, TrueObjects)]
    assert [t.stamp_ns for t in truths] == list(scans)
    for k, truth in enumerate(truths):
        (box,) = truth.objects
        center = apply(mount, box.center_map_m[None])[0]
        np.testing.assert_allclose(center, samples.CENTER_M - (k * moved_m, 0.0, 0.0), atol=0.01)
        np.testing.assert_array_equal(box.size_m, samples.SIZE_M)
        assert box.yaw_rad == pytest.approx(samples.YAW, abs=1e-3)
        assert box.label == ObstacleClass.VEHICLE
        assert inside(box, scans[truth.stamp_ns].points_m) >= 120


def test_tracking_by_root_and_sequence(tmp_path: Path) -> None:
    root = samples.write_tracking(tmp_path / "kitti")
    for path in (root, root / "training", root / "training" / "velodyne" / "0007"):
        source = open_recording(path)
        assert source.description.format == "kitti tracking"
        received = list(source.read())
        assert [t for t, _, _ in received] == sorted(t for t, _, _ in received)
        counts = Counter(topic for _, topic, _ in received)
        assert set(counts.values()) == {3}
        assert set(counts) == {"lidar/velodyne", "truth_objects/velodyne", "gnss/oxts", "imu/oxts", "odom/oxts",
                               "camera/image_02"}  # fmt: skip
        check_box(source)
        (truth, *_) = of_type(source, TrueObjects)
        assert (truth.objects[0].id, truth.objects[0].occlusion) == (4, Occlusion.PARTLY)
        assert skipped(source) == {}
    (root / "training" / "velodyne" / "0008").mkdir()
    with pytest.raises(LogError, match=r"2 sequences.*name one"):
        open_recording(root)


def test_raw_times_calibration_and_images(tmp_path: Path) -> None:
    drive = samples.write_raw(tmp_path)
    (drive / "velodyne_points" / "data" / "0000000001.bin").unlink()
    source = open_recording(drive)
    about = source.description
    assert (about.format, about.vehicle) == ("kitti raw", "kitti_car")
    poses = {(e.parent, e.child): e.T_parent_child for e in about.extrinsics}
    np.testing.assert_allclose(poses["camera", "velodyne"], samples.T_CAMERA_LIDAR, atol=1e-9)
    np.testing.assert_allclose(poses["velodyne", "oxts"], samples.T_LIDAR_IMU, atol=1e-9)
    np.testing.assert_allclose(poses["camera", "image_00"], np.eye(4), atol=1e-12)
    # P = K [I | t]: (4.5 - 61 * 0.003) / 72.1 and (0.2 - 17 * 0.003) / 72.1
    np.testing.assert_allclose(poses["camera", "image_02"][:3, 3], (-0.0598752, -0.0020666, -0.003), atol=1e-6)
    (colour, grey) = about.cameras
    assert (colour.topic, colour.frame, colour.size_px) == ("camera/image_02", "image_02", samples.SIZE_PX)
    assert (colour.focal_px, colour.center_px, colour.distortion) == ((72.1, 72.1), (61.0, 17.0), (0.0,) * 5)
    assert grey.frame == "image_00"
    received = list(source.read())
    start = 1_317_042_145 * NS + 50_000_000
    assert [t for t, topic, _ in received if topic == "lidar/velodyne"] == [start, start + 2 * NS // 10]
    images = [(t, m) for t, topic, m in received if topic == "camera/image_02"]
    assert [t for t, _ in images] == [start + k * NS // 10 - 10_000_000 for k in range(3)]
    assert [m.bgr[5, 7].tolist() for _, m in images] == [[k, 100, 200] for k in range(3)]
    assert images[2][1].encoded == (drive / "image_02" / "data" / "0000000002.png").read_bytes()
    assert skipped(source) == {}


def test_unrectified_images_have_the_intrinsics_of_their_size(tmp_path: Path) -> None:
    drive = samples.write_raw(tmp_path)
    for k in range(3):
        samples.write_image(drive / "image_02" / "data" / f"{k:010d}.png", k, (139, 51))
    about = open_recording(drive).description
    assert (about.cameras[0].size_px, about.cameras[0].focal_px) == ((139, 51), (96.0, 96.0))
    assert about.cameras[0].distortion == (-0.3, 0.1, 0.001, 0.002, 0.0)
    pose = {e.child: e.T_parent_child for e in about.extrinsics}["image_02"]
    np.testing.assert_allclose(pose[:3, 3], (-0.06, 0.0, 0.0), atol=1e-12)


def test_oxts_values_and_unknown_values(tmp_path: Path) -> None:
    root = samples.write_tracking(tmp_path)
    unknown = OXTS.replace("0.05 0.06 4 9 6 4 4", "0 -1 4 -1 0 1 -1")
    (root / "training" / "oxts" / "0007.txt").write_text(f"{OXTS}\n{unknown}\n")
    source = open_recording(root)
    known_fix, unknown_fix = of_type(source, GnssFix)
    assert (known_fix.solution, known_fix.satellites) == (GnssSolution.RTK_FIXED, 9)
    assert known_fix.latitude_rad == pytest.approx(math.radians(49.0))
    assert known_fix.velocity_enu_mps.tolist() == [2.0, 1.0, 0.0]
    assert (known_fix.sigma_enu_m.tolist(), known_fix.sigma_velocity_mps, known_fix.heading_rad) == (
        [0.05] * 3,
        0.06,
        0.5,
    )
    assert (unknown_fix.solution, unknown_fix.satellites) == (GnssSolution.NONE, None)
    assert np.isnan([*unknown_fix.sigma_enu_m, *unknown_fix.velocity_enu_mps, unknown_fix.sigma_velocity_mps]).all()
    assert math.isnan(unknown_fix.heading_rad)
    sample = of_type(source, ImuSample)[0]
    assert sample.acceleration_mps2.tolist() == [0.3, 0.4, 9.8]
    assert sample.rate_radps.tolist() == [0.01, 0.02, 0.03]
    odom = of_type(source, Odometry)[0]
    np.testing.assert_allclose(odom.T_odom_base, transform((0, 0, 0), (0.01, -0.02, 0.5)), atol=1e-6)
    assert (odom.speed_mps, odom.lateral_mps, odom.yaw_rate_radps) == (2.2, 0.1, 0.44)
    assert odom.curvature_radpm == pytest.approx(0.2)


def break_label(root: Path) -> None:
    path = root / "training" / "label_02" / "0007.txt"
    path.write_text(path.read_text().replace("1 4 Car 0 1 0", "1 4 Car 0 1 0 9", 1))


def write(name: str, content: str | bytes) -> Callable[[Path], None]:
    data = content if isinstance(content, bytes) else content.encode()
    return lambda root: (root / "training" / name).write_bytes(data) and None


def write_odd_image(root: Path) -> None:
    samples.write_image(root / "training" / "image_02" / "0007" / "000002.png", 0, (99, 38))


NOT_FINITE = np.full(8, np.nan, "<f4").tobytes()
BAD_OXTS = f"{OXTS[:-2]}\n{OXTS}\n{OXTS.replace('49.0', '149.0')}\n"
# what is damaged → source, its skipped messages, text in the reason, messages left of topics
TRUTH = "truth_objects/velodyne"
TRACKING_DAMAGE = [
    (write("velodyne/0007/000001.bin", b"123"), ("0007", 1), "3 bytes", {"lidar/velodyne": 2}),
    (write("velodyne/0007/000001.bin", NOT_FINITE), ("0007", 1), "not finite", {"lidar/velodyne": 2}),
    (write("image_02/0007/000001.png", b"\x89PNG\r\n"), ("0007", 1), "is cut", {"camera/image_02": 2}),
    (write_odd_image, ("0007", 1), "99 x 38 instead of 124 x 38", {"camera/image_02": 2}),
    (break_label, ("0007.txt", 1), "0007.txt:3", {TRUTH: 2}),
    (write("label_02/0007.txt", "x y z\n"), ("0007.txt", None), "not a KITTI tracking label", {TRUTH: 0}),
    (write("calib/0007.txt", "R_rect 1 2 3\n"), ("0007.txt", None), "R_rect is not 9 numbers", {TRUTH: 0}),
    (write("calib/0007.txt", "R_rect 1 0 0 0 1 0 0 0 1\n"), ("0007.txt", None), "Tr_velo_to_cam", {TRUTH: 0}),
    (write("calib/0007.txt", "R_rect 1 0 0 0 2 0 0 0 1\n"), ("0007.txt", None), "no rotation", {"lidar/velodyne": 3}),
    (write("oxts/0007.txt", BAD_OXTS), ("oxts", 2), "OXTS", {"gnss/oxts": 1}),
    (write("oxts/0007.txt", b"\xff\xfe49.0"), ("0007.txt", None), "no ASCII", {"gnss/oxts": 0, "lidar/velodyne": 3}),
]


@pytest.mark.parametrize(("damage", "row", "says", "left"), TRACKING_DAMAGE)
def test_damaged_tracking_file_is_skipped_with_reason(
    tmp_path: Path, damage: Callable[[Path], None], row: tuple[str, int | None], says: str, left: dict[str, int]
) -> None:
    root = samples.write_tracking(tmp_path)
    damage(root)
    source = open_recording(root)
    counts = Counter(topic for _, topic, _ in source.read())
    assert {topic: counts[topic] for topic in left} == left
    assert row in skipped(source).items()
    assert says in reason_text(source)


def test_unknown_class_is_an_unknown_obstacle(tmp_path: Path) -> None:
    root = samples.write_tracking(tmp_path)
    path = root / "training" / "label_02" / "0007.txt"
    path.write_text(path.read_text().replace(" Car ", " Tree "))
    (truth, *_) = of_type(open_recording(root), TrueObjects)
    assert (truth.objects[0].label, truth.objects[0].role) == (ObstacleClass.UNKNOWN, "Tree 4")


def test_named_truth_must_be_readable(tmp_path: Path) -> None:
    root = samples.write_tracking(tmp_path / "a")
    sequence = root / "training" / "velodyne" / "0007"
    (root / "training" / "label_02" / "0007.txt").write_text("x\n")
    with pytest.raises(LogError, match=r"0007\.txt:1: not a KITTI tracking label"):
        open_recording(sequence, root)
    samples.write_text(tmp_path / "a" / "other" / "label_2" / "0007.txt", "x\n")
    with pytest.raises(LogError, match=r"training/label_02/0007\.txt.*found\); name the file"):
        open_recording(sequence, root)


@pytest.mark.parametrize("damage", ["times", "missing_time", "oxts", "image"])
def test_damaged_raw_file_keeps_the_rest(tmp_path: Path, damage: str) -> None:
    drive = samples.write_raw(tmp_path)
    times = drive / "velodyne_points" / "timestamps_end.txt"
    if damage == "times":
        times.write_bytes(b"\xff" * 20)
        expected, says = {"lidar/velodyne": 0, "camera/image_02": 3}, "timestamps_end.txt: is no ASCII"
    elif damage == "missing_time":
        times.write_text("\n".join(["2011-09-26 13:02:25.05", "2011-99-26 13:02:25.15", ""]))
        expected, says = {"lidar/velodyne": 1, "odom/oxts": 3}, "frame 2 has no time stamp"
    elif damage == "oxts":
        (drive / "oxts" / "data" / "0000000000.txt").write_text("1 2 3\n")
        expected, says = {"odom/oxts": 2}, "0000000000.txt: not an OXTS record"
    else:
        path = drive / "image_02" / "data" / "0000000001.png"
        path.write_bytes(path.read_bytes()[:-20])
        expected, says = {"camera/image_02": 2, "camera/image_00": 3}, "0000000001.png: image of"
    source = open_recording(drive)
    counts = Counter(topic for _, topic, _ in source.read())
    assert {topic: counts[topic] for topic in expected} == expected
    assert says in reason_text(source)


def test_plain_scans_not_readable(tmp_path: Path) -> None:
    for k, content in enumerate((b"", b"123", np.full(8, np.nan, "<f4").tobytes(), np.full(8, 1e9, "<f4").tobytes())):
        folder = tmp_path / str(k)
        folder.mkdir()
        (folder / "000000.bin").write_bytes(content)
        with pytest.raises(LogError, match=r"000000\.bin.*velodyne"):
            list(open_recording(folder).read())
    (tmp_path / "scan.bin").write_bytes(b"1234")
    with pytest.raises(LogError, match=r"no scan whose name is its number"):
        open_recording(tmp_path)
