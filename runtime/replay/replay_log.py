"""Log of a replay: all its messages with sensor data, viewer topics, and the evaluated encounters as events."""

import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from datasets.log import LogWriter
from datasets.plots import PlottedEvent
from datasets.viewer import Viewer, show_event
from messages.errors import LogError
from messages.message import Envelope
from runtime.replay.prepare import ReplayInput

SENSOR_DATA = ("lidar", "camera")
PACKED_SHARE = 0.6  # of the bytes of the sensor data, in a compressed log; the space it needs is an estimate
MB = 1e6


class ReplayLog:
    """Sink that writes a replay; `has_sensor_data` false leaves out scans and images."""

    def __init__(self, log: LogWriter, has_sensor_data: bool) -> None:
        self._log = log
        self._left_out = () if has_sensor_data else SENSOR_DATA

    def __call__(self, envelope: Envelope) -> None:
        """Writes a message."""
        if envelope.topic.lstrip("/").removeprefix("recorded/").partition("/")[0] not in self._left_out:
            self._log.write(envelope)

    def write_encounters(self, encounters: Iterable[dict[str, Any]], first_ns: int) -> None:
        """Writes evaluated encounters as events at their entries; times count from `first_ns`."""
        timed = (one for one in encounters if one["entry_s"] is not None)
        for one in sorted(timed, key=lambda e: float(e["entry_s"])):
            stamp_ns = first_ns + round(float(one["entry_s"]) * 1e9)
            text = f"encounter with {one['role'] or one['class']}: {one['outcome']}"
            event = PlottedEvent("encounter", int(one["id"]), str(one["outcome"]), text)
            for topic, shown in show_event(stamp_ns, event):
                self._log.write_view(stamp_ns, stamp_ns, topic, shown)

    def digest(self) -> str:
        """Digest over all messages so far."""
        return self._log.digest()


@contextmanager
def replay_log(
    path: Path, replay_input: ReplayInput, inspection: dict[str, Any], has_sensor_data: bool
) -> Iterator[ReplayLog]:
    """Opens the log of a replay; raises LogError when its disk has not the space for the sensor data."""
    path.unlink(missing_ok=True)
    config, recording = replay_input.config, replay_input.recording
    needed = PACKED_SHARE * replay_input.inspection.sensor_bytes / MB + config.stack.datasets.log.min_free_mb
    free = shutil.disk_usage(path.parent).free / MB
    if has_sensor_data and free < needed:
        raise LogError(
            f"{path}: about {needed:.0f} MB are needed for scans and images, {free:.0f} MB are free; "
            "free space, choose another folder, or use --without-sensor-data"
        )
    about = {"replay": {"log": str(recording.path), "inspection": json.dumps(inspection)}}
    machine, cameras = replay_input.machine, recording.description.cameras
    viewer = Viewer(config.replay.viewer, machine.vehicle, machine.implement, None, cameras)
    with LogWriter(path, about, config.stack.datasets.log, viewer) as log:
        yield ReplayLog(log, has_sensor_data)
