"""Node: obstacles from each image of one camera."""

from collections.abc import Iterable

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Camera, Implement, Vehicle
from geometry.arrays import Float64, Int64, UInt8
from messages.command import MachineState
from messages.node import Inbox, Latest, Node, On, Output
from messages.perception import ObstacleClass, Obstacles
from messages.sensors import CameraImage
from perception.camera.boxes import Candidates, non_max_suppression
from perception.camera.classes import class_scores, group_scores
from perception.camera.detector import Detector, DetectorConfig
from perception.camera.image_quality import ImageQualityConfig
from perception.camera.ranging import CameraGeometry, RangedBoxes, RangingConfig, locate
from perception.self_filter import is_folded, is_inside, own_outlines


class CameraConfig(Config):
    """Processing from images to obstacles and health; the same for every camera."""

    detector: DetectorConfig
    ranging: RangingConfig
    image_quality: ImageQualityConfig
    timeout_s: float = Field(
        gt=0.0, le=10.0, description="without image or detector output, after which the camera is BLIND"
    )
    health_period_s: float = Field(gt=0.0, le=1.0)


class CameraObstacles(Node):
    """Runs on every image of the camera `name`, with a detector; an image of the wrong size is ignored.

    The state is published by `CameraHealth` in `health/camera_<name>`.
    """

    def __init__(
        self, name: str, camera: Camera, vehicle: Vehicle, implement: Implement | None, detector: Detector,
        config: CameraConfig,
    ) -> None:  # fmt: skip
        self.name = f"camera_{name}"
        self.reads = {f"camera/{name}": Latest(), "machine": Latest()}
        self.writes = (f"obstacles/camera_{name}",)
        self.runs = On((f"camera/{name}",))
        self._topic, self._model, self._own = f"camera/{name}", CameraGeometry(camera), own_outlines(vehicle, implement)
        self._detector, self._config = detector, config

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Obstacles in the newest image."""
        image = inbox.last(self._topic, CameraImage)
        if image is None or not has_configured_size(image.bgr, self._model.camera):
            return ()
        found = self._detector.detect(image.bgr)
        own = self._own[is_folded(inbox.latest("machine", MachineState))]
        obstacles = find_obstacles(found, image.stamp_ns, self.name, self._model, own, self._config)
        return ((self.writes[0], obstacles),)


def has_configured_size(bgr: UInt8, camera: Camera) -> bool:
    """Whether an image has the configured size."""
    return bgr.shape == (camera.size_px[1], camera.size_px[0], 3)


def find_obstacles(
    candidates: Candidates, stamp_ns: int, sensor: str, model: CameraGeometry, own: Float64, config: CameraConfig
) -> Obstacles:
    """Persons, animals and vehicles on the ground from candidates; none within `own` (K, 2, 2)."""
    scores = group_scores(candidates.scores)
    boxes = non_max_suppression(
        Candidates(candidates.corners_px, scores), config.detector.min_score, config.detector.max_iou
    )
    found = locate(boxes, model, config.ranging)
    apart = np.flatnonzero(~is_inside(found.foot_m, own)).astype(np.int64)
    rows = found.row[apart]
    classes = [class_scores(int(g), float(s)) for g, s in zip(boxes.label[rows], boxes.score[rows], strict=True)]
    return _message(found, apart, np.array(classes, np.float64).reshape(-1, len(ObstacleClass)), stamp_ns, sensor)


def _message(found: RangedBoxes, rows: Int64, classes: Float64, stamp_ns: int, sensor: str) -> Obstacles:
    foot, size, azimuth = found.foot_m[rows], found.size_m[rows], found.azimuth_rad[rows]
    center = np.concatenate([foot, size[:, 2:] / 2], axis=1)
    # the nearest point lies one sigma before the box
    ahead = (size[:, :1] / 2 + found.sigma_m[rows, :1]) * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    nearest = np.concatenate([foot - ahead, size[:, 2:] / 2], axis=1)
    n = len(rows)
    return Obstacles(
        stamp_ns, sensor, stamp_ns, center, size, azimuth, nearest, np.full((n, 2), np.nan), classes,
        np.zeros(n + 1, np.int32), np.empty(0, np.int32), np.empty((0, 3), np.float32), found.sigma_m[rows],
    )  # fmt: skip
