"""Messages of a drive that the measures need, gathered from its log in one pass."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.transforms import yaw_of
from messages.command import ControlCommand, SafeCommand, SupervisorState
from messages.errors import LogError
from messages.message import Envelope, Message
from messages.motion import MapPose
from messages.plan import MissionStatus, Path
from messages.truth import TrueMachine, TrueObjects

TOPICS = (
    "truth_machine", "truth_objects", "map_pose", "path", "mission", "control_command", "safe_command", "supervisor",
)  # fmt: skip
M = TypeVar("M", bound=Message)


@dataclass
class DriveRecord:
    """Messages of each topic of `TOPICS` in order of reception, and receive times of the first and last message."""

    messages: dict[str, list[Message]] = field(default_factory=lambda: {topic: [] for topic in TOPICS})
    first_ns: int = 0
    last_ns: int = 0

    def of(self, topic: str, kind: type[M]) -> list[M]:
        """All messages of a topic."""
        return [m for m in self.messages[topic] if isinstance(m, kind)]

    @property
    def truth(self) -> list[TrueMachine]:
        """True machine states."""
        return self.of("truth_machine", TrueMachine)

    @property
    def objects(self) -> list[TrueObjects]:
        """True obstacles."""
        return self.of("truth_objects", TrueObjects)

    @property
    def control_commands(self) -> list[ControlCommand]:
        """Control commands."""
        return self.of("control_command", ControlCommand)

    @property
    def supervisor(self) -> list[SupervisorState]:
        """Supervisor states."""
        return self.of("supervisor", SupervisorState)

    @property
    def commands(self) -> list[SafeCommand]:
        """Safe commands."""
        return self.of("safe_command", SafeCommand)

    @property
    def poses(self) -> list[MapPose]:
        """Poses of the localizer."""
        return self.of("map_pose", MapPose)

    @property
    def mission(self) -> list[MissionStatus]:
        """Mission states."""
        return self.of("mission", MissionStatus)

    @property
    def paths(self) -> dict[int, Path]:
        """Paths by their id."""
        return {path.path_id: path for path in self.of("path", Path)}

    @property
    def seconds(self) -> float:
        """Duration of the log (s)."""
        return (self.last_ns - self.first_ns) * 1e-9

    def time_s(self, stamp_ns: int) -> float:
        """Seconds since the start of the log."""
        return (stamp_ns - self.first_ns) * 1e-9


def collect(envelopes: Iterable[Envelope]) -> DriveRecord:
    """Gathers a drive; raises LogError for an empty log."""
    record = DriveRecord()
    for envelope in envelopes:
        record.first_ns = record.first_ns or envelope.receive_ns
        record.last_ns = envelope.receive_ns
        if envelope.topic in record.messages:
            record.messages[envelope.topic].append(envelope.message)
    if not record.last_ns:
        raise LogError("the log holds no message: nothing can be evaluated")
    return record


def stamps_of(messages: Iterable[Message]) -> Int64:
    """Stamps, (N,)."""
    return np.array([m.stamp_ns for m in messages], np.int64)


def true_poses(truth: list[TrueMachine]) -> Float64:
    """x, y and heading of `base` in `map`, (N, 3)."""
    return np.array([[m.T_map_base[0, 3], m.T_map_base[1, 3], yaw_of(m.T_map_base)] for m in truth]).reshape(-1, 3)
