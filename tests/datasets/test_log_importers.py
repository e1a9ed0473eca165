"""Importers: formats recognized by content, translation of messages, errors with file and value."""

import base64
import copy
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
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
from datasets.importers.formats import open_recording
from datasets.importers.recording import Description, Received, Recording, Sensor, numbered
from datasets.importers.ros_messages import imu_sample
from datasets.importers.ros_types import ros_types
from datasets.importers.write_recording import write_recording
from datasets.log import LogConfig, LogWriter
from datasets.primitives import cloud, frame, time_of
from datasets.reader import read_metadata
from datasets.summary import summarize_log
from datasets.viewer import ViewerConfig
from geometry.arrays import Float64
from geometry.transforms import transform
from messages.command import CanFrames
from messages.errors import LogError
from messages.message import Envelope
from messages.motion import Odometry
from messages.sensors import GnssFix, GnssSolution, ImuSample, LidarScan, WheelSample
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
    assert {(i.source, i.count) for i in about.ignored} == {("/tf_static", 1), ("/tf", 3), ("/chatter", 3)}
    (mount,) = about.extrinsics
    assert (mount.parent, mount.child) == ("base_link", "velodyne")
    np.testing.assert_allclose(mount.T_parent_child, MOUNT, atol=1e-12)
    received = list(source.read())
    assert Counter(topic for _, topic, _ in received) == {s.topic: 3 for s in about.sensors}
    assert [t for t, _, _ in received] == sorted(t for t, _, _ in received)
    check_ros_values({topic: m for t, topic, m in received[:4]})


def test_imu_without_a_gyro() -> None:
    """A covariance that begins with -1 says that nothing was measured; one of zeros is unknown."""
    _, _, _, ros = next(m for m in ros_messages(ROS1, True) if "Imu" in m[1])
    fields = ("linear_acceleration_covariance", "acceleration_mps2"), ("angular_velocity_covariance", "rate_radps")
    for covariance, name in fields:
        changed = copy.deepcopy(ros)
        setattr(changed, covariance, np.array([-1.0, *np.zeros(8)]))
        sample = imu_sample(changed, 0)
        unknown = [of for _, of in fields if np.isnan(getattr(sample, of)).any()]
        assert unknown == [name]


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


# --- CAN, unknown formats


def test_candump(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text(
        "(1.000001) can0 18FEF100#0102\n(1.019) can1 7FF#\n(1.019999) can0 0CF00400#FF\n(1.020001) can0 1#\n"
    )
    received = list(open_recording(path).read())
    assert [(t, topic, len(m.frames)) for t, topic, m in received] == [
        (1_019_999_000, "can/can0", 2), (1_020_001_000, "can/can0", 1), (1_019_000_000, "can/can1", 1)
    ]  # fmt: skip
    assert received[0][2].frames[0].identifier == 0x18FEF100
    assert received[0][2].frames[0].data == b"\1\2"


def test_tractor_can_log_complete() -> None:
    path = recording("jd-can-logs") / "tractoronSitUp.log"
    received = list(open_recording(path).read())
    assert all(isinstance(m, CanFrames) for _, _, m in received)
    assert sum(len(m.frames) for _, _, m in received) == len(path.read_text().split("\n")) - 1


def test_jackal_bag() -> None:
    source = open_recording(recording("robot-localization-bags") / "test" / "test2.bag")
    counts = Counter(topic for _, topic, _ in source.read())
    assert counts == {"imu/imu_data": 3061, "odom/jackal_velocity_controller_odom": 3060}


def test_radar_bag_has_the_detections_of_its_truth() -> None:
    folder = recording("tier4-nebula") / "ars548"
    source = open_recording(folder / "1708578204")
    ((_, topic, scan),) = source.read()
    assert topic == "radar/sensing_radar_front_center_nebula_packets"
    truth = yaml.safe_load((folder / "1708578204_202447652_detection.yaml").read_text())
    assert abs(scan.stamp_ns - 1_708_578_204_202_447_652) < NS, "by the clock of the radar, which is synchronized"
    fields = {"range": scan.range_m, "azimuth_angle": scan.azimuth_rad, "range_rate": scan.doppler_mps}
    for name, values in fields.items():
        np.testing.assert_allclose(values, [d[name] for d in truth["detections"]], rtol=1e-5, atol=1e-5)
    (row,) = source.table()
    assert (row.read, row.skipped) == (1, 1), "one detection list, one list of objects"


def test_radar_bag_of_sick() -> None:
    source = open_recording(recording("devices/lidar/sick_scan_xd") / "rms_1xxx_lms_1xx_movement_off.bag")
    counts = Counter(topic for _, topic, _ in source.read())
    assert counts == {"lidar/sick_lms_1xx_scan": 89, "lidar/cloud": 89, "radar/cloud_radar_rawtarget": 139}
    skipped = {row.source: row.skipped for row in source.table() if row.skipped}
    assert skipped == {"/rosout": 35, "/sick_lms_1xx/parameter_descriptions": 1, "/sick_lms_1xx/parameter_updates": 1,
                       "/sick_rms_1xxx/parameter_descriptions": 1, "/sick_rms_1xxx/parameter_updates": 1,
                       "/cloud_radar_track": 108, "/diagnostics": 3, "/radar": 34, "/tf": 17}  # fmt: skip


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.binary(min_size=1, max_size=100))
def test_unknown_format_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "unknown"
    path.write_bytes(content)
    if not b"\x89MCAP0\r\n".startswith(content):
        with pytest.raises(LogError, match=r"unknown: "):
            list(open_recording(path).read())


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


def test_recording_one_level_deeper_is_named(tmp_path: Path) -> None:
    (tmp_path / "drive/lidar").mkdir(parents=True)
    (tmp_path / "drive/a.txt").write_text("notes")
    (tmp_path / "drive/lidar/1.xyz").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(LogError, match=r"it holds a.txt, lidar; give .*/drive/lidar \(point text\)"):
        open_recording(tmp_path / "drive")
    (tmp_path / "drive/lidar/1.xyz").unlink()
    with pytest.raises(LogError, match=r"it holds a.txt, lidar$"):
        open_recording(tmp_path / "drive")


def test_failed_import_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "can").write_text("(1.0) can0 1#00\n(2.0) can0 1#00\n")
    source = open_recording(tmp_path / "can")
    (tmp_path / "can").unlink()
    with pytest.raises(LogError, match="can: cannot be read"):
        write_recording(source, tmp_path / "out.mcap", LOG, VIEW)
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(("stamp_ns", "reason"), [(-5, "a time before 1970"), (1 << 63, "a time after 2262")])
def test_time_that_no_log_holds_is_skipped_and_counted(tmp_path: Path, stamp_ns: int, reason: str) -> None:
    messages: list[Received] = [(5, "wheel/a", WheelSample(ns, 1.0, 0.0)) for ns in (stamp_ns, 5)]
    about = Description("x", (Sensor("wheel/a", "", "/a", "Twist"),))
    source = Recording(tmp_path, about, lambda: iter(messages))
    assert write_recording(source, tmp_path / "out.mcap", LOG, VIEW) == {"wheel/a": 1}
    (row,) = source.table()
    assert (row.source, row.read, row.skipped, dict(row.reasons)) == ("/a", 1, 1, {reason: 1})
