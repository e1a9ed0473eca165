"""Point layouts of lidar and radar drivers: fields, times in all units, organized clouds, hostile values."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from datasets.importers.formats import open_recording
from datasets.importers.livox import decode_cdr, decode_ros1, scan_of_livox
from datasets.importers.point_clouds import read_points, scan_of_points
from datasets.importers.ros_messages import scan_of_cloud
from datasets.importers.ros_types import ROS1, ROS2, decoder_of, ros_types
from messages.errors import LogError

STAMP_NS = 1_700_000_000_123_456_789
STORE: Any = ros_types(ROS2)
SWEEP_S = np.array([0.0, 0.025, 0.0999])
XYZ = np.array([(1.0, 2.0, 3.0), (-4.0, 5.0, 0.5), (7.0, 8.0, 9.0)])
CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
# driver → fields in order with types, the last one is the time; its values for SWEEP_S
XYZF = [("x", "f4"), ("y", "f4"), ("z", "f4")]
ABSOLUTE_S = STAMP_NS * 1e-9
LAYOUTS: dict[str, tuple[list[tuple[str, str]], np.ndarray]] = {
    "velodyne": ([*XYZF, ("intensity", "f4"), ("ring", "u2"), ("time", "f4")], SWEEP_S),
    "velodyne before the stamp": ([*XYZF, ("intensity", "f4"), ("ring", "u2"), ("time", "f4")], SWEEP_S - 0.0999),
    "ouster": ([*XYZF, ("intensity", "f4"), ("reflectivity", "u2"), ("ring", "u1"), ("ambient", "u2"),
                ("range", "u4"), ("t", "u4")], SWEEP_S * 1e9),
    "hesai": ([*XYZF, ("intensity", "f4"), ("ring", "u2"), ("timestamp", "f8")], ABSOLUTE_S + SWEEP_S),
    "hesai, end of sweep": ([*XYZF, ("intensity", "f4"), ("timestamp", "f8")], ABSOLUTE_S + SWEEP_S - 0.0999),
    "robosense": ([*XYZF, ("intensity", "u1"), ("ring", "u2"), ("timestamp", "f8")], ABSOLUTE_S + SWEEP_S),
    "livox": ([*XYZF, ("intensity", "f4"), ("tag", "u1"), ("line", "u1"), ("timestamp", "f8")],
              STAMP_NS + SWEEP_S * 1e9),
    "livox offsets": ([*XYZF, ("intensity", "f4"), ("tag", "u1"), ("line", "u1"), ("offset_time", "u4")],
                      SWEEP_S * 1e9),
    "microseconds": ([*XYZF, ("time", "u4")], SWEEP_S * 1e6),
    "absolute microseconds": ([*XYZF, ("time_stamp", "f8")], (ABSOLUTE_S + SWEEP_S) * 1e6),
    "milliseconds": ([*XYZF, ("time", "f4")], SWEEP_S * 1e3),
}  # fmt: skip
LAST_S = {"velodyne before the stamp": 0.0, "hesai, end of sweep": 0.0}


def points_of(fields: list[tuple[str, str]], times: np.ndarray, xyz: np.ndarray = XYZ) -> Any:
    out: Any = np.zeros(len(xyz), fields)
    for k, name in enumerate("xyz"):
        out[name] = xyz[:, k]
    for name in ("intensity", "reflectivity"):
        if name in out.dtype.names:
            out[name] = 40
    out[fields[-1][0]] = times
    return out


def cloud_of(points: Any, width: int | None = None, row_padding: int = 0) -> Any:
    kind = STORE.types
    fields = [
        kind["sensor_msgs/msg/PointField"](n, points.dtype.fields[n][1], CODES[points.dtype[n].str[1:]], 1)
        for n in points.dtype.names
    ]
    time = kind["builtin_interfaces/msg/Time"](STAMP_NS // 10**9, STAMP_NS % 10**9)
    width = width or len(points)
    step, height = points.dtype.itemsize, len(points) // width
    rows = np.frombuffer(points.tobytes(), np.uint8).reshape(height, width * step)
    data = np.pad(rows, ((0, 0), (0, row_padding))).ravel()
    values = {
        "header": kind["std_msgs/msg/Header"](time, "lidar"), "height": height, "width": width, "fields": fields,
        "is_bigendian": False, "point_step": step, "row_step": width * step + row_padding, "data": data,
        "is_dense": True,
    }  # fmt: skip
    return kind["sensor_msgs/msg/PointCloud2"](**values)


@pytest.mark.parametrize("name", LAYOUTS)
def test_point_times(name: str) -> None:
    fields, times = LAYOUTS[name]
    scan = scan_of_cloud(cloud_of(points_of(fields, times)), STAMP_NS + 110_000_000)
    np.testing.assert_array_equal(scan.points_m, XYZ)
    assert scan.stamp_ns == pytest.approx(STAMP_NS + LAST_S.get(name, 0.0999) * 1e9, abs=2000)
    np.testing.assert_allclose(scan.point_offset_s, SWEEP_S - 0.0999, atol=2e-6)
    if len(fields) > 4:
        assert scan.intensity.tolist() == [40, 40, 40]


def test_stamp_at_end_of_sweep_by_reception() -> None:
    """Points 100 ms after a cloud that was received 8 ms after its stamp: the stamp is the end."""
    fields, times = LAYOUTS["velodyne"]
    cloud = cloud_of(points_of(fields, times))
    assert scan_of_cloud(cloud, STAMP_NS + 8_000_000).stamp_ns == STAMP_NS
    assert scan_of_cloud(cloud, STAMP_NS + 4).stamp_ns == pytest.approx(STAMP_NS + 99_900_000, abs=10)


def test_times_of_another_clock_count_back_from_the_stamp() -> None:
    scan = scan_of_cloud(cloud_of(points_of([*XYZF, ("timestamp", "f8")], SWEEP_S * 1e9 + 5e12)), STAMP_NS)
    assert scan.stamp_ns == STAMP_NS
    np.testing.assert_allclose(scan.offset_s, SWEEP_S - 0.0999, atol=1e-7)


@pytest.mark.parametrize(
    "times", [[np.nan, 0.0, 0.1], [np.inf, 0.0, 0.1], [0.0, 1e30, 0.1], [0.0, 3.0, 1.0], [7.0, 7.0, 7.0], [0, 0, 0]]
)
def test_implausible_times_are_not_used(times: list[float]) -> None:
    scan = scan_of_cloud(cloud_of(points_of([*XYZF, ("time", "f8")], np.array(times))), STAMP_NS)
    assert (scan.stamp_ns, scan.offset_s.size, len(scan.points_m)) == (STAMP_NS, 0, 3)


def test_times_need_not_be_in_order() -> None:
    order = [2, 0, 1]
    scan = scan_of_cloud(cloud_of(points_of([*XYZF, ("t", "u4")], SWEEP_S[order] * 1e9)), STAMP_NS)
    np.testing.assert_allclose(scan.offset_s, SWEEP_S[order] - 0.0999, atol=1e-7)


def test_organized_cloud_with_zeros_and_padded_rows() -> None:
    xyz = np.array([XYZ[0], [0, 0, 0], [np.nan, 0, 0], XYZ[1], [np.inf, 1, 1], [2e4, 0, 0]])
    points = points_of([*XYZF, ("t", "u4")], np.arange(6) * 1e7, xyz)
    for padding in (0, 13):
        scan = scan_of_cloud(cloud_of(points, 3, padding), STAMP_NS)
        np.testing.assert_array_equal(scan.points_m, XYZ[:2])
        np.testing.assert_allclose(scan.offset_s, [-0.03, 0.0], atol=1e-7)


def test_cloud_without_returns_is_an_empty_scan() -> None:
    scan = scan_of_cloud(cloud_of(points_of([*XYZF, ("t", "u4")], np.zeros(3), np.zeros((3, 3)))), STAMP_NS)
    assert (len(scan.points_m), scan.stamp_ns) == (0, STAMP_NS)
    empty = cloud_of(points_of([*XYZF, ("t", "u4")], SWEEP_S))
    empty.width, empty.data = 0, np.zeros(0, np.uint8)
    assert len(scan_of_cloud(empty, STAMP_NS).points_m) == 0


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"width": 2**31, "height": 2**31}, "holds 48 bytes only"),
        ({"width": 4}, "holds 48 bytes only"),
        ({"point_step": 0}, "of 0 bytes"),
        ({"point_step": 11, "width": 4}, "lies outside a point of 11 bytes"),
        ({"fields": []}, "without field 'x'"),
        ({"data": np.zeros(0, np.uint8)}, "holds 0 bytes only"),
    ],
)
def test_contradictory_cloud_refused(change: dict[str, Any], text: str) -> None:
    cloud = cloud_of(points_of([*XYZF, ("t", "u4")], SWEEP_S))
    for name, value in change.items():
        setattr(cloud, name, value)
    with pytest.raises(LogError, match=text):
        scan_of_cloud(cloud, STAMP_NS)


# --- Livox lists


def livox_points() -> list[tuple[int, float, float, float, int, int, int]]:
    return [(round(s * 1e9), *map(float, p), 40, 16, k) for k, (s, p) in enumerate(zip(SWEEP_S, XYZ, strict=True))]


def livox_ros1(count: int | None = None) -> bytes:
    head = struct.pack("<4I", 1, STAMP_NS // 10**9, STAMP_NS % 10**9, 11) + b"livox_frame"
    rows = b"".join(struct.pack("<I3f3B", *p) for p in livox_points())
    return head + struct.pack("<QI4BI", STAMP_NS, 3, 1, 0, 0, 0, 3 if count is None else count) + rows


def livox_cdr() -> bytes:
    head = struct.pack("<3I", STAMP_NS // 10**9, STAMP_NS % 10**9, 12) + b"livox_frame\0"
    rows = b"\0".join(struct.pack("<I3f3B", *p) for p in livox_points())
    return b"\0\1\0\0" + head + struct.pack("<QI4BI", STAMP_NS, 3, 1, 0, 0, 0, 3) + rows


@pytest.mark.parametrize(("decode", "data"), [(decode_ros1, livox_ros1()), (decode_cdr, livox_cdr())])
def test_livox_list(decode: Any, data: bytes) -> None:
    message = decode(data)
    assert message.header.frame_id == "livox_frame"
    scan = scan_of_livox(message, STAMP_NS + 110_000_000)
    np.testing.assert_array_equal(scan.points_m, XYZ)
    np.testing.assert_allclose(scan.offset_s, SWEEP_S - 0.0999, atol=1e-7)
    assert (scan.stamp_ns, scan.intensity.tolist()) == (STAMP_NS + 99_900_000, [40, 40, 40])
    for length in range(len(data)):
        with pytest.raises((LogError, struct.error)):
            decode(data[:length])


def test_livox_list_of_two_billion_points_refused() -> None:
    with pytest.raises(LogError, match="2147483648 points holds 57 bytes only"):
        decode_ros1(livox_ros1(2**31))


def test_livox_list_agrees_with_its_definition() -> None:
    """The bytes of the reader's test are those that rosbags writes by the definition of the driver."""
    text = "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nPoint[] points\n"
    point = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
    header = {
        ROS1: "uint32 seq\ntime stamp\nstring frame_id\n",
        ROS2: "builtin_interfaces/Time stamp\nstring frame_id\n",
    }
    for ros, data in ((ROS1, livox_ros1()), (ROS2, livox_cdr())):
        bar = "=" * 80
        definition = f"{text}{bar}\nMSG: own/Point\n{point}{bar}\nMSG: std_msgs/Header\n{header[ros]}"
        message = decoder_of(ros, "own/msg/List", definition)(data)
        assert message.header.frame_id == "livox_frame"
        assert [(p.offset_time, p.x, p.line) for p in message.points] == [(p[0], p[1], p[6]) for p in livox_points()]


# --- streams


def test_livox_and_radar_clouds_in_one_log(tmp_path: Path) -> None:
    doppler = points_of([*XYZF, ("rcs", "f4"), ("v_r", "f4")], np.array([1.0, -2.0, 0.5]))
    objects = points_of([*XYZF, ("vx", "f4"), ("vy", "f4")], np.zeros(3))
    cloud = "sensor_msgs/msg/PointCloud2"
    with (tmp_path / "x.mcap").open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        for topic, kind, raw in (
            ("/livox", "livox_ros_driver2/msg/CustomMsg", livox_cdr()),
            ("/radar", cloud, STORE.serialize_cdr(cloud_of(doppler), cloud)),
            ("/objects", cloud, STORE.serialize_cdr(cloud_of(objects), cloud)),
        ):
            channel = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", b""))
            for k in range(2):
                writer.add_message(channel, STAMP_NS + 200_000_000 + k, bytes(raw), STAMP_NS)
        writer.finish()
    source = open_recording(tmp_path / "x.mcap")
    messages = {topic: message for _, topic, message in source.read()}
    assert messages.keys() == {"lidar/livox", "radar/radar"}
    radar: Any = messages["radar/radar"]
    np.testing.assert_allclose(radar.range_m, np.linalg.norm(XYZ, axis=1))
    np.testing.assert_allclose(radar.azimuth_rad, np.arctan2(XYZ[:, 1], XYZ[:, 0]))
    assert radar.doppler_mps.tolist() == [1.0, -2.0, 0.5]
    (refused,) = [row for row in source.table() if not row.topic]
    assert (refused.source, refused.skipped) == ("/objects", 2)


def test_points_in_other_number_types() -> None:
    raw = np.array([(100, -200, 300)], [("x", ">i2"), ("y", ">i2"), ("z", ">i2")])
    points = read_points({n: (2 * k, ">i2") for k, n in enumerate("xyz")}, 6, 1, raw.tobytes())
    assert scan_of_points(points, 0).points_m.tolist() == [[100.0, -200.0, 300.0]]
