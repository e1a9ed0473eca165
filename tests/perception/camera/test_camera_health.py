"""Image quality of photographs and synthetic images, and the states of the health node."""

from pathlib import Path

import cv2
import numpy as np

from configs.strict import parse, read_yaml
from configs.vehicle import Camera, Mount
from messages.message import Envelope, Message
from messages.motion import Odometry
from messages.perception import HealthState, Obstacles, SensorHealth
from messages.sensors import CameraImage
from perception.camera.health import CameraHealth
from perception.camera.image_quality import inspect
from perception.camera.obstacles import CameraConfig
from runtime.bus import NodeInbox
from tests.recordings import DATA, needs

ROOT = Path(__file__).parents[3]
CONFIG = parse(CameraConfig, read_yaml(ROOT / "configs/stack/perception.yaml")["camera"], "stack/perception.yaml")
CAMERA = Camera(
    mount=Mount(xyz_m=(2.0, 0.0, 2.6), rpy_deg=(0.0, 8.0, 0.0)), size_px=(640, 480), focal_px=(400.0, 400.0),
    center_px=(320.0, 240.0), rate_hz=2.0,
)  # fmt: skip
PHOTOGRAPHS = sorted((DATA / "coco128" / "train2017").glob("*.jpg"))
needs_photographs = needs("coco128")
S = 1_000_000_000


def field(seed: int = 0) -> np.ndarray:
    """Sky above a textured ground with a few edges."""
    rng = np.random.default_rng(seed)
    bgr = np.full((480, 640, 3), 200, np.uint8)
    bgr[160:] = np.clip(rng.normal(100, 30, (320, 640, 1)), 0, 255).astype(np.uint8)
    for x in range(0, 640, 80):
        bgr[150:, x : x + 20] = 40
    return bgr


def verdict(bgr: np.ndarray) -> tuple[HealthState, str]:
    report = inspect(bgr, 160.0, CONFIG.image_quality)
    return report.state, report.reason


@needs_photographs
def test_photographs_sharp_and_blurred() -> None:
    images = [cv2.imread(str(p)) for p in PHOTOGRAPHS[::4]]
    good = [verdict(p)[0] is not HealthState.BLIND for p in images]
    assert all(good)
    for sigma in (3.0, 4.0, 8.0):
        assert all("blurred" in verdict(cv2.GaussianBlur(p, (0, 0), sigma))[1] for p in images)


def test_reason_of_bad_images() -> None:
    assert verdict(field()) == (HealthState.GOOD, "")
    assert verdict(np.zeros((480, 640, 3), np.uint8)) == (HealthState.BLIND, "image is dark")
    assert verdict(field() // 12)[1] == "image is dark"
    assert verdict(np.full((480, 640, 3), 255, np.uint8))[1] == "image is overexposed"
    assert verdict(np.full((480, 640, 3), 128, np.uint8))[1] == "lens is covered"
    assert "blurred" in verdict(cv2.GaussianBlur(field(), (0, 0), 4.0))[1]


def test_covered_sectors() -> None:
    half = field()
    half[100:, :330] = 90  # mud over the left of the image
    report = inspect(half, 160.0, CONFIG.image_quality)
    assert report.state is HealthState.DEGRADED
    assert report.clear_sectors.tolist() == [1, 1, 1, 1, 0, 0, 0, 0]  # sectors run from right to left
    sky = field()
    sky[:160] = 255
    assert inspect(sky, 160.0, CONFIG.image_quality).state is HealthState.GOOD


class Bench:
    """Health node with an inbox of given messages."""

    def __init__(self, has_model: bool = True) -> None:
        self.node = CameraHealth("front", CAMERA, has_model, CONFIG)
        self.inbox = NodeInbox(self.node)

    def put(self, topic: str, message: Message) -> None:
        if topic in self.node.reads:
            self.inbox.put(Envelope(topic, 0, message.stamp_ns, message))

    def health(self, now_ns: int) -> SensorHealth:
        self.inbox.now_ns = now_ns
        ((topic, message),) = self.node.step(now_ns, self.inbox)
        assert topic == "health/camera_front"
        assert isinstance(message, SensorHealth)
        return message

    def see(self, stamp_ns: int, bgr: np.ndarray, speed_mps: float = 1.0) -> SensorHealth:
        self.put("camera/front", CameraImage(stamp_ns, bgr.copy()))
        self.put("odom", Odometry(stamp_ns, np.eye(4), speed_mps, 0.0, 0.0, 0.0, 0.0, np.zeros((6, 6))))
        none = np.empty((0, 3))
        self.put(
            "obstacles/camera_front",
            Obstacles(
                stamp_ns, "camera_front", stamp_ns, none, none, np.empty(0), none, np.empty((0, 2)), np.empty((0, 8)),
                np.zeros(1, np.int32), np.empty(0, np.int32), np.empty((0, 3), np.float32),
            ),
        )  # fmt: skip
        return self.health(stamp_ns + S // 10)


def test_detection_range_of_good_images() -> None:
    health = Bench().see(S, field())
    assert (health.state, health.sensor, health.rejected_count) == (HealthState.GOOD, "camera_front", 0)
    assert (health.detection_range_m == CONFIG.image_quality.detection_range_m).all()
    assert len(health.sector_edges_rad) == len(health.detection_range_m) + 1


def test_no_detection_range_without_model() -> None:
    health = Bench(has_model=False).see(S, field())
    assert (health.state, health.reason) == (HealthState.BLIND, "no model: nothing is detected")
    assert not health.detection_range_m.any()
    assert Bench(has_model=False).see(S, field() // 12).reason == "image is dark"


def test_timeout_of_camera_and_detector() -> None:
    bench = Bench()
    assert bench.health(S).reason == "no image yet"
    assert bench.see(2 * S, field()).state is HealthState.GOOD
    limit = 2 * S + round(CONFIG.timeout_s * S)
    assert bench.health(limit).state is HealthState.GOOD
    late = bench.health(limit + 1)
    assert (late.state, late.reason) == (HealthState.BLIND, "no images any more")
    assert not late.detection_range_m.any()
    without_detector = Bench()
    without_detector.put("camera/front", CameraImage(S, field()))
    assert without_detector.health(S).reason == "no detector output"


def test_frozen_image_while_moving() -> None:
    bench = Bench()
    assert bench.see(S, field()).state is HealthState.GOOD
    assert bench.see(2 * S, field(), speed_mps=0.0).state is HealthState.GOOD
    assert bench.see(3 * S, field()).reason == "sends the same image again"
    assert bench.see(4 * S, field(1)).state is HealthState.GOOD


def test_image_size_mismatch_is_counted() -> None:
    bench = Bench()
    for i, shape in enumerate(((480, 640), (480, 640, 4), (720, 1280, 3), (0, 0, 3))):
        health = bench.see((i + 1) * S, np.zeros(shape, np.uint8))
        assert (health.state, health.reason, health.rejected_count) == (
            HealthState.BLIND,
            "image has the wrong size",
            i + 1,
        )
