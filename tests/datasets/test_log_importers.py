"""Importers: formats recognized by content, translation of messages, errors with file and value."""

import base64
import json
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore

from configs.strict import CONFIGS, parse, read_yaml
from datasets.importers import kitti_labels
from datasets.importers.formats import open_recording
from datasets.importers.mcap_logs import ros_types
from datasets.importers.pcd import read_pcd, unpack_lzf
from datasets.importers.recording import describe, numbered
from datasets.importers.write_recording import write_recording
from datasets.log import LogConfig, LogWriter
from datasets.primitives import cloud, frame, time_of
from datasets.reader import read_log, read_metadata
from datasets.summary import summarize_log
from datasets.viewer import ViewerConfig
from geometry.arrays import Float64
from geometry.transforms import invert, transform
from messages.command import CanFrames
from messages.errors import LogError
from messages.message import Envelope
from messages.motion import Odometry
from messages.sensors import GnssFix, GnssSolution, ImuSample, LidarScan, WheelSample
from messages.truth import TrueObject, TrueObjects
from tests.datasets.log_samples import bits
from tests.recordings import recording

LOG = LogConfig(chunk_kib=256, flush_s=1.0, sync_s=9.0, min_free_mb=0.0)
VIEW = parse(ViewerConfig, read_yaml(CONFIGS / "stack/datasets.yaml")["viewer"], "viewer")
NS = 1_000_000_000
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = ros_types("ROS1_NOETIC")
MOUNT = transform((1.0, 2.0, 3.0), (0.1, -0.2, 0.3))


# --- ROS in all containers


def ros_messages(store: Any, is_ros1: bool) -> Iterator[tuple[str, str, int, Any]]:
    """(topic, type, receive time, message) of a moving robot."""
    kind = store.types
    time = kind["builtin_interfaces/msg/Time"]

    def header(t: int, name: str) -> Any:
        fields = {"stamp": time(t // NS, t % NS), "frame_id": name} | ({"seq": 0} if is_ros1 else {})
        return kind["std_msgs/msg/Header"](**fields)

    vector, quaternion = kind["geometry_msgs/msg/Vector3"], kind["geometry_msgs/msg/Quaternion"]
    level, mount = quaternion(0.0, 0.0, 0.0, 1.0), quaternion(*quaternion_of(MOUNT))
    nine, many = np.arange(9.0), np.arange(36.0)
    stamped = kind["geometry_msgs/msg/TransformStamped"](
        header(0, "base_link"), "velodyne", kind["geometry_msgs/msg/Transform"](vector(*MOUNT[:3, 3]), mount)
    )
    yield "/tf_static", "tf2_msgs/msg/TFMessage", NS, kind["tf2_msgs/msg/TFMessage"]([stamped])
    for k in range(3):
        t = 5 * NS + k * NS // 10
        moving = kind["geometry_msgs/msg/TransformStamped"](
            header(t, "odom"), "base_link", kind["geometry_msgs/msg/Transform"](vector(float(k), 0.0, 0.0), level)
        )
        yield "/tf", "tf2_msgs/msg/TFMessage", t, kind["tf2_msgs/msg/TFMessage"]([moving])
        imu = kind["sensor_msgs/msg/Imu"](
            header(t, "imu"), level, nine, vector(0.1, 0.2, 0.3), nine, vector(1.0, 2.0, 9.8), nine
        )
        yield "/imu/data", "sensor_msgs/msg/Imu", t + 1, imu
        status = kind["sensor_msgs/msg/NavSatStatus"](2, 5)
        variance = np.diag([1e-4, 4e-4, 9e-4]).ravel()
        yield (
            "/fix",
            "sensor_msgs/msg/NavSatFix",
            t + 2,
            kind["sensor_msgs/msg/NavSatFix"](header(t, "gps"), status, 48.0, 11.0, 500.0, variance, 2),
        )
        point, twist = kind["geometry_msgs/msg/Point"], kind["geometry_msgs/msg/Twist"]
        pose = kind["geometry_msgs/msg/PoseWithCovariance"](
            kind["geometry_msgs/msg/Pose"](point(1.0, 2.0, 0.0), level), many
        )
        moved = kind["geometry_msgs/msg/TwistWithCovariance"](twist(vector(2.0, 0.1, 0.0), vector(0.0, 0.0, 0.5)), many)
        yield (
            "/odom",
            "nav_msgs/msg/Odometry",
            t + 3,
            kind["nav_msgs/msg/Odometry"](header(t, "odom"), "base_link", pose, moved),
        )
        yield "/points", "sensor_msgs/msg/PointCloud2", t + 4, cloud2(kind, header(t, "velodyne"))
        yield "/chatter", "std_msgs/msg/String", t + 5, kind["std_msgs/msg/String"]("hello")


POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u4"],
        "offsets": [0, 4, 8, 16, 20],
        "itemsize": 32,
    }
)
POINTS = np.array(
    [
        (1.0, 2.0, 3.0, 0.5, 0),
        (np.nan, 0.0, 0.0, 0.5, 0),
        (-4.0, 5.0, 0.5, 1.0, 60_000_000),
        (7.0, 8.0, 9.0, 0.0, 100_000_000),
    ],
    POINT,
)


def cloud2(kind: Any, header: Any) -> Any:
    field = kind["sensor_msgs/msg/PointField"]
    fields = [field(n, POINTS.dtype.fields[n][1], 6 if n == "t" else 7, 1) for n in POINTS.dtype.names]
    raw = np.frombuffer(POINTS.tobytes(), np.uint8)
    return kind["sensor_msgs/msg/PointCloud2"](header, 2, 2, fields, False, 32, 64, raw, False)


def quaternion_of(T: Float64) -> list[float]:
    from geometry.transforms import quaternion_of as q

    return q(T).tolist()


def write_ros1_bag(path: Path) -> Path:
    with Bag1(path) as bag:
        connections: dict[str, Any] = {}
        for topic, kind, t, message in ros_messages(ROS1, True):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=ROS1)
            bag.write(connections[topic], t, ROS1.serialize_ros1(message, kind))
    return path


def write_ros2_bag(path: Path) -> Path:
    with Bag2(path, version=8) as bag:
        connections: dict[str, Any] = {}
        for topic, kind, t, message in ros_messages(ROS2, False):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=ROS2)
            bag.write(connections[topic], t, ROS2.serialize_cdr(message, kind))
    return path


def write_ros2_mcap(path: Path) -> Path:
    with path.open("wb") as file:
        writer, channels = Writer(file, chunk_size=256), {}
        writer.start("ros2")
        for topic, kind, t, message in ros_messages(ROS2, False):
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], t, bytes(ROS2.serialize_cdr(message, kind)), t)
        writer.finish()
    return path


@pytest.mark.parametrize("make", [write_ros1_bag, write_ros2_bag, write_ros2_mcap])
def test_ros_in_all_containers(tmp_path: Path, make: Any) -> None:
    source = open_recording(make(tmp_path / "odd.name"))
    about = source.description
    assert {s.topic: s.frame for s in about.sensors} == {
        "imu/imu_data": "imu", "gnss/fix": "gps", "odom/odom": "base_link", "lidar/points": "velodyne"
    }  # fmt: skip
    assert [(i.source, i.source_type) for i in about.ignored] == [("/chatter", "std_msgs/msg/String")]
    (mount,) = about.extrinsics
    assert (mount.parent, mount.child) == ("base_link", "velodyne")
    np.testing.assert_allclose(mount.T_parent_child, MOUNT, atol=1e-12)
    received = list(source.read())
    assert Counter(topic for _, topic, _ in received) == {s.topic: 3 for s in about.sensors}
    assert [t for t, _, _ in received] == sorted(t for t, _, _ in received)
    check_ros_values({topic: m for t, topic, m in received[:4]})


def check_ros_values(first: dict[str, Any]) -> None:
    imu, fix, odom, scan = (first[t] for t in ("imu/imu_data", "gnss/fix", "odom/odom", "lidar/points"))
    assert isinstance(imu, ImuSample)
    assert imu.stamp_ns == 5 * NS
    assert imu.rate_radps.tolist() == [0.1, 0.2, 0.3]
    assert imu.acceleration_mps2.tolist() == [1.0, 2.0, 9.8]
    assert isinstance(fix, GnssFix)
    assert (fix.solution, fix.constellations) == (GnssSolution.RTK_FIXED, "BDS+GPS")
    assert np.degrees(fix.latitude_rad) == pytest.approx(48.0)
    np.testing.assert_allclose(fix.sigma_enu_m, [0.01, 0.02, 0.03])
    assert isinstance(odom, Odometry)
    assert (odom.speed_mps, odom.lateral_mps, odom.curvature_radpm) == (2.0, 0.1, 0.25)
    assert odom.T_odom_base[:3, 3].tolist() == [1.0, 2.0, 0.0]
    assert odom.covariance[0, 0] == 21.0  # rotation about x, fourth in ROS
    assert odom.covariance[0, 3] == 18.0
    assert isinstance(scan, LidarScan)
    assert scan.stamp_ns == 5 * NS + 100_000_000
    assert scan.points_m.tolist() == [[1.0, 2.0, 3.0], [-4.0, 5.0, 0.5], [7.0, 8.0, 9.0]]
    np.testing.assert_allclose(scan.point_offset_s, [-0.1, -0.04, 0.0], atol=1e-7)
    assert scan.intensity.tolist() == [128, 255, 0]


def test_truncated_ros_mcap(tmp_path: Path) -> None:
    path = write_ros2_mcap(tmp_path / "x.mcap")
    complete = list(open_recording(path).read())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    source = open_recording(path)
    left = list(source.read())
    assert 0 < len(left) < len(complete)
    assert [bits(m) for _, _, m in left] == [bits(m) for _, _, m in complete[: len(left)]]
    assert any("lost" in note for note in source.description.notes)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.data())
def test_changed_bag_yields_messages_or_error_with_file(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    good = tmp_path_factory.getbasetemp() / "good.bag"
    if not good.exists():
        write_ros1_bag(good)
    content = bytearray(good.read_bytes())
    at = data.draw(st.integers(13, len(content) - 1))
    content[at : at + 4] = data.draw(st.binary(min_size=1, max_size=4))
    bad = good.with_name("bad.bag")
    bad.write_bytes(content[: data.draw(st.integers(14, len(content)))])
    try:
        list(open_recording(bad).read())
    except LogError as error:
        text = str(error)
    else:
        return
    assert "bad.bag" in text


def test_unique_topic_names() -> None:
    topics = numbered([("/a/b", "imu"), ("/a_b", "imu"), ("a-b", "imu"), ("/a/b/", "gnss"), ("//", "gnss")])
    assert list(topics.values()) == ["imu/a_b", "imu/a_b_2", "imu/a_b_3", "gnss/a_b", "gnss/unnamed"]


# --- Foxglove


def test_foxglove_protobuf(tmp_path: Path) -> None:
    path = tmp_path / "fox"
    points = np.random.default_rng(0).uniform(-9, 9, (50, 3)).astype(np.float32)
    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for k in range(3):
            t = 7 * NS + k
            frames = [frame(t, "base", "top", MOUNT), frame(t, "map", "base", transform((k, 0, 0)))]
            writer.write_message("/tf", FrameTransforms(transforms=frames), t, t)
            writer.write_message("/top", cloud(t, "top", points, 100), t, t)
            fix = LocationFix(timestamp=time_of(t), frame_id="antenna", latitude=50.0, longitude=8.0, altitude=1.0)
            writer.write_message("/gps", fix, t, t)
    source = open_recording(path)
    assert {s.topic: s.frame for s in source.description.sensors} == {"lidar/top": "top", "gnss/gps": "antenna"}
    (mount,) = source.description.extrinsics
    assert (mount.parent, mount.child) == ("base", "top")
    np.testing.assert_allclose(mount.T_parent_child, MOUNT, atol=1e-12)
    first = {topic: m for _, topic, m in list(source.read())[:2]}
    np.testing.assert_allclose(first["lidar/top"].points_m, points, atol=0.01)
    assert np.isnan(first["gnss/gps"].sigma_enu_m).all()
    assert first["gnss/gps"].solution == GnssSolution.SINGLE


def test_foxglove_json_with_pose(tmp_path: Path) -> None:
    raw = np.array([[1.0, 2.0, 3.0]], "<f4")
    fields = [{"name": n, "offset": 4 * k, "type": 7} for k, n in enumerate("xyz")]
    message = {
        "timestamp": {"sec": 3, "nsec": 5}, "frame_id": "top", "point_stride": 12, "fields": fields,
        "pose": {"position": {"x": 10.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0, "y": 0, "z": 1, "w": 0}},
        "data": base64.b64encode(raw.tobytes()).decode(),
    }  # fmt: skip
    source = open_recording(write_json(tmp_path / "j.mcap", json.dumps(message).encode()))
    ((receive_ns, topic, scan),) = source.read()
    assert (receive_ns, topic, scan.stamp_ns) == (9, "lidar/points", 3 * NS + 5)
    np.testing.assert_allclose(scan.points_m, [[9.0, -2.0, 3.0]], atol=1e-6)
    for bad in (b"{", b"[]", b'{"timestamp": 3}', b'{"data": "!"}'):
        with pytest.raises(LogError, match=r"bad\.mcap.*points"):
            list(open_recording(write_json(tmp_path / "bad.mcap", bad)).read())


def write_json(path: Path, message: bytes) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(
            "/points", "json", writer.register_schema("foxglove.PointCloud", "jsonschema", b"{}")
        )
        writer.add_message(channel, 9, message, 9)
        writer.finish()
    return path


# --- Headland logs


def test_headland_log_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "own.mcap"
    with LogWriter(path, {}, LOG) as log:
        for k in range(50):
            log.write(Envelope("wheel", k, 10 + k, WheelSample(k, 1.0, 0.0)))
    source = open_recording(path)
    assert source.description.format == "headland"
    assert write_recording(source, tmp_path / "copy.mcap", LOG, VIEW) == {"wheel": 50}
    assert summarize_log(tmp_path / "copy.mcap").digest == summarize_log(path).digest
    assert "headland" in read_metadata(tmp_path / "copy.mcap")["source"]["description"]


# --- KITTI


def test_label_box_from_camera_to_lidar() -> None:
    T_camera_lidar = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, -0.3], [0, 0, 0, 1]])
    label = kitti_labels.Label(0, 7, "Car", 0, 0, (1.5, 1.6, 4.0), (2.0, 1.7, 10.0), -np.pi / 2)
    (box,) = kitti_labels.true_objects([label], 5, T_camera_lidar).objects
    np.testing.assert_allclose(box.center_map_m, [10.3, -2.0, -1.7 + 0.75])
    assert box.size_m.tolist() == [4.0, 1.6, 1.5]
    assert box.yaw_rad == pytest.approx(0.0)  # along the camera's z, the lidar's x
    across = kitti_labels.Label(0, 7, "Car", 0, 0, (1.5, 1.6, 4.0), (2.0, 1.7, 10.0), 0.0)
    assert kitti_labels.true_objects([across], 5, T_camera_lidar).objects[0].yaw_rad == pytest.approx(-np.pi / 2)


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


OXTS = (
    "49.0 8.4 112.0 0.01 -0.02 0.5 1.0 2.0 2.2 0.1 0.0 0.3 0.4 9.8 0.31 0.41 9.81 "
    "0.01 0.02 0.03 0.011 0.022 0.44 0.05 0.06 4 9 6 4 4"
)
TRACKING_CALIBRATION = (
    "P2: 1 0 0 0 0 1 0 0 0 0 1 0\nR_rect 1 0 0 0 1 0 0 0 1\nTr_velo_cam 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
    "Tr_imu_velo 1 0 0 -0.8 0 1 0 0.3 0 0 1 -0.8\n"
)


def velodyne(path: Path, points: int = 5) -> None:
    rows = np.tile(np.array([[5.0, 1.0, -1.0, 0.5]], "<f4"), (points, 1))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(rows.tobytes())


def write_tracking(root: Path) -> Path:
    for k in range(3):
        velodyne(root / "training" / "velodyne" / "0007" / f"{k:06d}.bin")
    files = {
        "calib": TRACKING_CALIBRATION,
        "oxts": "\n".join([OXTS] * 3),
        "label_02": "1 4 Cyclist 0 0 -1.5 0 0 9 9 1.7 0.6 1.8 1.0 1.0 9.0 0.0\n"
        "1 -1 DontCare -1 -1 -10 0 0 9 9 -1000 -1000 -1000 -10 -1 -1 -1\n",
    }
    for name, content in files.items():
        (root / "training" / name).mkdir(parents=True)
        (root / "training" / name / "0007.txt").write_text(content)
    return root


def test_kitti_tracking_by_root_and_sequence(tmp_path: Path) -> None:
    root = write_tracking(tmp_path / "kitti")
    for path in (root, root / "training", root / "training" / "velodyne" / "0007"):
        source = open_recording(path)
        assert source.description.format == "kitti tracking"
        received = list(source.read())
        assert [t for t, _, _ in received] == sorted(t for t, _, _ in received)
        truths = [m for _, _, m in received if isinstance(m, TrueObjects)]
        assert [len(t.objects) for t in truths] == [0, 1, 0]
        assert Counter(topic for _, topic, _ in received)["odom/oxts"] == 3
    (root / "training" / "velodyne" / "0008").mkdir()
    with pytest.raises(LogError, match=r"2 sequences.*name one"):
        open_recording(root)


def test_kitti_raw_times_and_calibration(tmp_path: Path) -> None:
    drive = tmp_path / "2011_09_26" / "drive"
    for k in (0, 2):
        velodyne(drive / "velodyne_points" / "data" / f"{k:010d}.bin")
    times = [f"2011-09-26 13:02:25.{k}51199337" for k in range(3)]
    (drive / "velodyne_points" / "timestamps_end.txt").write_text("\n".join(times) + "\n")
    (drive / "oxts" / "data").mkdir(parents=True)
    for k in range(3):
        (drive / "oxts" / "data" / f"{k:010d}.txt").write_text(OXTS + "\n")
    (drive / "oxts" / "timestamps.txt").write_text("\n".join(times) + "\n")
    pose = "R: 1 0 0 0 1 0 0 0 1\nT: 0.1 0.2 0.3\n"
    (drive.parent / "calib_velo_to_cam.txt").write_text("calib_time: 25-May\n" + pose)
    (drive.parent / "calib_imu_to_velo.txt").write_text(pose)
    (drive.parent / "calib_cam_to_cam.txt").write_text("R_rect_00: 1 0 0 0 1 0 0 0 1\n")
    source = open_recording(drive)
    assert source.description.format == "kitti raw"
    assert len(source.description.extrinsics) == 2
    received = list(source.read())
    scans = [(t, m) for t, topic, m in received if topic == "lidar/velodyne"]
    start = 1_317_042_145 * NS
    assert [t for t, _ in scans] == [start + 51_199_337, start + 251_199_337]
    assert scans[0][1].intensity.tolist() == [128] * 5
    fix = next(m for _, _, m in received if isinstance(m, GnssFix))
    assert (fix.solution, fix.satellites) == (GnssSolution.RTK_FIXED, 9)
    assert fix.velocity_enu_mps.tolist() == [2.0, 1.0, 0.0]
    odom = next(m for _, _, m in received if isinstance(m, Odometry))
    np.testing.assert_allclose(odom.T_odom_base[:3, 3], 0.0, atol=1e-6)
    assert odom.curvature_radpm == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("label_02/0007.txt", "0 1 Tree 0 0 0 0 0 9 9 1 1 1 0 0 9 0\n", "Tree"),
        ("label_02/0007.txt", "0 1 Car 0 0 0 0 0 9 9 1 1 nan 0 0 9 0\n", "nan"),
        ("label_02/0007.txt", "0 1 Car 0 0 0 0 0 9 9 1 1 x 0 0 9 0\n", "x"),
        ("calib/0007.txt", "R_rect 1 2 3\n", "R0_rect|R_rect"),
        ("calib/0007.txt", "R_rect 1 0 0 0 1 0 0 0 1\n", "Tr_velo_to_cam"),
        ("oxts/0007.txt", OXTS[:-2] + "\n", "OXTS"),
        ("oxts/0007.txt", OXTS.replace("49.0", "149.0") + "\n", "OXTS"),
    ],
)
def test_invalid_kitti_file_error_with_value(tmp_path: Path, name: str, content: str, says: str) -> None:
    root = write_tracking(tmp_path)
    (root / "training" / name).write_text(content)
    with pytest.raises(LogError, match=rf"{name.split('/')[1]}.*({says})"):
        list(open_recording(root).read())


def test_invalid_scans_refused(tmp_path: Path) -> None:
    for k, content in enumerate((b"", b"123", np.full(8, np.nan, "<f4").tobytes(), np.full(8, 1e9, "<f4").tobytes())):
        folder = tmp_path / str(k)
        folder.mkdir()
        (folder / "000000.bin").write_bytes(content)
        with pytest.raises(LogError, match=r"000000\.bin.*velodyne"):
            list(open_recording(folder).read())
    (tmp_path / "scan.bin").write_bytes(b"1234")
    with pytest.raises(LogError, match=r"scan\.bin"):
        open_recording(tmp_path)


# --- PCD


def test_pcd_storages(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    xyz = np.round(rng.uniform(-20, 20, (40, 3)), 3).astype("<f4")
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z _ intensity\nSIZE 4 4 4 1 4\nTYPE F F F U F\nCOUNT 1 1 1 4 1\n"
        "WIDTH 40\nHEIGHT 1\nPOINTS 40\nDATA "
    )
    shade = np.arange(40, dtype="<f4")
    rows = b"".join(p.tobytes() + b"\0" * 4 + s.tobytes() for p, s in zip(xyz, shade, strict=True))
    columns = b"".join(c.tobytes() for c in (xyz[:, 0], xyz[:, 1], xyz[:, 2])) + b"\0" * 160 + shade.tobytes()
    plain = b"".join(bytes([len(columns[k : k + 32]) - 1]) + columns[k : k + 32] for k in range(0, len(columns), 32))
    files = {
        "b.pcd": head.encode() + b"binary\n" + rows,
        "c.pcd": head.encode() + b"binary_compressed\n" + struct.pack("<II", len(plain), len(columns)) + plain,
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        scan = read_pcd(tmp_path / name, 3)
        np.testing.assert_array_equal(scan.points_m, xyz)
        assert scan.intensity.tolist() == list(range(40))
    text = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 40\nDATA ascii\n" + "\n".join(
        " ".join(map(str, p)) for p in xyz
    )
    (tmp_path / "a.pcd").write_text(text)
    np.testing.assert_array_equal(read_pcd(tmp_path / "a.pcd", 3).points_m, xyz)
    assert [t for t, _, _ in open_recording(tmp_path).read()] == [0, NS // 10, 2 * NS // 10]
    for bad in (b"VERSION 0.7\n", files["b.pcd"][:-1], files["c.pcd"][:-1], files["b.pcd"].replace(b" y ", b" q ", 1)):
        (tmp_path / "bad.pcd").write_bytes(bad)
        with pytest.raises(LogError, match=r"bad\.pcd"):
            read_pcd(tmp_path / "bad.pcd", 3)


def test_lzf_overlapping_references() -> None:
    assert unpack_lzf(bytes([1, 65, 66, (5 << 5) | 0, 1]), 9) == b"ABABABABA"
    assert unpack_lzf(bytes([0, 90, (7 << 5) | 0, 4, 0]), 14) == b"Z" * 14
    with pytest.raises(LogError, match="before its start"):
        unpack_lzf(bytes([0, 65, (1 << 5), 9]), 4)
    with pytest.raises(LogError, match="instead of"):
        unpack_lzf(bytes([0, 65]), 4)


def test_pcd_equals_packed_frame() -> None:
    (_, _, pcd), *_ = open_recording(recording("kitti-seq-pcd") / "frames" / "0000000000.pcd").read()
    (_, _, packed) = next(iter(open_recording(recording("kitti-seq-pcd")).read()))
    assert len(pcd.points_m) == len(packed.points_m)
    assert np.abs(pcd.points_m - packed.points_m).max() <= 0.0026


# --- CAN, unknown formats


def test_candump(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text(
        "(1.000001) can0 18FEF100#0102\n(1.019) can1 7FF#\n(1.019999) can0 0CF00400#FF\n(1.020001) can0 1#R\n"
    )
    received = list(open_recording(path).read())
    assert [(t, topic, len(m.frames)) for t, topic, m in received] == [
        (1_019_999_000, "can/can0", 2), (1_020_001_000, "can/can0", 1), (1_019_000_000, "can/can1", 1)
    ]  # fmt: skip
    assert received[0][2].frames[0].identifier == 0x18FEF100
    assert received[0][2].frames[0].data == b"\1\2"
    for bad in ("(1.0) can0 1#0", "(1.0) can0 1#" + "00" * 9, "hello", "(1.0) can0 XYZ#00"):
        path.write_text(f"(1.0) can0 1#00\n{bad}\n")
        with pytest.raises(LogError, match="x:2"):
            list(open_recording(path).read())


def test_tractor_can_log_complete() -> None:
    path = recording("jd-can-logs") / "tractoronSitUp.log"
    received = list(open_recording(path).read())
    assert all(isinstance(m, CanFrames) for _, _, m in received)
    assert sum(len(m.frames) for _, _, m in received) == len(path.read_text().split("\n")) - 1


def test_jackal_bag() -> None:
    source = open_recording(recording("robot-localization-bags") / "test" / "test2.bag")
    counts = Counter(topic for _, topic, _ in source.read())
    assert counts == {"imu/imu_data": 3061, "odom/jackal_velocity_controller_odom": 3060}


def test_unread_types_of_radar_bag() -> None:
    about = open_recording(recording("tier4-nebula") / "ars548" / "1708578204").description
    assert about.sensors == ()
    assert [i.source_type for i in about.ignored] == ["nebula_msgs/msg/NebulaPackets"]


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.binary(min_size=1, max_size=100))
def test_unknown_format_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "unknown"
    path.write_bytes(content)
    if not b"\x89MCAP0\r\n".startswith(content):
        with pytest.raises(LogError, match=r"unknown: no known recording format"):
            open_recording(path)


def test_missing_empty_and_unsuitable_inputs_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="nowhere"):
        open_recording(tmp_path / "nowhere")
    with pytest.raises(LogError, match="it holds nothing"):
        open_recording(tmp_path)
    (tmp_path / "empty").touch()
    with pytest.raises(LogError, match="is empty"):
        open_recording(tmp_path / "empty")
    (tmp_path / "can").write_text("(1.0) can0 1#00\n")
    with pytest.raises(LogError, match="candump"):
        open_recording(tmp_path / "can", tmp_path)
    with pytest.raises(LogError, match="no such truth"):
        open_recording(tmp_path / "can", tmp_path / "nowhere")


def test_failed_import_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "can").write_text("(1.0) can0 1#00\n(2.0) can0 1#00\n")
    source = open_recording(tmp_path / "can")
    (tmp_path / "can").write_text("(1.0) can0 1#00\n(2.0) can0 1#00\nbroken\n")
    with pytest.raises(LogError, match="can:3"):
        write_recording(source, tmp_path / "out.mcap", LOG, VIEW)
    assert not (tmp_path / "out.mcap").exists()
