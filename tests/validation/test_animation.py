"""Animation of a log: images show machine, points and protective field; unsuitable logs are refused."""

import io
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from configs.strict import CONFIGS, read_yaml
from datasets.log import LogWriter
from messages.command import Mode, SupervisorState
from messages.errors import LogError
from messages.message import Envelope, Message
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.sensors import LidarScan
from runtime.stack import load_stack
from validation.drive.animation import BACKGROUND, SIZE_PX, View, animate, webp

START_NS = 1_700_000_000_000_000_000
FIELD = np.array([[4.0, -3.0], [8.0, -3.0], [8.0, 3.0], [4.0, 3.0]])


def odometry(t_ns: int, x_m: float) -> Odometry:
    T = np.eye(4)
    T[0, 3] = x_m
    return Odometry(t_ns, T, 2.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))


def supervisor(t_ns: int, is_triggered: bool) -> SupervisorState:
    points = np.array([[5.0, 0.0, 1.0]] if is_triggered else np.empty((0, 3)), np.float32)
    return SupervisorState(
        t_ns, Mode.AUTOMATIC, "", (), ObstacleClass.UNKNOWN, math.inf, 3.7, 5.7, 40.0, 0.0, points, FIELD
    )


def scan(t_ns: int) -> LidarScan:
    nothing = np.empty(0)
    x, y = np.meshgrid(np.linspace(5.0, 30.0, 50), np.linspace(-10.0, 10.0, 40))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.95)]).astype(np.float32)
    none = np.empty((0, 0), np.uint16)
    return LidarScan(t_ns, none, nothing, nothing, points, np.empty(0, np.uint8), np.empty(0, np.float32))


def write_log(path: Path, has_configuration: bool = True, seconds: float = 3.0) -> Path:
    harrow = read_yaml(CONFIGS / "implements/harrow_6m.yaml")["implement"]
    values = {"machine": read_yaml(CONFIGS / "machines/tractor_e.yaml"), "implement": harrow}
    metadata = {"config": {"yaml": yaml.safe_dump(values)}} if has_configuration else {}
    with LogWriter(path, metadata, load_stack().datasets.log, None) as log:
        for k in range(round(seconds * 10)):
            t_ns = START_NS + k * 100_000_000
            messages: list[tuple[str, Message]] = [
                ("odom", odometry(t_ns, 0.2 * k)), ("supervisor", supervisor(t_ns, k >= 15)),
                ("lidar/front", scan(t_ns)),
            ]  # fmt: skip
            for topic, message in messages:
                log.write(Envelope(topic, k, t_ns, message))
    return path


def test_images_show_field_and_points(tmp_path: Path) -> None:
    images = animate(write_log(tmp_path / "log.mcap"), 0.0, 2.95, 1.0, 8.0)
    assert len(images) == 24
    assert {image.shape for image in images} == {(SIZE_PX[1], SIZE_PX[0], 3)}
    assert all((image != BACKGROUND).any(axis=2).sum() > 5000 for image in images[1:])
    blueness = [image[:, :, 0].astype(int) - image[:, :, 2] for image in images]
    blue, red = ([(sign * image > 40).sum() for image in blueness] for sign in (1, -1))
    assert blue[2] > 2 * blue[-2]
    assert red[-2] > 2 * red[2]


def test_webp_plays_at_its_rate(tmp_path: Path) -> None:
    data = webp(animate(write_log(tmp_path / "log.mcap"), 0.0, 1.5, 1.0, 8.0), 8.0, 50)
    image = Image.open(io.BytesIO(data))
    assert (image.format, image.size, image.n_frames) == ("WEBP", SIZE_PX, 13)
    image.seek(1)
    image.load()
    assert image.info["duration"] == 125


def test_projection_is_to_the_left_for_left_and_up_for_high() -> None:
    view = View(np.eye(4))
    pixels, depth = view.project(np.array([[10.0, 0.0, 0.0], [10.0, 2.0, 0.0], [10.0, 0.0, 2.0], [-40.0, 0.0, 0.0]]))
    assert pixels[0, 0] == pytest.approx(0.5 * SIZE_PX[0])
    assert pixels[1, 0] < pixels[0, 0]
    assert pixels[2, 1] < pixels[0, 1]
    assert depth[0] > 0.0 > depth[3]


def test_log_without_configuration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no configuration of its machine"):
        animate(write_log(tmp_path / "log.mcap", has_configuration=False), 0.0, 1.0, 1.0, 8.0)


def test_interval_after_the_end_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no odometry from 60\.0 s"):
        animate(write_log(tmp_path / "log.mcap"), 60.0, 1.0, 1.0, 8.0)
