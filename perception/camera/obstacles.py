"""The node that turns each picture of one camera into obstacles."""

from collections.abc import Iterable

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Camera, Implement, Vehicle
from messages.command import MachineState
from messages.message import Float64, Int64, UInt8
from messages.node import Inbox, Latest, Node, On, Output
from messages.perception import Obstacles
from messages.sensors import CameraImage
from perception.camera.boxes import Candidates, pick
from perception.camera.classes import class_scores, group_scores
from perception.camera.detector import Detector, DetectorConfig
from perception.camera.image_quality import LensConfig
from perception.camera.ranging import Ranged, RangingConfig, View, place
from perception.self_filter import is_folded, is_inside, own_outlines


class CameraConfig(Config):
    """The whole way from pictures to obstacles and health; the same for every camera."""

    detector: DetectorConfig
    ranging: RangingConfig
    lens: LensConfig
    silent_s: float = Field(
        gt=0.0, le=10.0, description="without a picture, or an answer of the detector, from which blind"
    )
    health_period_s: float = Field(gt=0.0, le=1.0)


class CameraObstacles(Node):
    """Runs on every picture of the camera `name`; only where a detector is. A picture of the wrong size is left alone.

    Its state is in `health/camera_<name>`, which `CameraHealth` writes.
    """

    def __init__(
        self, name: str, camera: Camera, vehicle: Vehicle, implement: Implement | None, detector: Detector,
        config: CameraConfig,
    ) -> None:  # fmt: skip
        self.name = f"camera_{name}"
        self.reads = {f"camera/{name}": Latest(), "machine": Latest()}
        self.writes = (f"obstacles/camera_{name}",)
        self.runs = On((f"camera/{name}",))
        self._topic, self._view, self._own = f"camera/{name}", View(camera), own_outlines(vehicle, implement)
        self._detector, self._config = detector, config

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """What the newest picture shows."""
        image = inbox.last(self._topic, CameraImage)
        if image is None or not fits(image.bgr, self._view.camera):
            return ()
        found = self._detector.detect(image.bgr)
        own = self._own[is_folded(inbox.latest("machine", MachineState))]
        obstacles = find_obstacles(found, image.stamp_ns, self.name, self._view, own, self._config)
        return ((self.writes[0], obstacles),)


def fits(bgr: UInt8, camera: Camera) -> bool:
    """Whether a picture has the size that the configuration says."""
    return bgr.shape == (camera.size_px[1], camera.size_px[0], 3)


def find_obstacles(
    candidates: Candidates, stamp_ns: int, sensor: str, view: View, own: Float64, config: CameraConfig
) -> Obstacles:
    """Candidates as obstacles of person, animal or vehicle on the ground; none in `own` (K, 2, 2)."""
    scores = group_scores(candidates.scores)
    boxes = pick(Candidates(candidates.corners_px, scores), config.detector.least_score, config.detector.most_iou)
    found = place(boxes, view, config.ranging)
    apart = np.flatnonzero(~is_inside(found.foot_m, own)).astype(np.int64)
    rows = found.row[apart]
    classes = [class_scores(int(g), float(s)) for g, s in zip(boxes.label[rows], boxes.score[rows], strict=True)]
    return _message(found, apart, np.array(classes, np.float64).reshape(-1, 7), stamp_ns, sensor)


def _message(found: Ranged, rows: Int64, classes: Float64, stamp_ns: int, sensor: str) -> Obstacles:
    foot, size, azimuth = found.foot_m[rows], found.size_m[rows], found.azimuth_rad[rows]
    center = np.concatenate([foot, size[:, 2:] / 2], axis=1)
    # a box is met where it begins, at the near end of what its range may be
    ahead = (size[:, :1] / 2 + found.sigma_m[rows, :1]) * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    nearest = np.concatenate([foot - ahead, size[:, 2:] / 2], axis=1)
    n = len(rows)
    return Obstacles(
        stamp_ns, sensor, stamp_ns, center, size, azimuth, nearest, np.full((n, 2), np.nan), classes,
        np.zeros(n + 1, np.int32), np.empty(0, np.int32), np.empty((0, 3), np.float32), found.sigma_m[rows],
    )  # fmt: skip
