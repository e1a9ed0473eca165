"""What the pages of an application share, and the moment that one update shows."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from configs.machine_setup import MachineSetup
from hmi.access import Access
from hmi.calibration_view.desk import CalibrationDesk
from hmi.config import PageConfig
from hmi.diagnosis.alarm_log import AlarmLog
from hmi.diagnosis.bus_table import BusTable
from hmi.diagnosis.run_files import Run, runs_of
from hmi.diagnosis.topic_table import TopicTable
from hmi.drive_view.standing import RuleText
from hmi.feed import Feed
from hmi.foxglove import FoxgloveServer
from hmi.orders import OrderSender
from hmi.page_state import PageState
from hmi.plan_view.desk import PlanDesk
from hmi.plan_view.mission_store import StoredMission
from hmi.plan_view.progress import Progress, StoredDrive
from hmi.scene import Scene
from hmi.setup_view.desk import SetupDesk
from hmi.shown import shown_of
from hmi.statistics.store import DayOfField, StatisticsStore
from hmi.texts import Texts
from hmi.upload.platform_report import PlatformReport
from hmi.upload.uploader import Uploader
from messages.errors import HeadlandError

READ_S = 2.0


@dataclass(frozen=True)
class Drive:
    """A drive that is shown: its messages, its scene, and a name that no other drive has.

    `stored` is None unless it drives a stored mission; `setup` is that of the machine, a version with `setup_number`.
    """

    feed: Feed
    scene: Scene
    name: str
    stored: StoredDrive | None = None
    setup: MachineSetup | None = None
    setup_number: int | None = None


class Drives(ABC):
    """Simulated drives, one at a time."""

    @abstractmethod
    def start(self, mission: StoredMission, progress: Progress | None = None) -> None:
        """Ends the present drive and begins one on a stored mission, from `progress` if it was interrupted there."""

    @abstractmethod
    def restart(self) -> None:
        """Ends the present drive and begins it once more, with the newest version of the setup."""

    @abstractmethod
    def start_trial(self) -> None:
        """Ends the present drive and begins the one of the mission `calibration`."""

    @abstractmethod
    def take(self) -> Drive | str | None:
        """The drive that has begun since the last call, or why it did not begin; None without news."""


@dataclass
class PageParts:
    """What pages are made of; `source` is `simulation`, `connected` or `replay`, `sender` None gives no orders.

    `runs` is the folder of the run folders, `statistics` None keeps none, `drives` None starts none.
    Without a machine there is no `setup` and no `calibration`.
    """

    drive: Drive
    config: PageConfig
    access: Access
    sender: OrderSender | None
    stop_url: str | None
    source: str
    rule_text_zh: RuleText
    desk: PlanDesk
    runs: Path
    statistics: StatisticsStore | None = None
    drives: Drives | None = None
    setup: SetupDesk | None = None
    calibration: CalibrationDesk | None = None
    statistics_error: str = ""
    report: PlatformReport | None = None
    uploader: Uploader | None = None
    progress_error: str = ""
    notification_error: str = ""
    url: str = ""  # of the page
    foxglove: FoxgloveServer | None = None
    is_switching: bool = False  # a drive has been asked for that has not begun: the present one gets no order
    present_s: float = -math.inf  # when a page of the operator in control answered last
    _read: dict[str, tuple[float, Any]] = field(default_factory=dict)

    def run_list(self) -> list[Run]:
        """The newest run folders, read every `READ_S` at most."""
        return self._recent("runs", lambda: runs_of(self.runs))

    def days(self) -> list[DayOfField]:
        """Statistics by day and field, read every `READ_S` at most; none, and `statistics_error`, if it fails."""
        try:
            return self._recent("days", lambda: [] if self.statistics is None else self.statistics.by_day())
        except HeadlandError as error:
            self.statistics_error = str(error)
            return []

    def _recent(self, name: str, read: Callable[[], list[Any]]) -> list[Any]:
        now_s = time.monotonic()
        if name not in self._read or now_s - self._read[name][0] >= READ_S:
            self._read[name] = now_s, read()
        found: list[Any] = self._read[name][1]
        return found


@dataclass
class Moment:
    """What an update shows: the state, whether it is of another drive or position than before, and their texts."""

    parts: PageParts
    state: PageState
    alarms: AlarmLog
    topics: TopicTable
    bus: BusTable
    is_restarted: bool
    drive_error: str = ""
    _shown: dict[str, dict[str, Any]] = field(default_factory=dict)

    def shown(self, texts: Texts) -> dict[str, Any]:
        """Sections of the drive view in a language."""
        if texts.language not in self._shown:
            playback = self.parts.drive.feed.playback
            self._shown[texts.language] = shown_of(self.state, texts, self.parts.rule_text_zh, playback)
        return self._shown[texts.language]
