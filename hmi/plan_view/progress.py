"""Progress of a stored mission on disk: how far it is driven, and where the machine stands."""

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path as File

import numpy as np
from pydantic import Field

from configs.site import PoseConfig
from configs.strict import Config, parse
from geometry.arrays import Float64
from geometry.pose2 import Pose2
from hmi.page_state import PageState
from messages.command import MachineState
from messages.errors import ConfigError, HeadlandError
from messages.plan import MissionState, MissionStatus, Path, PathSectionType

PROGRESS = "progress.json"
BEHIND_M, AHEAD_M = 5.0, 60.0  # of the last known position, where a line driven under another number is looked for
ON_LINE_M, ON_LINE_RAD = 0.5, 0.5
FOLDED = 0.5


class Progress(Config):
    """Position on a path of the plan, and the state of the machine there.

    `path_s_m` is the arc length on path `path_id` of the plan, `at` the pose of `base` in `map`; `hitch` is 0 (lowest)
    to 1 (highest). `length_m` is the length of the plan, `left_m` what was not driven yet.
    """

    path_id: int
    path_s_m: float = Field(ge=0.0)
    at: PoseConfig
    hitch: float = Field(ge=0.0, le=1.0)
    is_folded: bool
    length_m: float = Field(ge=0.0)
    left_m: float = Field(ge=0.0)

    @property
    def share(self) -> float:
        """Driven share of the plan, 0 to 1."""
        return 1.0 - min(1.0, self.left_m / self.length_m) if self.length_m > 0.0 else 0.0


@dataclass(frozen=True)
class StoredDrive:
    """A drive on the stored mission of `folder`; `last_path_id` is the last number of its plan.

    The plan of a drive that was `resumed` begins with the rest of path `resumed.path_id`, under the same number.
    """

    folder: File
    resumed: Progress | None
    last_path_id: int


class ProgressKeeper:
    """Keeps the progress of a drive in the folder of its mission."""

    def __init__(self, drive: StoredDrive) -> None:
        self._path = drive.folder / PROGRESS
        self._resumed, self._last_path_id = drive.resumed, drive.last_path_id
        self._known: tuple[Path, float] | None = None  # path of the plan, arc length on it as published
        self._stored: Progress | None = None

    def store(self, state: PageState) -> None:
        """Writes the progress when it has changed, removes it at the end of the mission; raises HeadlandError."""
        status = state.newest("mission", MissionStatus)
        if status is None or status.state is MissionState.WAITING:
            return
        try:
            if status.state is MissionState.FINISHED:
                self._path.unlink(missing_ok=True)
                return
            found = self._progress(state, status)
            if found is not None and found != self._stored:
                _replace(self._path, found.model_dump_json() + "\n")
                self._stored = found
        except OSError as error:
            raise HeadlandError(f"{self._path}: progress cannot be stored ({error.strerror or error})") from error

    def _progress(self, state: PageState, status: MissionStatus) -> Progress | None:
        """Progress at this moment; None while a position is missing, or the path is none of the plan."""
        pose, machine = state.pose, state.newest("machine", MachineState)
        path = state.paths.get(status.path_id)
        if pose is None or machine is None or path is None:
            return None
        self._locate(path, status, pose)
        if self._known is None:
            return None
        planned, s_m = self._known
        before = self._resumed
        is_rest = before is not None and planned.path_id == before.path_id
        return Progress(
            path_id=planned.path_id,
            path_s_m=round(s_m + (before.path_s_m if before is not None and is_rest else 0.0), 2),
            at=PoseConfig(x_m=round(pose.x_m, 3), y_m=round(pose.y_m, 3), heading_deg=round(_degrees(pose.yaw_rad), 3)),
            hitch=round(min(1.0, max(0.0, machine.hitch)), 2),
            is_folded=machine.fold_position > FOLDED,
            length_m=round(status.total_m if before is None else before.length_m, 1),
            left_m=round(max(0.0, status.total_m - status.driven_m), 1),
        )

    def _locate(self, path: Path, status: MissionStatus, pose: Pose2) -> None:
        """Takes the position on a path of the plan; of a line that goes on under another number, the nearest one."""
        if path.path_id <= self._last_path_id:
            self._known = path, status.path_s_m
        elif self._known is not None and status.section_type is not PathSectionType.DETOUR:
            planned, s_m = self._known
            found = place_on(planned, pose, s_m - BEHIND_M, s_m + AHEAD_M)
            self._known = planned, s_m if found is None else found


def place_on(path: Path, pose: Pose2, from_m: float, to_m: float) -> float | None:
    """Arc length of the point of a path nearest to a pose, between two arc lengths; None if the pose is not on it."""
    inside = np.flatnonzero((path.s_m >= from_m) & (path.s_m <= to_m))
    if not len(inside):
        return None
    away: Float64 = np.hypot(path.p_map_m[inside, 0] - pose.x_m, path.p_map_m[inside, 1] - pose.y_m)
    turned = np.abs(np.remainder(path.heading_rad[inside] - pose.yaw_rad + math.pi, 2.0 * math.pi) - math.pi)
    away = np.where(turned <= ON_LINE_RAD, away, np.inf)
    k = int(np.argmin(away))
    return float(path.s_m[inside[k]]) if away[k] <= ON_LINE_M else None


def read_progress(folder: File) -> Progress | None:
    """Progress of a stored mission, None if it was not interrupted; raises ConfigError."""
    path = folder / PROGRESS
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    return parse(Progress, values, str(path))


def _degrees(yaw_rad: float) -> float:
    return math.degrees(math.remainder(yaw_rad, 2.0 * math.pi))


def _replace(path: File, text: str) -> None:
    """Replaces a file at once, also for a power cut."""
    fresh = path.with_suffix(".new")
    with fresh.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(path)
