"""The node that says how far one camera can be trusted, also when it falls silent or has no model."""

from collections.abc import Iterable

import numpy as np

from configs.vehicle import Camera
from messages.message import Float64, UInt8
from messages.motion import Odometry
from messages.node import Every, Inbox, Latest, Node, Output
from messages.perception import HealthState, Obstacles, SensorHealth
from messages.sensors import CameraImage
from perception.camera.image_quality import LensReport, inspect
from perception.camera.obstacles import CameraConfig, fits
from perception.camera.ranging import View


class CameraHealth(Node):
    """Inspects each picture of the camera `name` once and tells its state several times a second.

    Without a model (`has_model` False) the camera proves nothing and says so.
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
        view = View(camera)
        self._edges, self._horizon = view.sector_edges(config.lens.sectors), view.horizon_row()
        self._image: CameraImage | None = None
        self._report = self._blind("no picture yet")
        self._dropped = 0

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The state now."""
        image = inbox.last(self._topic, CameraImage)
        if image is not None and (self._image is None or image.stamp_ns != self._image.stamp_ns):
            self._report = self._inspect(image, inbox.latest("odom", Odometry))
            self._dropped += self._report.reason == "picture has the wrong size"
            self._image = image
        return ((self.writes[0], self._tell(now_ns, self._silence(now_ns, inbox) or self._report)),)

    def _inspect(self, image: CameraImage, odom: Odometry | None) -> LensReport:
        if not fits(image.bgr, self._camera):
            return self._blind("picture has the wrong size")
        moves = odom is not None and abs(odom.speed_mps) > self._config.lens.moving_mps
        if moves and self._image is not None and np.array_equal(image.bgr, self._image.bgr):
            return self._blind("sends the same picture again")
        return inspect(image.bgr, self._horizon, self._config.lens)

    def _silence(self, now_ns: int, inbox: Inbox) -> LensReport | None:
        """Why nothing can be said from old pictures, if so."""
        limit_ns = round(self._config.silent_s * 1e9)
        if self._image is not None and now_ns - self._image.stamp_ns > limit_ns:
            return self._blind("no picture any more")
        if not self._has_model:
            return self._blind("no model: nothing is detected") if self._report.state is not HealthState.BLIND else None
        obstacles = inbox.last(f"obstacles/{self._sensor}", Obstacles)
        if obstacles is None or now_ns - obstacles.stamp_ns > limit_ns:
            return None if self._report.state is HealthState.BLIND else self._blind("detector does not answer")
        return None

    def _blind(self, reason: str) -> LensReport:
        return LensReport(HealthState.BLIND, reason, np.zeros(self._config.lens.sectors, np.uint8))

    def _tell(self, now_ns: int, report: LensReport) -> SensorHealth:
        proven = proven_range(report.sees, self._config.lens.detection_range_m)
        return SensorHealth(
            now_ns, self._sensor, report.state, report.reason, self._edges.copy(), proven, self._dropped
        )


def proven_range(sees: UInt8, range_m: float) -> Float64:
    """Range (S,) within which a person would have been found."""
    return np.where(sees > 0, range_m, 0.0)
