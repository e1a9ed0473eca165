"""Viewer topics: Foxglove schemas, one frame tree, period of each topic."""

from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from benchmarks.log_write import seconds_of
from configs.site import Site
from configs.strict import CONFIGS, load, parse, read_yaml
from configs.vehicle import ImplementFile, Mount, TrailedImplement, Ultrasonic, Vehicle
from datasets import scenes
from datasets.log import LogConfig, LogWriter
from datasets.primitives import cloud
from datasets.summary import summarize_log
from datasets.viewer import Viewer, ViewerConfig
from messages.faults import Fault, Response, Severity
from messages.message import Envelope, Message
from messages.plan import Path as DrivePath
from messages.sensors import CameraImage, RadarScan, UltrasonicRange

SECONDS = 4


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load(Vehicle, CONFIGS / "machines" / "tractor_e.yaml")


@pytest.fixture(scope="module")
def log(vehicle: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    implement = load(ImplementFile, CONFIGS / "implements" / "harrow_6m.yaml").implement
    section = read_yaml(CONFIGS / "stack/datasets.yaml")
    viewer = Viewer(parse(ViewerConfig, section["viewer"], "viewer"), vehicle, implement, None)
    path = tmp_path_factory.mktemp("view") / "log.mcap"
    with LogWriter(path, {}, parse(LogConfig, section["log"], "log"), viewer) as writer:
        for envelopes in seconds_of(SECONDS, vehicle):
            for envelope in envelopes:
                writer.write(envelope)
    return path


def test_single_frame_tree_and_no_undecoded_message(log: Path, vehicle: Vehicle) -> None:
    summary = summarize_log(log)
    assert summary.is_complete
    assert summary.undecoded == 0
    assert summary.is_one_tree is True
    mounted = {f"lidar/{n}" for n in vehicle.sensors.lidar} | {f"gnss/{n}" for n in vehicle.sensors.gnss}
    assert {"map", "odom", "base", "implement", "imu"} | mounted <= set(summary.frames)


def test_viewer_topics_decode_with_frames_of_tree(log: Path) -> None:
    cloud_s = read_yaml(CONFIGS / "stack/datasets.yaml")["viewer"]["cloud_s"]
    frames, used, counts = set(summarize_log(log).frames), set(), Counter[str]()
    with log.open("rb") as file:
        for schema, channel, message, proto in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            if channel.topic.startswith("/view/"):
                assert schema.name.startswith(("foxglove.", "headland.v1.Plotted"))
                used |= {proto.frame_id} if hasattr(proto, "frame_id") else set()
                used |= {e.frame_id for e in getattr(proto, "entities", ())}
                counts[channel.topic] += 1
                assert abs(message.log_time - message.publish_time) < 1e9
    assert used <= frames
    assert used >= {"map", "odom", "base", "implement", "lidar/front", "lidar/rear"}
    assert counts["/view/lidar/front"] == pytest.approx(SECONDS / cloud_s, abs=1)
    assert counts["/view/field"] == pytest.approx(5 * SECONDS, abs=1)
    assert counts["/view/mounts"] == 1


def test_digest_independent_of_viewer(log: Path, vehicle: Vehicle, tmp_path: Path) -> None:
    with LogWriter(
        tmp_path / "bare.mcap", {}, LogConfig(chunk_kib=64, flush_s=1.0, sync_s=9.0, min_free_mb=0.0)
    ) as bare:
        for envelopes in seconds_of(SECONDS, vehicle):
            for envelope in envelopes:
                bare.write(envelope)
    assert bare.digest() == summarize_log(log).digest


def test_thinned_cloud_count_and_positions() -> None:
    rng = np.random.default_rng(0)
    for n, limit, kept in [(0, 10, 0), (10, 10, 10), (11, 10, 6), (5000, 2000, 1667)]:
        points = rng.uniform(-50, 50, (n, 3)).astype(np.float32)
        proto = cloud(1, "lidar/front", points, limit)
        assert isinstance(proto, PointCloud)
        back = np.frombuffer(proto.data, np.float32).reshape(-1, 3)
        assert len(back) == kept
        stride = -(-n // limit) or 1
        np.testing.assert_allclose(back, points[::stride], atol=0.5 / 64 + 1e-6)


def test_trailed_implement_behind_hitch(vehicle: Vehicle) -> None:
    implement = TrailedImplement(
        kind="trailed", name="x", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.0, axle_length_m=3.0, working_length_m=4.0, total_length_m=5.0,
    )  # fmt: skip
    mounts = {f.child_frame_id: f for f in scenes.mounts(7, vehicle, implement)}
    assert mounts["implement"].translation.x == -5.0
    assert mounts["lidar/rear"].rotation.z == pytest.approx(1.0)
    box = scenes.implement_scene(7, implement).entities[0].cubes[0]
    assert box.pose.position.x - 5.0 == pytest.approx(-3.5)
    assert box.size.x == 5.0
    turned = {f.child_frame_id: f for f in scenes.mounts(7, vehicle, implement, 0.5)}["implement"]
    assert (turned.translation.x, turned.translation.y) == pytest.approx((-1.0 - 4.0 * np.cos(0.5), -4.0 * np.sin(0.5)))
    assert turned.rotation.z == pytest.approx(np.sin(0.25))


def test_thinned_path_keeps_end() -> None:
    for n in (0, 1, 2, 6, 12):
        xy = np.stack([np.arange(n) * 0.1, np.zeros(n)], 1)
        zero = np.zeros(n)
        path = DrivePath(1, 1, 1, xy, zero, zero, zero, zero, np.zeros(n, np.uint8), (), np.zeros(n, np.int32), True)
        update = scenes.path_scene(1, path)
        assert isinstance(update, SceneUpdate)
        points = update.entities[0].lines[0].points
        if n:
            assert points[-1].x == pytest.approx(0.1 * (n - 1))


def test_faults_shown_recorded_topics_not() -> None:
    section = read_yaml(CONFIGS / "stack/datasets.yaml")
    viewer = Viewer(parse(ViewerConfig, section["viewer"], "viewer"), None, None, None)
    fault = Fault(5, "lidar.silent", "front", Severity.ALARM, True, Response.CONTROLLED_STOP, True, "silent", "stumm")
    ((topic, line),) = viewer.show(Envelope("fault", 0, 5, fault))
    assert topic == "/view/log"
    assert "lidar.silent" in line.message
    assert list(viewer.show(Envelope("/recorded/fault", 0, 5, fault))) == []
    assert FrameTransforms.DESCRIPTOR.full_name == "foxglove.FrameTransforms"


def shown(message: Message, topic: str, vehicle: Vehicle | None = None, site: Site | None = None) -> dict[str, Any]:
    section = read_yaml(CONFIGS / "stack/datasets.yaml")
    implement = load(ImplementFile, CONFIGS / "implements" / "harrow_6m.yaml").implement
    viewer = Viewer(parse(ViewerConfig, section["viewer"], "viewer"), vehicle, implement, site)
    return dict(viewer.show(Envelope(topic, 0, message.stamp_ns, message)))


def test_radar_detection_positions() -> None:
    scan = RadarScan(
        5, *(np.array(v) for v in ([10.0, 20.0], [np.pi / 2, 0.0], [0.0, np.pi / 6], [0.0, 1.0], [0.0, 0.0]))
    )
    proto = shown(scan, "radar/front")["/view/radar/front"]
    assert proto.frame_id == "radar/front"
    back = np.frombuffer(proto.data, np.float32).reshape(-1, 3)
    np.testing.assert_allclose(back, [[0.0, 10.0, 0.0], [17.3205, 0.0, 10.0]], atol=0.01)


@pytest.mark.parametrize(("range_m", "reach_m"), [(1.5, 1.5), (float("nan"), 4.0)])
def test_echo_arc_and_cone_without_echo(vehicle: Vehicle, range_m: float, reach_m: float) -> None:
    one = Ultrasonic(
        mount=Mount(xyz_m=(3.3, 0.0, 0.8)), cone_deg=60.0, rate_hz=10.0, range_m=(0.2, 4.0), range_sigma_m=0.02
    )
    equipped = vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"ultrasonic": {"left": one}})})
    proto = shown(UltrasonicRange(5, range_m), "ultrasonic/left", equipped)["/view/ultrasonic/left"]
    points = np.array([(p.x, p.y) for p in proto.entities[0].lines[0].points])
    np.testing.assert_allclose(np.hypot(*points[1:].T), reach_m)
    np.testing.assert_allclose(np.degrees(np.arctan2(points[[1, -1], 1], points[[1, -1], 0])), [-30.0, 30.0])
    assert "/view/ultrasonic/left" not in shown(UltrasonicRange(5, range_m), "ultrasonic/left")


def test_shed_with_posts_anchors_and_bays(vehicle: Vehicle) -> None:
    site = load(Site, CONFIGS / "sites" / "demo.yaml")
    assert site.shed is not None
    entity = shown(UltrasonicRange(5, 1.0), "ultrasonic/none", vehicle, site)["/view/shed"].entities[0]
    assert len(entity.cubes) == len(site.shed.posts) + len(site.shed.anchors)
    assert {t.text for t in entity.texts} == {*site.shed.anchors, *(f"bay {bay.name}" for bay in site.shed.bays)}


def test_image_shown_as_encoded() -> None:
    bgr = np.full((8, 8, 3), 90, np.uint8)
    sent = cv2.imencode(".png", bgr)[1].tobytes()
    proto = shown(CameraImage(5, bgr, sent), "camera/front")["/view/camera/front"]
    assert (proto.data, proto.format, proto.frame_id) == (sent, "png", "camera/front")
    assert shown(CameraImage(5, bgr.copy()), "camera/front")["/view/camera/front"].format == "jpeg"
