"""Node: health of one camera, also without images or without a model."""

from collections.abc import Iterable

import numpy as np

from configs.vehicle import Camera
from geometry.arrays import Float64, UInt8
from messages.motion import Odometry
from messages.node import Every, Inbox, Latest, Node, Output
from messages.perception import HealthState, Obstacles, SensorHealth
from messages.sensors import CameraImage
from perception.camera.image_quality import ImageQuality, inspect
from perception.camera.obstacles import CameraConfig, has_configured_size
from perception.camera.ranging import CameraGeometry
from perception.repeated_output import is_repeated


class CameraHealth(Node):
    """Inspects each image of the camera `name` once and publishes its state periodically.

    Without a model (`has_model` False) the camera is BLIND.
    """

    def __init__(self, name: str, camera: Camera, has_model: bool, config: CameraConfig) -> None:
        self.name = f"health_camera_{name}"
        self.reads = {f"camera/{name}": Latest(), "odom": Latest()}
        if has_model:
            self.reads[f"obstacles/camera_{name}"] = Latest()
        self.writes = (f"health/camera_{name}",)
        self.runs = Every(round(config.health_period_s * 1e9))
        self._sensor, self._topic, self._camera, self._config = f"camera_{name}", f"camera/{name}", camera, config
        self._has_model = has_model
        model = CameraGeometry(camera)
        self._edges, self._horizon = model.sector_edges(config.image_quality.sectors), model.horizon_row()
        self._image: CameraImage | None = None
        self._report = self._blind("no image yet")
        self._rejected_count = 0

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The state now."""
        image = inbox.last(self._topic, CameraImage)
        if image is not None and (self._image is None or image.stamp_ns != self._image.stamp_ns):
            self._report = self._inspect(image, inbox.latest("odom", Odometry))
            self._rejected_count += self._report.reason == "image has the wrong size"
            self._image = image
        return ((self.writes[0], self._health_message(now_ns, self._unavailable(now_ns, inbox) or self._report)),)

    def _inspect(self, image: CameraImage, odom: Odometry | None) -> ImageQuality:
        if not has_configured_size(image.bgr, self._camera):
            return self._blind("image has the wrong size")
        moves = odom is not None and abs(odom.speed_mps) > self._config.image_quality.moving_mps
        if moves and self._image is not None and is_repeated((image.bgr, self._image.bgr)):
            return self._blind("sends the same image again")
        return inspect(image.bgr, self._horizon, self._config.image_quality)

    def _unavailable(self, now_ns: int, inbox: Inbox) -> ImageQuality | None:
        """BLIND report when images, model or detector output are missing, else None."""
        limit_ns = round(self._config.timeout_s * 1e9)
        if self._image is not None and now_ns - self._image.stamp_ns > limit_ns:
            return self._blind("no images any more")
        if not self._has_model:
            return self._blind("no model: nothing is detected") if self._report.state is not HealthState.BLIND else None
        obstacles = inbox.last(f"obstacles/{self._sensor}", Obstacles)
        if obstacles is None or now_ns - obstacles.stamp_ns > limit_ns:
            return None if self._report.state is HealthState.BLIND else self._blind("no detector output")
        return None

    def _blind(self, reason: str) -> ImageQuality:
        return ImageQuality(HealthState.BLIND, reason, np.zeros(self._config.image_quality.sectors, np.uint8))

    def _health_message(self, now_ns: int, report: ImageQuality) -> SensorHealth:
        range_m = detection_range(report.clear_sectors, self._config.image_quality.detection_range_m)
        return SensorHealth(
            now_ns, self._sensor, report.state, report.reason, self._edges.copy(), range_m, self._rejected_count
        )


def detection_range(clear_sectors: UInt8, range_m: float) -> Float64:
    """Range (S,) within which a person is detected; 0 in sectors that are not clear."""
    return np.where(clear_sectors > 0, range_m, 0.0)
