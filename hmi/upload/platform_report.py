"""What a drive tells the platform: its totals, and each alarm."""

from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from hmi.diagnosis.alarm_log import AlarmLog
from hmi.statistics.store import Totals
from hmi.upload.config import UploadConfig
from hmi.upload.upload_queue import UploadQueue
from messages.errors import HeadlandError
from messages.faults import Severity


class DriveName(NamedTuple):
    """Name of a drive that no other has, and that of its field."""

    drive: str
    field: str


class PlatformReport:
    """Puts items into the queue of `path`; `error` says why that failed the last time."""

    def __init__(self, path: Path, config: UploadConfig) -> None:
        self.error = ""
        self._every_s = config.every_s
        self._queue = UploadQueue(path) if config.url is not None else None
        self._totals: tuple[str, Totals] | None = None
        self._totals_s = 0.0
        self._alarm = 0

    def take(self, drive: DriveName, day: str, totals: Totals, alarms: AlarmLog, now_s: float, is_last: bool) -> None:
        """Queues alarms that are new, and totals that have changed: every `every_s`, and when the drive ends.

        Totals are those since the start of the drive: of a drive the platform keeps the last ones.
        """
        if self._queue is None:
            return
        try:
            for alarm in alarms.entries:
                if alarm.number > self._alarm and alarm.fault.severity is Severity.ALARM:
                    body = {"drive": drive.drive, "code": alarm.fault.code, "text": alarm.fault.text_en}
                    self._queue.put("alarm", body | {"began_s": round(alarm.began_s, 3)})
                self._alarm = max(self._alarm, alarm.number)
            if (drive.drive, totals) != self._totals and (is_last or now_s - self._totals_s >= self._every_s):
                body = {"drive": drive.drive, "day": day, "field": drive.field}
                self._queue.put("totals", body | {name: round(value, 1) for name, value in asdict(totals).items()})
                self._totals, self._totals_s = (drive.drive, totals), now_s
            self.error = ""
        except HeadlandError as error:
            self.error = str(error)
