"""Nodes of perception: per sensor of the vehicle, with and without model, and their load."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from configs.strict import find, load
from configs.vehicle import Camera, ImplementFile, Mount, Radar, Ultrasonic, Vehicle
from messages.errors import ConfigError
from messages.message import Envelope, Message
from messages.motion import Odometry
from messages.node import Node, Output, World
from messages.perception import HealthState, SensorHealth, Tracks
from messages.sensors import CameraImage, RadarScan, UltrasonicRange
from runtime.executor import Executor, check_wiring
from runtime.perception_nodes import perception_nodes
from runtime.stack import load_stack
from tests.perception.camera.onnx_files import write

STACK = load_stack()
HARROW = load(ImplementFile, find("implements", "harrow_6m")).implement
AHEAD = Mount(xyz_m=(3.3, 0.0, 1.0))
CAMERA = Camera(
    mount=Mount(xyz_m=(2.0, 0.0, 2.6), rpy_deg=(0.0, 8.0, 0.0)), size_px=(64, 64), focal_px=(40.0, 40.0),
    center_px=(32.0, 32.0), rate_hz=2.0,
)  # fmt: skip
RADAR = Radar(
    mount=AHEAD, field_of_view_deg=90.0, rate_hz=20.0, range_m=(0.3, 60.0), range_sigma_m=0.1, azimuth_sigma_deg=1.0,
    doppler_sigma_mps=0.1,
)  # fmt: skip
ULTRASONIC = Ultrasonic(mount=AHEAD, cone_deg=30.0, rate_hz=10.0, range_m=(0.2, 4.0), range_sigma_m=0.02)


def vehicle() -> Vehicle:
    bare = load(Vehicle, find("machines", "tractor_e"))
    more = {"camera": {"front": CAMERA}, "radar": {"front": RADAR}, "ultrasonic": {"left": ULTRASONIC}}
    return bare.model_copy(update={"sensors": bare.sensors.model_copy(update=more)})


def nodes(model: Path | None) -> list[tuple[Node, int]]:
    perception = STACK.perception
    detector = perception.camera.detector.model_copy(update={"model": str(model) if model else None})
    camera = perception.camera.model_copy(update={"detector": detector})
    found = perception_nodes(vehicle(), HARROW, perception.model_copy(update={"camera": camera}))
    return [(node, STACK.executor.latency_ns(node.name)) for node in found]


class MadeUp(World):
    """A machine at rest with a repeated echo and a repeated radar target."""

    writes = (
        "odom",
        "machine",
        "camera/front",
        "radar/front",
        "ultrasonic/left",
        "lidar/front",
        "lidar/front_left",
        "lidar/front_right",
        "lidar/rear",
    )

    def __init__(self, seconds: float) -> None:
        self._tick, self._ticks = 0, round(seconds * 100)

    def next_ns(self) -> int | None:
        return 10**9 + self._tick * 10_000_000 if self._tick < self._ticks else None

    def step(self, now_ns: int) -> Iterable[Output]:
        tick, self._tick = self._tick, self._tick + 1
        yield "odom", Odometry(now_ns, np.eye(4), 0.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))
        one, rng = np.ones(1), np.random.default_rng(tick)
        if tick % 5 == 0:
            yield "radar/front", RadarScan(now_ns, 12.0 * one, 0.0 * one, 0.0 * one, 0.0 * one, 0.0 * one)
        if tick % 10 == 0:
            yield "ultrasonic/left", UltrasonicRange(now_ns, 2.0)
        if tick % 50 == 0:
            yield "camera/front", CameraImage(now_ns, rng.integers(0, 255, (64, 64, 3), np.uint8))


def drive(found: list[tuple[Node, int]], seconds: float) -> dict[str, Message]:
    newest: dict[str, Message] = {}

    def watch(envelope: Envelope) -> None:
        assert not envelope.topic.startswith("fault"), envelope.message
        newest[envelope.topic] = envelope.message

    Executor(MadeUp(seconds), found, [watch]).run(lambda: False)
    return newest


def test_nodes_and_load_of_each_sensor(tmp_path: Path) -> None:
    model = write(tmp_path / "always.onnx", (1, 3, 64, 64), {"output": np.zeros((1, 84, 85), np.float32)})
    for file, eyes in ((None, 4), (model, 5)):
        found = nodes(file)
        tracker = found[-1][0]
        assert len([t for t in tracker.reads if t.startswith("obstacles/")]) == eyes
        check_wiring(MadeUp(0.0), found, STACK.executor.cores)


def test_tracks_from_radar_and_ultrasonic_alone() -> None:
    newest = drive(nodes(None), 2.0)
    tracks = newest["tracks"]
    assert isinstance(tracks, Tracks)
    assert {t.sensors for t in tracks.tracks if t.is_confirmed} == {("radar_front",), ("ultrasonic_left",)}


def test_camera_without_model_is_blind(tmp_path: Path) -> None:
    health = drive(nodes(None), 1.5)["health/camera_front"]
    assert isinstance(health, SensorHealth)
    assert (health.state, health.detection_range_m.max()) == (HealthState.BLIND, 0.0)
    assert health.reason == "no model: nothing is detected"
    model = write(tmp_path / "always.onnx", (1, 3, 64, 64), {"output": np.zeros((1, 84, 85), np.float32)})
    seen = drive(nodes(model), 1.5)
    assert "obstacles/camera_front" in seen
    health = seen["health/camera_front"]
    assert isinstance(health, SensorHealth)
    assert health.state is not HealthState.BLIND or "model" not in health.reason


def test_invalid_model_is_refused(tmp_path: Path) -> None:
    for file, words in ((tmp_path / "none.onnx", "no such model file"), (Path(__file__), "not a model")):
        with pytest.raises(ConfigError, match=words):
            nodes(file)
