"""Viewer topics `/view/...` of a log, for Foxglove, Lichtblick, Rerun or PlotJuggler.

Frame tree: map → odom → base → implement and sensors. Each topic has its own period; static topics are repeated, so
that they are present after a seek.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.message import Message as Proto
from pydantic import Field

from configs.site import Site
from configs.strict import Config
from configs.vehicle import FOLDED, Camera, Implement, TrailedImplement, Vehicle
from datasets import scenes
from datasets.codec import proto_message
from datasets.importers.recording import CameraCalibration
from datasets.plots import PlottedEvent, plotted_pose, plotted_state, stop_request
from datasets.primitives import cloud, compressed_image, frame
from geometry.drawbar import Follower
from geometry.pose2 import Pose2
from messages.command import MachineState, SupervisorState
from messages.faults import Fault
from messages.message import Envelope
from messages.motion import MapPose, Odometry
from messages.perception import Tracks
from messages.plan import Path
from messages.sensors import CameraImage, GnssFix, LidarScan, RadarScan, UltrasonicRange
from messages.truth import TrueObjects

Shown = tuple[str, Proto]
# Share of a period after which the next message is shown: stamps jitter.
SLACK = 0.9


class ViewerConfig(Config):
    """Periods of the viewer topics, points per scan, image quality."""

    points: int = Field(ge=1, le=1_000_000)
    cloud_s: float = Field(gt=0.0, le=60.0)
    frames_s: float = Field(gt=0.0, le=60.0)
    scene_s: float = Field(gt=0.0, le=60.0)
    static_s: float = Field(gt=0.0, le=3600.0)
    image_s: float = Field(gt=0.0, le=60.0)
    image_quality: int = Field(ge=1, le=100, description="of JPEG")


class Viewer:
    """Converts messages to viewer topics; vehicle, implement and site are optional.

    `calibrations` are the intrinsics of a recording, for cameras that the vehicle does not have.
    """

    def __init__(
        self, config: ViewerConfig, vehicle: Vehicle | None, implement: Implement | None, site: Site | None,
        calibrations: Iterable[CameraCalibration] = (),
    ) -> None:  # fmt: skip
        self._config = config
        own = vehicle.sensors.camera if vehicle is not None else {}
        self._cameras: dict[str, Camera | CameraCalibration] = {one.topic: one for one in calibrations}
        self._cameras |= {f"camera/{name}": camera for name, camera in own.items()}
        self._motion = math.nan, math.nan
        self._stop_code = ""
        self._vehicle, self._implement, self._site = vehicle, implement, site
        self._height_m = vehicle.body.height_m if vehicle is not None else 2.0
        self._shown_at_ns: dict[str, int] = {}
        self._is_folded = False
        self._follower: Follower | None = None
        if isinstance(implement, TrailedImplement):
            self._follower = Follower(implement.hitch_m, implement.axle_length_m)
        self._handlers: dict[type, Callable[[str, Any], Iterator[Shown]]] = {
            LidarScan: self._show_scan,
            CameraImage: self._show_image,
            RadarScan: self._show_radar,
            UltrasonicRange: self._show_echo,
            MachineState: self._update_fold,
            Odometry: self._show_odometry,
            MapPose: self._show_map_pose,
            Tracks: self._show_tracks,
            TrueObjects: self._show_truth,
            SupervisorState: self._show_state,
            Path: self._show_path,
            GnssFix: self._show_fix,
            Fault: self._show_fault,
        }

    def show(self, envelope: Envelope) -> Iterator[Shown]:
        """Viewer topics of a message, as (topic, Foxglove message)."""
        message = envelope.message
        if self._is_due("static", message.stamp_ns, self._config.static_s):
            yield from self._show_static(message.stamp_ns)
            for name, camera in self._cameras.items():
                calibration = scenes.calibration(message.stamp_ns, scenes.optical_frame(name), camera)
                yield f"/view/{name}/calibration", calibration
        handler = self._handlers.get(type(message))
        if handler is not None and not envelope.topic.startswith("/"):
            yield from handler(envelope.topic, message)

    def _is_due(self, name: str, stamp_ns: int, period_s: float) -> bool:
        last = self._shown_at_ns.get(name)
        if last is not None and 0 <= stamp_ns - last < SLACK * period_s * 1e9:
            return False
        self._shown_at_ns[name] = stamp_ns
        return True

    def _show_static(self, stamp_ns: int) -> Iterator[Shown]:
        if self._vehicle is not None:
            mounts = scenes.mounts(stamp_ns, self._vehicle, self._implement, self._hitch_rad)
            yield "/view/mounts", FrameTransforms(transforms=mounts)
            yield "/view/machine", scenes.machine_scene(stamp_ns, self._vehicle)
        if self._vehicle is not None and self._implement is not None:
            carried = self._implement.folded if self._is_folded else self._implement
            yield "/view/implement", scenes.implement_scene(stamp_ns, carried)
        if self._site is not None:
            yield "/view/site", scenes.site_scene(stamp_ns, self._site)
            if self._site.shed is not None:
                yield "/view/shed", scenes.shed_scene(stamp_ns, self._site.shed)

    def _show_scan(self, topic: str, scan: LidarScan) -> Iterator[Shown]:
        if self._is_due(topic, scan.stamp_ns, self._config.cloud_s):
            yield f"/view/{topic}", cloud(scan.stamp_ns, topic, scan.points_m, self._config.points)

    def _show_image(self, topic: str, image: CameraImage) -> Iterator[Shown]:
        if self._is_due(topic, image.stamp_ns, self._config.image_s):
            frame_id = scenes.optical_frame(topic) if topic in self._cameras else topic
            yield f"/view/{topic}", compressed_image(image, frame_id, self._config.image_quality)

    def _show_radar(self, topic: str, scan: RadarScan) -> Iterator[Shown]:
        if self._is_due(topic, scan.stamp_ns, self._config.cloud_s):
            yield f"/view/{topic}", cloud(scan.stamp_ns, topic, scenes.radar_points(scan), self._config.points)

    def _show_echo(self, topic: str, echo: UltrasonicRange) -> Iterator[Shown]:
        sensors = self._vehicle.sensors.ultrasonic if self._vehicle is not None else {}
        sensor = sensors.get(topic.partition("/")[2])
        if sensor is not None and self._is_due(topic, echo.stamp_ns, self._config.scene_s):
            yield f"/view/{topic}", scenes.echo_scene(echo, topic, sensor)

    def _update_fold(self, topic: str, state: MachineState) -> Iterator[Shown]:
        """Repeats the static topics after a change of the fold state."""
        if (state.fold_position >= FOLDED) != self._is_folded:
            self._is_folded = not self._is_folded
            self._shown_at_ns.pop("static", None)
        return iter(())

    @property
    def _hitch_rad(self) -> float:
        return 0.0 if self._follower is None else self._follower.hitch_rad

    def _show_odometry(self, topic: str, message: Odometry) -> Iterator[Shown]:
        if topic == "odom" and self._follower is not None:
            self._follower.move(Pose2.of(message.T_odom_base))
        if not self._is_due(topic, message.stamp_ns, self._config.frames_s):
            return
        motion = message.speed_mps, message.yaw_rate_radps
        yield f"/view/{topic}", proto_message(plotted_pose(message.T_odom_base, *motion))
        if topic == "odom":
            self._motion = motion
            shown = [frame(message.stamp_ns, "odom", "base", message.T_odom_base)]
            if self._implement is not None and self._follower is not None:
                T = scenes.T_base_implement(self._implement, self._hitch_rad)
                shown.append(frame(message.stamp_ns, "base", "implement", T))
            yield "/view/frames", FrameTransforms(transforms=shown)

    def _show_map_pose(self, topic: str, message: MapPose) -> Iterator[Shown]:
        if message.is_initialized and self._is_due(topic, message.stamp_ns, self._config.frames_s):
            one = frame(message.stamp_ns, "map", "odom", message.T_map_odom)
            yield "/view/frames", FrameTransforms(transforms=[one])
            yield f"/view/{topic}", proto_message(plotted_pose(message.T_map_base, *self._motion))

    def _show_tracks(self, topic: str, message: Tracks) -> Iterator[Shown]:
        if self._is_due(topic, message.stamp_ns, self._config.scene_s):
            yield f"/view/{topic}", scenes.tracks_scene(message.stamp_ns, message)

    def _show_truth(self, topic: str, message: TrueObjects) -> Iterator[Shown]:
        """True objects: in the frame of the lidar named by the topic instance, else in `map`."""
        if self._is_due(topic, message.stamp_ns, self._config.scene_s):
            instance = topic.partition("/")[2]
            frame_id = f"lidar/{instance}" if instance else "map"
            yield f"/view/{topic}", scenes.truth_scene(message.stamp_ns, message, frame_id)

    def _show_state(self, topic: str, state: SupervisorState) -> Iterator[Shown]:
        """The protective field, numbers to plot, and the begin and end of a request to stop as events."""
        yield "/view/state", proto_message(plotted_state(state))
        code = stop_request(state)
        if code != self._stop_code:
            text = f"stop requested by {code}" if code else f"stop request of {self._stop_code} over"
            text += f" at {state.clearance_m:.1f} m" if code and math.isfinite(state.clearance_m) else ""
            yield from show_event(state.stamp_ns, PlottedEvent("stop", -1, "requested" if code else "over", text))
        self._stop_code = code
        if self._is_due(topic, state.stamp_ns, self._config.scene_s):
            yield "/view/field", scenes.field_scene(state.stamp_ns, state, self._height_m)

    def _show_path(self, topic: str, path: Path) -> Iterator[Shown]:
        yield f"/view/{topic}", scenes.path_scene(path.stamp_ns, path)

    def _show_fix(self, topic: str, fix: GnssFix) -> Iterator[Shown]:
        if self._is_due(topic, fix.stamp_ns, self._config.scene_s):
            yield f"/view/{topic}", scenes.location(fix.stamp_ns, fix, topic)

    def _show_fault(self, topic: str, fault: Fault) -> Iterator[Shown]:
        yield "/view/log", scenes.log_line(fault.stamp_ns, fault)


def show_event(stamp_ns: int, event: PlottedEvent) -> Iterator[Shown]:
    """A stop or encounter for plots and for the log panel."""
    yield "/view/events", proto_message(event)
    yield "/view/log", scenes.event_line(stamp_ns, event)
