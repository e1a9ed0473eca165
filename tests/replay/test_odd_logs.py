"""Logs with defects: other scan rates, invalid points, messages out of order, other clocks, ROS bags."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from datasets.log import LogWriter
from datasets.reader import read_log
from geometry.transforms import quaternion_of
from messages.errors import ConfigError, LogError
from messages.message import Envelope
from messages.motion import Odometry
from messages.sensors import LidarScan
from runtime.replay.prepare import load_configuration, prepare
from runtime.replay.replay import replay
from runtime.stack import load_stack
from tests.replay.recorded_drive import LIDAR_X_M, VEHICLE, drive, vehicle_file
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.evaluation import evaluate_log
from validation.obstacle_stop.observer import Observer
from validation.obstacle_stop.totals import aggregate

CONDITIONS = load_conditions(None)
CONFIGURATION = load_configuration(CONDITIONS)
LOG = load_stack().datasets.log
Envelopes = list[Envelope]
ROS2 = get_typestore(Stores.ROS2_HUMBLE)


def evaluate(log: Path, vehicle: Path) -> dict:
    prepared = prepare(log, None, vehicle, CONFIGURATION)
    setting = prepared.setting("x")
    observer = Observer(setting, CONDITIONS)
    replay(prepared, [observer])
    has_truth = setting.truth_frame is not None
    return aggregate([evaluate_log("x", observer.finish(), has_truth, CONDITIONS)], CONDITIONS)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of driving towards a person."""
    return drive(tmp_path_factory.mktemp("odd") / "log.mcap", (20.0, 0.3), seconds=2.0)


def changed(log: Path, out: Path, change: Callable[[Envelopes], Envelopes]) -> Path:
    with LogWriter(out, {}, LOG) as writer:
        for envelope in change(list(read_log(log))):
            writer.write(envelope)
    return out


def as_points(envelope: Envelope) -> Envelope:
    """Scan as a point list with NaN and infinite points."""
    scan = envelope.message
    if not isinstance(scan, LidarScan):
        return envelope
    xyz, rng = scan.points_m.copy(), np.random.default_rng(envelope.sequence)
    xyz[rng.random(len(xyz)) < 0.1] = np.nan
    xyz[rng.random(len(xyz)) < 0.02] = np.inf
    none = np.zeros(0)
    points = xyz[:0] if envelope.sequence % 9 == 5 else xyz
    return replace(envelope, message=LidarScan(
        scan.stamp_ns, np.zeros((0, 0), np.uint16), none, none.copy(), points, np.zeros(0, np.uint8),
        np.zeros(0, np.float32),
    ))  # fmt: skip


def shuffled(envelopes: Envelopes) -> Envelopes:
    rng = np.random.default_rng(1)
    return sorted(envelopes, key=lambda e: e.receive_ns + rng.normal(0.0, 6e7))


ODD: dict[str, Callable[[Envelopes], Envelopes]] = {
    "not numbers": lambda es: [as_points(e) for e in es],
    "out of order": shuffled,
    "twice": lambda es: [e for e in es for _ in range(1 + (e.sequence % 4 == 1))],
    "another clock": lambda es: [replace(e, receive_ns=e.receive_ns + 5 * 10**12) for e in es],
    "late truth": lambda es: sorted(es, key=lambda e: e.receive_ns + 4e8 * e.topic.startswith("truth")),
}


@pytest.mark.parametrize("name", ODD)
def test_verdict_unchanged_by_log_defects(log: Path, tmp_path: Path, name: str) -> None:
    result = evaluate(changed(log, tmp_path / "odd.mcap", ODD[name]), vehicle_file(tmp_path))
    (encounter,) = result["encounters"]
    assert (encounter["outcome"], result["false_stops"], len(result["stops"])) == ("in time", 0, 1)
    assert encounter["clearance_m"] == pytest.approx(13.3, abs=0.4)


@pytest.mark.parametrize(("period_s", "seconds"), [(0.4, 3.2), (0.05, 2.0)])
def test_other_scan_rates(tmp_path: Path, period_s: float, seconds: float) -> None:
    slow = drive(tmp_path / "rate.mcap", (22.0, 0.3), seconds=seconds, period_s=period_s)
    assert [e["outcome"] for e in evaluate(slow, vehicle_file(tmp_path))["encounters"]] == ["in time"]


def test_person_within_stopping_distance_at_start_is_censored(tmp_path: Path) -> None:
    inside = evaluate(drive(tmp_path / "in.mcap", (8.0, 0.3), seconds=1.0), vehicle_file(tmp_path))
    assert ([e["outcome"] for e in inside["encounters"]], inside["state"]) == (["censored"], "not_shown")
    standing = evaluate(drive(tmp_path / "s.mcap", (9.0, 0.3), seconds=1.0, speed_mps=0.0), vehicle_file(tmp_path))
    assert [(e["outcome"], e["is_stop_requested"]) for e in standing["encounters"]] == [("not shown", False)]


def test_clock_jump_error_message(log: Path, tmp_path: Path) -> None:
    jump = changed(log, tmp_path / "j.mcap", lambda es: [replace(es[0], receive_ns=0), *es[1:]])
    with pytest.raises(LogError, match=r"\+1700000000 s after the previous message"):
        prepare(jump, None, vehicle_file(tmp_path), CONFIGURATION)


def write_bag(path: Path, log: Path, has_mount: bool, frames: tuple[str, ...] = ("base_link",)) -> Path:
    """The drive as a ROS 2 bag: point clouds, odometry per child frame and optionally the lidar mount."""
    kind: dict[str, Any] = ROS2.types

    def header(stamp_ns: int, frame: str) -> Any:
        time = kind["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        return kind["std_msgs/msg/Header"](time, frame)

    def vector(xyz: Any, name: str = "Vector3") -> Any:
        return kind[f"geometry_msgs/msg/{name}"](*map(float, xyz))

    def cloud(scan: LidarScan) -> Any:
        field = kind["sensor_msgs/msg/PointField"]
        fields = [field(name, 4 * k, 7, 1) for k, name in enumerate("xyz")]
        data, n = np.frombuffer(scan.points_m.tobytes(), np.uint8), len(scan.points_m)
        return kind["sensor_msgs/msg/PointCloud2"](
            header(scan.stamp_ns, "lidar_top"), 1, n, fields, False, 12, 12 * n, data, True
        )

    def odometry(odom: Odometry, frame: str) -> Any:
        turn = vector(quaternion_of(odom.T_odom_base), "Quaternion")
        pose = kind["geometry_msgs/msg/Pose"](vector(odom.T_odom_base[:3, 3], "Point"), turn)
        twist = kind["geometry_msgs/msg/Twist"](
            vector((odom.speed_mps, 0.0, 0.0)), vector((0.0, 0.0, odom.yaw_rate_radps))
        )
        many = np.zeros(36)
        return kind["nav_msgs/msg/Odometry"](
            header(odom.stamp_ns, "odom"), frame, kind["geometry_msgs/msg/PoseWithCovariance"](pose, many),
            kind["geometry_msgs/msg/TwistWithCovariance"](twist, many),
        )  # fmt: skip

    with Writer(path, version=9) as bag:
        named = {
            name: bag.add_connection(topic, name, typestore=ROS2)
            for topic, name in (
                ("/top/points", "sensor_msgs/msg/PointCloud2"), ("/tf_static", "tf2_msgs/msg/TFMessage"),
            )
        }  # fmt: skip
        rows = [(e.receive_ns, e.message) for e in read_log(log, {"odom", "lidar/points"})]
        if has_mount:
            level = vector((0.0, 0.0, 0.0, 1.0), "Quaternion")
            seat = kind["geometry_msgs/msg/Transform"](vector((LIDAR_X_M, 0.0, 1.8)), level)
            fixed = kind["geometry_msgs/msg/TransformStamped"](header(0, "base_link"), "lidar_top", seat)
            message = kind["tf2_msgs/msg/TFMessage"]([fixed])
            connection = named["tf2_msgs/msg/TFMessage"]
            bag.write(connection, rows[0][0], ROS2.serialize_cdr(message, connection.msgtype))
        odometries = {
            frame: bag.add_connection(f"/odometry_{frame}", "nav_msgs/msg/Odometry", typestore=ROS2) for frame in frames
        }
        clouds = named["sensor_msgs/msg/PointCloud2"]
        for receive_ns, ours in rows:
            if isinstance(ours, LidarScan):
                bag.write(clouds, receive_ns, ROS2.serialize_cdr(cloud(ours), clouds.msgtype))
                continue
            for frame, connection in odometries.items():
                bag.write(connection, receive_ns, ROS2.serialize_cdr(odometry(ours, frame), connection.msgtype))
    return path


def test_ros2_bag_with_vehicle_file(log: Path, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", log, has_mount=True)
    with pytest.raises(ConfigError, match=r"--vehicle FILE; required body\.front_m.*top_points\.elevation_deg"):
        prepare(bag, None, None, CONFIGURATION)
    file = tmp_path / "car.yaml"
    file.write_text(VEHICLE.replace(f"      mount: {{xyz_m: [{LIDAR_X_M}, 0.0, 1.8]}}\n", ""))
    prepared = prepare(bag, None, file, CONFIGURATION)
    (lidar,) = prepared.machine.vehicle.sensors.lidar.values()
    assert lidar.mount.xyz_m == pytest.approx((LIDAR_X_M, 0.0, 1.8))
    assert prepared.odometry.topic.startswith("odom/")
    result = evaluate(bag, file)
    assert (result["state"], result["missed"], len(result["stops"])) == ("not_shown", None, 1)
    assert result["encounters"][0]["entry_speed_mps"] == pytest.approx(6.0, abs=0.05)
    bare = write_bag(tmp_path / "bare", log, has_mount=False)
    with pytest.raises(ConfigError, match=r"missing sensors\.lidar\.points\.mount\.xyz_m\. There are no defaults"):
        prepare(bare, None, file, CONFIGURATION)


def test_sensors_bound_to_topics(log: Path, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", log, has_mount=False, frames=("wheels", "visual"))
    file = tmp_path / "car.yaml"

    def vehicle(lidar_topic: str, wheels: str = "") -> Path:
        file.write_text(VEHICLE.replace("    points:\n", f"    roof:\n      topic: {lidar_topic}\n") + wheels)
        return file

    two = r"no odometry is usable: the frame of odom/odometry_visual .*'visual'.*, odom/odometry_wheels .* is unknown"
    with pytest.raises(LogError, match=two):
        prepare(bag, None, vehicle("/top/points"), CONFIGURATION)
    wheels = "  wheels: {topic: /odometry_wheels, rate_hz: 10, speed_sigma_mps: 0.1, angle_sigma_deg: 1}\n"
    prepared = prepare(bag, None, vehicle("/top/points", wheels), CONFIGURATION)
    assert prepared.machine.lidars == {"roof": "lidar/roof"}
    assert (prepared.odometry.kind, prepared.odometry.topic) == ("topic", "odom/wheels")
    (encounter,) = evaluate(bag, file)["encounters"]
    assert encounter["entry_speed_mps"] == pytest.approx(6.0, abs=0.05)
    known = r"sensors\.lidar\.roof\.topic: no topic '/front'; the recording has .*/top/points \(lidar\)"
    with pytest.raises(LogError, match=known):
        prepare(bag, None, vehicle("/front", wheels), CONFIGURATION)
    with pytest.raises(LogError, match=r"sensors\.lidar\.roof\.topic: '/odometry_wheels' has messages of kind 'odom'"):
        prepare(bag, None, vehicle("/odometry_wheels"), CONFIGURATION)


def test_single_odometry_of_unknown_frame_is_named(log: Path, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", log, has_mount=False, frames=("visual",))
    prepared = prepare(bag, None, vehicle_file(tmp_path), CONFIGURATION)
    assert prepared.odometry.kind == "scans"
    unknown = "the frame of odom/odometry_visual (child frame 'visual') is unknown; sensors.wheels.topic"
    assert unknown in prepared.odometry.note
