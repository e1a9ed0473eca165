"""Camera node from image to message, with a constant network, and without valid images."""

from pathlib import Path

import numpy as np
import pytest

from configs.strict import load, parse, read_yaml
from configs.vehicle import Camera, ImplementFile, Mount, Vehicle
from messages.message import Envelope
from messages.perception import Obstacles
from messages.sensors import CameraImage
from perception.camera.detector import load_detector
from perception.camera.obstacles import CameraConfig, CameraObstacles
from perception.self_filter import is_inside, own_outline
from runtime.bus import NodeInbox
from tests.perception.camera.onnx_files import write

ROOT = Path(__file__).parents[3]
CONFIG = parse(CameraConfig, read_yaml(ROOT / "configs/stack/perception.yaml")["camera"], "stack/perception.yaml")
VEHICLE = load(Vehicle, ROOT / "configs" / "machines" / "tractor_e.yaml")
HARROW = load(ImplementFile, ROOT / "configs" / "implements" / "harrow_6m.yaml").implement
CAMERA = Camera(
    mount=Mount(xyz_m=(2.0, 0.0, 2.6), rpy_deg=(0.0, 8.0, 0.0)), size_px=(640, 640), focal_px=(400.0, 400.0),
    center_px=(320.0, 320.0), rate_hz=2.0,
)  # fmt: skip


@pytest.fixture
def node(tmp_path: Path) -> CameraObstacles:
    raw = np.zeros((1, 84, 85), np.float32)  # 64 x 64: 64 + 16 + 4 cells
    # stride 16, row 2, column 1: box of 1.6 x 6.4 input pixels about (22, 34), which are 10 of the image each
    raw[0, 64 + 9, :6] = (0.375, 0.125, np.log(0.1), np.log(0.4), 0.9, 1.0)
    file = write(tmp_path / "always.onnx", (1, 3, 64, 64), {"output": raw})
    detector = load_detector(file, CONFIG.detector)
    return CameraObstacles("front", CAMERA, VEHICLE, HARROW, detector, CONFIG)


def step(node: CameraObstacles, bgr: np.ndarray | None) -> list[tuple[str, Obstacles]]:
    inbox = NodeInbox(node)
    if bgr is not None:
        inbox.put(Envelope("camera/front", 0, 5, CameraImage(5, bgr)))
    return list(node.step(7, inbox))


def test_obstacles_from_image(node: CameraObstacles) -> None:
    ((topic, found),) = step(node, np.zeros((640, 640, 3), np.uint8))
    assert (topic, found.stamp_ns, found.sensor) == ("obstacles/camera_front", 5, "camera_front")
    # box 212 to 228 across, 308 to 372 down: feet 15.4 degrees below level, 2.6 m below the camera
    assert found.center_base_m[0, 0] == pytest.approx(2.0 + 9.7, abs=0.8)
    assert found.center_base_m[0, 1] == pytest.approx(9.7 * 0.25, abs=0.3)
    assert found.class_scores[0].argmax() == 1  # person


def test_no_output_without_valid_image(node: CameraObstacles) -> None:
    assert step(node, None) == []
    for shape in ((640, 640), (640, 639, 3), (0, 0, 3), (640, 640, 1)):
        assert step(node, np.zeros(shape, np.uint8)) == []


def test_own_outline_is_machine_and_implement() -> None:
    outline = own_outline(VEHICLE, HARROW)
    body = VEHICLE.body
    x = np.array([body.front_m - 0.01, body.front_m + 0.01, HARROW.rear_end_m + 0.01, HARROW.rear_end_m - 0.01])
    assert is_inside(np.stack([x, np.zeros(4)], axis=1), outline).tolist() == [True, False, True, False]
    assert is_inside(np.array([[-0.5, 2.0]]), own_outline(VEHICLE, None)).tolist() == [False]
    assert is_inside(np.zeros((0, 2)), outline).shape == (0,)
    assert is_inside(np.array([[body.front_m + 0.01, 0.0]]), own_outline(VEHICLE, None, 0.1)).tolist() == [True]
