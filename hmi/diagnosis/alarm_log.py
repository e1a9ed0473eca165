"""History of alarms: one entry from the first appearance of a fault until it has ended for good and is acknowledged."""

import time
from collections.abc import Iterable
from dataclasses import dataclass

from messages.faults import Fault, Severity

MAX_ENTRIES = 300
REPEATED_S = 10.0  # a fault that returns within this time after its end is the same entry, without a new sound
SOUND_S = 3.0  # between two sounds


@dataclass
class Alarm:
    """Appearances of a fault: when the first began and the last ended (Unix time, s; None: active), and how many."""

    number: int
    fault: Fault
    began_s: float
    ended_s: float | None = None
    count: int = 1
    acknowledged_by: str = ""


class AlarmLog:
    """Entries by appearance; `sound_number` increases when a sound is due, at most once in `SOUND_S`."""

    def __init__(self) -> None:
        self.entries: list[Alarm] = []
        self.sound_number = 0
        self.dropped = 0  # entries that are no longer kept
        self._number = 0
        self._newest: dict[tuple[str, str], Alarm] = {}
        self._sounded_s = -SOUND_S
        self._is_sound_due = False

    def take(self, faults: Iterable[Fault], now_s: float) -> None:
        """Processes the faults and ends of faults since the last call."""
        for fault in faults:
            self._take(fault, now_s)
        if (self._is_sound_due or self.is_sounding) and not 0.0 <= now_s - self._sounded_s < SOUND_S:
            self._is_sound_due, self._sounded_s = False, now_s
            self.sound_number += 1

    def end_all(self, now_s: float) -> None:
        """Ends what is active: its drive has ended."""
        for alarm in self.entries:
            if alarm.ended_s is None:
                alarm.ended_s = now_s
        self._newest = {}

    def acknowledge(self, number: int, name: str) -> bool:
        """A person has read an entry; False for one that is not there or was acknowledged before."""
        for alarm in self.entries:
            if alarm.number == number and not alarm.acknowledged_by:
                alarm.acknowledged_by = name
                return True
        return False

    @property
    def is_sounding(self) -> bool:
        """Whether an active alarm waits to be acknowledged: its sound is repeated."""
        return self.waiting is not None

    @property
    def waiting(self) -> Alarm | None:
        """The newest active alarm that waits to be acknowledged: it sounds, and its text flashes."""
        active = (a for a in reversed(self.entries) if a.ended_s is None and a.fault.severity is Severity.ALARM)
        return next((a for a in active if not a.acknowledged_by), None)

    def _take(self, fault: Fault, now_s: float) -> None:
        key = (fault.source, fault.code)
        alarm = self._newest.get(key)
        if not fault.is_active:
            if alarm is not None and alarm.ended_s is None:
                alarm.ended_s = now_s
            return
        if alarm is not None and alarm.ended_s is None:
            alarm.fault = fault
            return
        if alarm is not None and alarm.ended_s is not None and 0.0 <= now_s - alarm.ended_s < REPEATED_S:
            alarm.fault, alarm.ended_s = fault, None
            alarm.count += 1
            return
        self._add(key, fault, now_s)

    def _add(self, key: tuple[str, str], fault: Fault, now_s: float) -> None:
        self._number += 1
        self._newest[key] = alarm = Alarm(self._number, fault, now_s)
        self.entries.append(alarm)
        self._is_sound_due |= fault.severity is Severity.ALARM
        if len(self.entries) > MAX_ENTRIES:
            self._drop()

    def _drop(self) -> None:
        """Drops the oldest entry that has ended, else the oldest."""
        oldest = next((alarm for alarm in self.entries if alarm.ended_s is not None), self.entries[0])
        self.entries.remove(oldest)
        self.dropped += 1
        for key in [key for key, alarm in self._newest.items() if alarm is oldest]:
            del self._newest[key]


def clock_text(time_s: float) -> str:
    """Local date and time."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(time_s))
