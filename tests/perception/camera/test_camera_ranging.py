"""Ranging of boxes on the ground: against forward projection, and disagreement of foot and height."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.strict import load, parse, read_yaml
from configs.vehicle import Camera, Mount, Vehicle
from messages.errors import ConfigError
from messages.perception import ObstacleClass
from perception.camera.boxes import Boxes, Candidates
from perception.camera.classes import COCO
from perception.camera.obstacles import CameraConfig, find_obstacles
from perception.camera.ranging import CameraGeometry, combine, locate
from perception.self_filter import own_outline

ROOT = Path(__file__).parents[3]
CONFIG = parse(CameraConfig, read_yaml(ROOT / "configs/stack/perception.yaml")["camera"], "stack/perception.yaml")
VEHICLE = load(Vehicle, ROOT / "configs" / "machines" / "tractor_e.yaml")


def camera(yaw_deg: float = 0.0, pitch_deg: float = 8.0, distortion: tuple[float, ...] = (0.0,) * 5) -> Camera:
    return Camera(
        mount=Mount(xyz_m=(2.0, 0.0, 2.6), rpy_deg=(0.0, pitch_deg, yaw_deg)), size_px=(1280, 720),
        focal_px=(763.0, 763.0), center_px=(640.0, 360.0), distortion=distortion, rate_hz=2.0,
    )  # fmt: skip


def project(cam: Camera, p_base_m: tuple[float, float, float]) -> np.ndarray:
    """Independent forward projection with Brown's polynomial."""
    T = np.linalg.inv(cam.mount.T_base_sensor)
    ahead, left, up = T[:3, :3] @ np.array(p_base_m) + T[:3, 3]
    x, y = -left / ahead, -up / ahead
    k1, k2, p1, p2, k3 = cam.distortion
    r2 = x * x + y * y
    k = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd, yd = x * k + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * k + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.array([cam.focal_px[0] * xd + cam.center_px[0], cam.focal_px[1] * yd + cam.center_px[1]])


def person(cam: Camera, x: float, y: float, height_m: float = 1.65, base_m: float = 0.0) -> np.ndarray:
    foot, head = project(cam, (x, y, base_m)), project(cam, (x, y, base_m + height_m))
    half = 0.25 / math.hypot(x - 2.0, y) * cam.focal_px[0]
    return np.array([foot[0] - half, head[1], foot[0] + half, foot[1]])


def boxes(*corners: np.ndarray, label: int = 0) -> Boxes:
    n = len(corners)
    return Boxes(np.array(corners).reshape(-1, 4), np.full(n, label, np.int64), np.full(n, 0.8))


@given(st.floats(6.0, 30.0), st.floats(-0.5, 0.5), st.floats(-170.0, 170.0), st.floats(4.0, 15.0))
@settings(derandomize=True, max_examples=100)
def test_position_of_person_of_mean_height(r: float, bearing: float, yaw: float, pitch: float) -> None:
    cam = camera(yaw, pitch)
    angle = bearing + math.radians(yaw)
    x, y = 2.0 + r * math.cos(angle), r * math.sin(angle)
    found = locate(boxes(person(cam, x, y)), CameraGeometry(cam), CONFIG.ranging)
    if len(found.row):  # head and foot are one column only without tilt: allow a hundredth
        np.testing.assert_allclose(found.foot_m[0], [x, y], atol=0.03 * r)
        assert abs(math.remainder(found.azimuth_rad[0] - angle, 2 * math.pi)) < 1e-6


def test_sigma_grows_with_distance() -> None:
    cam = camera()
    found = locate(boxes(*(person(cam, x, 0.0) for x in range(6, 40, 2))), CameraGeometry(cam), CONFIG.ranging)
    assert (np.diff(found.sigma_m[:, 0]) > 0).all()
    assert (np.diff(found.sigma_m[:, 1]) > 0).all()
    assert (found.sigma_m[:, 0] > found.sigma_m[:, 1]).all()
    assert found.sigma_m[0, 0] < 0.3
    assert found.sigma_m[-1, 0] > 2.0


def test_distortion_correction() -> None:
    cam = camera(distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))
    found = locate(boxes(person(cam, 9.0, 4.0)), CameraGeometry(cam), CONFIG.ranging)
    np.testing.assert_allclose(found.foot_m[0], [9.0, 4.0], atol=0.15)


def test_beyond_max_range_and_above_horizon() -> None:
    cam = camera()
    assert len(locate(boxes(person(cam, 60.0, 0.0)), CameraGeometry(cam), CONFIG.ranging).row) == 0
    up_a_hill = person(cam, 12.0, 0.0, base_m=3.0)  # feet above the horizon: range by size alone
    found = locate(boxes(up_a_hill), CameraGeometry(cam), CONFIG.ranging)
    assert found.foot_m[0, 0] == pytest.approx(12.0, abs=1.0)
    assert len(locate(boxes(np.array([100.0, 50.0, 120.0, 50.0])), CameraGeometry(cam), CONFIG.ranging).row) == 0
    assert len(locate(boxes(), CameraGeometry(cam), CONFIG.ranging).row) == 0


def test_smaller_range_on_disagreement() -> None:
    assert combine((10.0, 0.5), (10.4, 1.0), False, 2.5)[0] == pytest.approx(10.08)
    assert combine((10.0, 0.5), (20.0, 1.0), False, 2.5) == (10.0, 10.0)
    assert combine((30.0, 3.0), (12.0, 1.0), False, 2.5) == (12.0, 18.0)
    assert combine((3.0, 0.1), (2.9, 0.3), True, 2.5)[0] == 2.9  # feet below the image: both are upper bounds
    assert combine((math.inf, math.inf), (7.0, 1.0), False, 2.5) == (7.0, 1.0)
    assert combine((7.0, 1.0), (math.inf, math.inf), False, 2.5) == (7.0, 1.0)


def test_obstacles_message() -> None:
    cam = camera()
    corners = np.array([person(cam, 10.0, -3.0), person(cam, 10.0, 3.0)], np.float32)
    scores = np.zeros((2, 80), np.float32)
    scores[0, COCO.index("person")], scores[1, COCO.index("bird")] = 0.8, 0.9
    found = find_obstacles(
        Candidates(corners, scores), 7, "camera_x", CameraGeometry(cam), own_outline(VEHICLE, None), CONFIG
    )
    assert (found.stamp_ns, found.sensor, len(found.yaw_rad)) == (7, "camera_x", 1)
    order = list(ObstacleClass)
    assert found.class_scores[0, order.index(ObstacleClass.PERSON)] == pytest.approx(0.8, abs=1e-6)
    assert found.class_scores.sum() == pytest.approx(1.0)
    assert np.isnan(found.velocity_mps).all()
    np.testing.assert_allclose(found.center_base_m[0], [10.0, -3.0, 0.83], atol=0.03)
    gap = np.linalg.norm(found.center_base_m[0, :2] - found.nearest_base_m[0, :2])
    assert gap == pytest.approx(found.size_m[0, 0] / 2 + found.sigma_m[0, 0])
    assert (found.offsets.tolist(), found.indices.size) == ([0, 0], 0)


def test_hood_is_filtered() -> None:
    cam = camera(pitch_deg=30.0)
    scores = np.zeros((1, 80), np.float32)
    scores[0, COCO.index("truck")] = 0.9
    hood = np.array([[*project(cam, (3.2, 0.8, 0.0)), *project(cam, (3.2, -0.8, 0.0))]], np.float32)
    assert (
        len(
            find_obstacles(
                Candidates(hood, scores), 0, "c", CameraGeometry(cam), own_outline(VEHICLE, None), CONFIG
            ).yaw_rad
        )
        == 0
    )


@pytest.mark.parametrize("yaw", [0.0, 90.0, 180.0, -135.0])
def test_sector_edges(yaw: float) -> None:
    edges = CameraGeometry(camera(yaw, 0.0)).sector_edges(8)
    assert (np.diff(edges) > 0).all()
    assert edges[-1] - edges[0] == pytest.approx(2 * math.atan(640 / 763))
    assert abs(math.remainder(float(edges[4]) - math.radians(yaw), 2 * math.pi)) < 1e-9


def test_horizon_of_tilted_camera() -> None:
    assert CameraGeometry(camera(pitch_deg=0.0)).horizon_row() == pytest.approx(360.0)
    assert 150.0 < CameraGeometry(camera(pitch_deg=10.0)).horizon_row() < 300.0


def test_invalid_calibration_is_refused() -> None:
    good = camera().model_dump()
    for key, value in (("center_px", (1300.0, 360.0)), ("focal_px", (0.0, 763.0)), ("size_px", (0, 720)), ("fov", 80)):
        with pytest.raises(ConfigError, match=key):
            parse(Camera, good | {key: value}, "machine.yaml")
