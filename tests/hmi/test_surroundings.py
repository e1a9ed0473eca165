"""3-D view and camera images of the drive view: places of points and boxes, and what a feed gives them."""

import math
from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from configs.strict import CONFIGS, load
from configs.vehicle import ImplementFile, TrailedImplement
from datasets.log import LogWriter
from datasets.reader import LogScan
from geometry.arrays import Float64
from hmi.drive_view.map_view import moving_map
from hmi.drive_view.surroundings import RANGE_M, camera, image_box, lidar_points, panes, space, stamps, watched
from hmi.page_state import PageState
from hmi.texts import texts_of
from messages.command import Mode
from messages.errors import LogError
from messages.message import Envelope
from messages.motion import Odometry
from messages.perception import ObstacleClass, Track, Tracks
from messages.sensors import CameraImage, LidarScan
from runtime.live.ring import RingWriter, make_ring
from runtime.live.serialization import pack
from runtime.page.live_feed import LiveFeed
from runtime.page.log_feed import LogFeed
from runtime.stack import load_stack
from tests.hmi.drive_messages import NOW_NS, SECOND_NS, demo_scene, map_pose, odometry, state_of, supervisor

VEHICLE = demo_scene().vehicle
FRONT = VEHICLE.sensors.camera["front"]
LIDARS = frozenset(f"lidar/{name}" for name in VEHICLE.sensors.lidar)


def scan(points_m: Any, stamp_ns: int = NOW_NS) -> LidarScan:
    """List of points (N, 3) in the frame of the lidar."""
    return LidarScan(
        stamp_ns, np.zeros((0, 0), np.uint16), np.zeros(0), np.zeros(0), np.array(points_m, np.float32),
        np.zeros(0, np.uint8), np.zeros(0, np.float32),
    )  # fmt: skip


def in_lidar(name: str, point_base_m: Any) -> Float64:
    """A point of `base` in the frame of a lidar with the implement raised."""
    return np.asarray((np.linalg.inv(VEHICLE.sensors.lidar[name].mount.at_hitch(1.0)) @ [*point_base_m, 1.0])[:3])


def image(stamp_ns: int = NOW_NS, size_px: tuple[int, int] = FRONT.size_px) -> CameraImage:
    return CameraImage(stamp_ns, np.full((size_px[1], size_px[0], 3), 80, np.uint8))


def tracks(x_m: float, y_m: float, label: ObstacleClass = ObstacleClass.PERSON) -> Tracks:
    """One object of 0.5 m x 0.5 m x 1.8 m that stands on the ground of `odom`."""
    one = Track(
        1, label, 0.9, np.array([x_m, y_m, 0.9]), np.zeros(3), np.eye(4), np.array([0.5, 0.5, 1.8]), 0.0, NOW_NS,
        NOW_NS, True, ("lidar_front",),
    )  # fmt: skip
    return Tracks(NOW_NS, (one,))


def moving(speed_mps: float, yaw_rate_radps: float = 0.0) -> Odometry:
    base = odometry(0.0, 0.0)
    return Odometry(NOW_NS, base.T_odom_base, speed_mps, 0.0, 0.0, yaw_rate_radps, 0.0, np.eye(6))


def test_panes_are_those_of_the_machine() -> None:
    assert panes(VEHICLE) == ("map", "space", "camera/front")
    assert watched("map", VEHICLE) == frozenset()
    assert watched("space", VEHICLE) == LIDARS
    assert watched("camera/front", VEHICLE) == {"camera/front"}


def test_points_lie_where_the_lidars_see_them() -> None:
    """Of a lidar at the front and one that looks backwards; a return beyond the range is left out."""
    far = (RANGE_M + 5.0, 0.0, 0.0)
    state = state_of(
        ("odom", odometry(3.0, 4.0, 1.0)), ("lidar/front", scan([in_lidar("front", (8.0, 1.0, 0.2)), far])),
        ("lidar/rear", scan([in_lidar("rear", (-6.0, -2.0, 1.0))])),
    )  # fmt: skip
    assert lidar_points(state) == pytest.approx(np.array([[8.0, 1.0, 0.2], [-6.0, -2.0, 1.0]]), abs=1e-3)


def test_a_scan_of_half_a_second_ago_is_moved_with_the_machine() -> None:
    """At 2 m/s what stood 8 m ahead is 7 m ahead now; in a turn by 0.2 rad it is at that angle to the right."""
    before = scan([in_lidar("front", (8.0, 0.0, 0.0))], NOW_NS - SECOND_NS // 2)
    assert lidar_points(state_of(("odom", moving(2.0)), ("lidar/front", before)))[0, :2] == pytest.approx((7.0, 0.0))
    x_m, y_m, _ = lidar_points(state_of(("odom", moving(0.0, 0.4)), ("lidar/front", before)))[0]
    assert math.atan2(y_m, x_m) == pytest.approx(-0.2, abs=1e-6)


def test_old_scans_are_not_shown() -> None:
    state = state_of(("odom", odometry(0.0, 0.0)), ("lidar/front", scan([[5.0, 0.0, 0.0]], NOW_NS - 4 * SECOND_NS)))
    assert len(lidar_points(state)) == 0
    assert stamps(state, "space") == ()


def test_the_3d_view_has_points_in_centimetres_bodies_and_tracks() -> None:
    field = np.array([[3.5, -1.0], [9.0, -1.0], [9.0, 1.0], [np.nan, 1.0]])
    state = state_of(
        ("odom", odometry(0.0, 0.0)), ("lidar/front", scan([in_lidar("front", (8.0, 1.0, 0.25))])),
        ("tracks", tracks(6.0, 1.0)), ("supervisor", supervisor(Mode.AUTOMATIC, protective_field_base_m=field)),
    )  # fmt: skip
    shown = space(state, texts_of("en"))
    assert np.frombuffer(b64decode(shown["points"]), "<i2").tolist() == [800, 100, 25]
    assert len(shown["bodies"]) == 2
    assert shown["bodies"][1][4] == pytest.approx(demo_scene().implement.width_m)
    assert shown["tracks"] == [
        {"at": [6.0, 1.0, 0.9], "size": [0.5, 0.5, 1.8], "yaw": 0.0, "class": "person", "text": "Person 0.0\u202fm/s",
         "is_shown": True}
    ]  # fmt: skip
    assert shown["field"] == [[3.5, -1.0], [9.0, -1.0], [9.0, 1.0]]


def test_a_box_is_where_a_pinhole_camera_sees_it() -> None:
    """On the optical axis of a camera that looks down by 8 degrees, and at the edges of the image."""
    mount = FRONT.mount.T_base_sensor
    axis = (mount @ [10.0, 0.0, 0.0, 1.0])[:3]
    box = image_box(axis[None], FRONT, FRONT.size_px)
    assert box is not None
    assert box == pytest.approx([*FRONT.center_px, *FRONT.center_px], abs=1e-6)
    left = (mount @ [10.0, 2.0, 0.0, 1.0])[:3]
    half = image_box(np.array([axis, left]), FRONT, (FRONT.size_px[0] // 2, FRONT.size_px[1] // 2))
    cx, cy = FRONT.center_px
    assert half is not None
    assert half == pytest.approx([0.5 * (cx - 0.2 * FRONT.focal_px[0]), 0.5 * cy, 0.5 * cx, 0.5 * cy])
    for outside in ((-5.0, 0.0, 1.0), (8.0, 60.0, 1.0), (1.7, 0.0, 2.7)):  # behind, beside, at the lens
        assert image_box(np.array([outside]), FRONT, FRONT.size_px) is None


def test_lens_distortion_moves_a_box() -> None:
    bent = FRONT.model_copy(update={"distortion": (-0.3, 0.0, 0.0, 0.0, 0.0)})
    point = (FRONT.mount.T_base_sensor @ [10.0, 4.0, 0.0, 1.0])[:3][None]
    plain, found = (image_box(point, one, FRONT.size_px) for one in (FRONT, bent))
    assert plain is not None
    assert found is not None
    assert found[0] - plain[0] == pytest.approx(0.3 * 0.4**3 * FRONT.focal_px[0])


def test_the_camera_image_has_the_box_of_a_person_as_of_its_time() -> None:
    """The image is half a second old: the machine at 2 m/s was 1 m farther away, and the box is that much smaller."""
    heights = []
    for age_ns in (0, SECOND_NS // 2):
        state = state_of(("odom", moving(2.0)), ("camera/front", image(NOW_NS - age_ns)), ("tracks", tracks(9.0, 0.0)))
        shown = camera(state, "camera/front", texts_of("en"))
        assert shown is not None
        assert [one["text"] for one in shown["boxes"]] == ["Person 0.0\u202fm/s"]
        left, top, right, bottom = shown["boxes"][0]["box"]
        assert left < FRONT.center_px[0] < right
        heights.append(bottom - top)
    assert heights[1] / heights[0] == pytest.approx((9.0 - 1.6) / (10.0 - 1.6), rel=0.05)  # camera at 1.6 m
    jpeg = cv2.imdecode(np.frombuffer(b64decode(shown["jpeg"]), np.uint8), cv2.IMREAD_COLOR)
    assert jpeg.shape[1] == 960
    assert shown["size"] == list(FRONT.size_px)


def test_without_an_image_there_is_none() -> None:
    empty = CameraImage(NOW_NS, np.zeros((0, 0, 3), np.uint8))
    old = image(NOW_NS - 4 * SECOND_NS)
    for found in ((), (("camera/front", empty),), (("camera/front", old),)):
        assert camera(state_of(*found), "camera/front", texts_of("en")) is None


def test_a_running_drive_gives_the_newest_watched_scan(tmp_path: Path) -> None:
    make_ring(tmp_path / "machine", 1 << 20)
    ring, feed = RingWriter(tmp_path / "machine"), LiveFeed({"machine": tmp_path / "machine"})
    found = []
    for topics in ((), ("lidar/front",), ("lidar/rear",)):
        feed.watched = frozenset(topics)
        for k in range(3):
            ring.write(pack(("lidar/front", scan([[1.0, 0.0, 0.0]], NOW_NS + k))))
        found.append([(one.topic, one.message.stamp_ns) for one in feed.poll()])
    assert found == [[], [("lidar/front", NOW_NS + 2)], []]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """30 s of a scan and an image each 0.5 s, which fill several chunks."""
    noise = np.random.default_rng(1)
    with LogWriter(tmp_path / "log.mcap", {}, load_stack().datasets.log) as writer:
        for k in range(60):
            stamp_ns = NOW_NS + k * SECOND_NS // 2
            points = noise.normal(0.0, 10.0, (10_000, 3))
            for topic, message in (
                ("supervisor", supervisor(Mode.AUTOMATIC, stamp_ns=stamp_ns)), ("lidar/front", scan(points, stamp_ns)),
                ("camera/front", image(stamp_ns, (64, 36))),
            ):  # fmt: skip
                writer.write(Envelope(topic, k, stamp_ns, message))
    return tmp_path / "log.mcap"


def test_a_log_gives_the_watched_scan_at_its_position(log: Path) -> None:
    feed = LogFeed(log)
    feed.playback.is_paused = True

    def at(position_s: float) -> list[tuple[str, float]]:
        feed.playback.seek(position_s)
        found = [one for one in feed.poll() if one.topic != "supervisor"]
        return [(one.topic, (one.message.stamp_ns - NOW_NS) / SECOND_NS) for one in found]

    assert at(10.2) == []
    feed.watched = frozenset({"lidar/front"})
    assert at(10.2) == [("lidar/front", 10.0)]
    assert at(10.3) == []  # the same scan
    assert at(29.9) == [("lidar/front", 29.5)]
    assert at(0.2) == [("lidar/front", 0.0)]
    feed.watched = frozenset({"camera/front"})
    assert at(0.2) == [("camera/front", 0.0)]


def test_messages_of_a_time_are_read_from_their_chunks(log: Path) -> None:
    whole = LogScan(log)
    entries = [entry for entry in whole if entry.topic == "lidar/front"]
    for wanted in entries[::7]:
        found = whole.newest({"lidar/front"}, wanted.receive_ns + 100, SECOND_NS)
        assert found == {"lidar/front": wanted}
    assert whole.newest({"lidar/front"}, NOW_NS - 1, SECOND_NS) == {}
    assert whole.newest({"lidar/front"}, NOW_NS + 40 * SECOND_NS, SECOND_NS) == {}
    assert set(whole.newest({"lidar/front", "camera/front"}, NOW_NS + SECOND_NS, SECOND_NS)) == {
        "lidar/front",
        "camera/front",
    }


def test_a_log_that_was_not_closed_gives_them_too(log: Path) -> None:
    data = log.read_bytes()
    log.write_bytes(data[: int(0.7 * len(data))])
    cut = LogScan(log)
    last = [entry for entry in cut if entry.topic == "lidar/front"][-1]
    assert not cut.is_complete
    assert cut.newest({"lidar/front"}, last.receive_ns, SECOND_NS) == {"lidar/front": last}


def test_a_log_that_has_changed_is_refused(log: Path) -> None:
    whole = LogScan(log)
    list(whole)
    log.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with pytest.raises(LogError, match="has changed"):
        whole.newest({"lidar/front"}, NOW_NS + SECOND_NS, SECOND_NS)


def test_a_trailed_implement_is_shown_where_it_follows_the_driven_path() -> None:
    implement = load(ImplementFile, CONFIGS / "implements/disc_harrow_3m.yaml").implement
    assert isinstance(implement, TrailedImplement)
    state = PageState(replace(demo_scene(), implement=implement), 0.25)
    angle = np.linspace(0.0, 2.0, 300)  # along a circle with a radius of 8 m
    poses = [(8.0 * np.sin(a), 8.0 - 8.0 * np.cos(a), a) for a in angle]
    messages = [("map_pose", map_pose()), *(("odom", odometry(*map(float, pose))) for pose in poses)]
    state.take(NOW_NS, [Envelope(topic, 0, NOW_NS, message) for topic, message in messages])
    hitch_radius_m = np.hypot(8.0, implement.hitch_m)
    steady_rad = -np.arcsin(implement.axle_length_m / hitch_radius_m) + np.arctan(implement.hitch_m / 8.0)
    assert state.hitch_rad == pytest.approx(steady_rad, abs=0.02)
    box = space(state, texts_of("en"))["bodies"][1]
    assert box[6] == pytest.approx(state.hitch_rad, abs=0.006)
    middle = 0.5 * implement.total_length_m
    expected = [implement.hitch_m - middle * np.cos(state.hitch_rad), -middle * np.sin(state.hitch_rad)]
    assert box[:2] == pytest.approx(expected, abs=0.01)
    outline = np.array(moving_map(state, texts_of("en"))["bodies"][1])
    x, y, yaw = poses[-1]
    c, s = np.cos(yaw), np.sin(yaw)
    assert outline[:4].mean(axis=0) == pytest.approx(
        [x + c * expected[0] - s * expected[1], y + s * expected[0] + c * expected[1]], abs=0.02
    )
    state.take(NOW_NS, [Envelope("odom", 0, NOW_NS, odometry(90.0, 0.0))])
    assert state.hitch_rad == 0.0  # what was driven in between is unknown
