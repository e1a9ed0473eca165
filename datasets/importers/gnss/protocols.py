"""NMEA 0183 and UBX frames to fixes with their times."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from typing import Protocol

from datasets.importers.gnss import nmea, ubx
from datasets.importers.gnss.clock import DAY_NS, WEEK_NS, Calendar, S, day_ns, utc_of_gps
from datasets.importers.gnss.fix import fix_of
from datasets.importers.gnss.framing import NMEA, UBX, Frame
from datasets.importers.gnss.line_stamp import stamp_of
from datasets.importers.gnss.sentence import BadSentence, parse
from datasets.importers.recording import Received, Skipped
from messages.errors import LogError

ZONE_NS = 900 * S  # time zones are multiples of 15 minutes
STREAM = "byte stream"


@dataclass(frozen=True)
class Timing:
    """What a first pass finds for the times of the second one.

    `start_ns` is the period (day, week) of the first message. `has_date` is False where no message has one: then times
    count from 0, or from the stamps of the recorder (`has_stamps`), which are ahead of UTC by `zone_ns`.
    """

    start_ns: int = 0
    has_date: bool = True
    has_stamps: bool = False
    zone_ns: int | None = None


class Fixes(Protocol):
    """Frames of one protocol to fixes; bad frames are `Skipped`."""

    def __init__(self, timing: Timing) -> None: ...

    def reads(self, kind: str) -> bool:
        """Whether messages of this kind are used."""

    def add(self, frame: Frame) -> Iterator[Received | Skipped]:
        """What a frame of a kind that is read completes, or the bad frame as `Skipped`."""

    def finish(self) -> Iterator[Received]:
        """The fix of the last epoch."""

    def timing(self) -> Timing:
        """The timing of the frames so far."""


class NmeaFixes:
    """Fixes of NMEA 0183."""

    def __init__(self, timing: Timing) -> None:
        self._timing = timing
        self._calendar = Calendar(DAY_NS, timing.start_ns)
        self._epochs = nmea.NmeaEpochs()
        self._stamp: tuple[int, bool] | None = None
        self._has_stamps, self._zone_ns = False, timing.zone_ns

    def reads(self, kind: str) -> bool:
        """Whether sentences with this address are used: of any talker, but headings of GNSS receivers only."""
        talker, formatter = kind[:2], kind[2:]
        if formatter in ("HDT", "THS"):  # others are those of a gyro or magnetic compass
            return talker in nmea.TALKERS
        return talker[0] != "P" and (formatter in nmea.READERS or formatter == "ZDA")

    def add(self, frame: Frame) -> Iterator[Received | Skipped]:
        """The fix that a sentence completes, or the sentence as `Skipped`."""
        try:
            sentence = parse(frame.data)
            dated = nmea.date_of(sentence)
            done = self._epochs.add(sentence) if sentence.formatter != "ZDA" else None
        except BadSentence as error:
            yield Skipped(self._calendar.now_ns, NMEA, STREAM, str(error))
            return
        if done is not None:
            yield self._received(done)
        self._note_time(dated, stamp_of(frame.prefix))

    def finish(self) -> Iterator[Received]:
        """The fix of the last epoch."""
        if (done := self._epochs.finish()) is not None:
            yield self._received(done)

    def timing(self) -> Timing:
        """The timing of the sentences so far."""
        start_ns = self._calendar.start_ns
        return Timing(start_ns or 0, start_ns is not None, self._has_stamps, self._zone_ns)

    def _note_time(self, dated: tuple[date, int] | None, stamp: tuple[int, bool] | None) -> None:
        if dated is not None:
            self._calendar.set(day_ns(dated[0]) + dated[1])
        elif stamp is not None and not self._timing.has_date:
            self._calendar.near(stamp[0])
        self._stamp, self._has_stamps = stamp, self._has_stamps or stamp is not None

    def _received(self, epoch: nmea.Epoch) -> Received:
        assert epoch.time_ns is not None
        stamp_ns = receive_ns = self._calendar.at(epoch.time_ns)
        if self._stamp is not None:
            receive_ns, has_zone = self._stamp
            if self._zone_ns is None and self._calendar.start_ns is not None:
                self._zone_ns = 0 if has_zone else round((receive_ns - stamp_ns) / ZONE_NS) * ZONE_NS
            receive_ns -= self._zone_ns or 0
        return receive_ns, TOPICS[NMEA], fix_of(epoch.merged(), stamp_ns)


class UbxFixes:
    """Fixes of UBX; the calendar counts GPS time."""

    def __init__(self, timing: Timing) -> None:
        self._calendar = Calendar(WEEK_NS, timing.start_ns)
        self._epochs = ubx.UbxEpochs()

    def reads(self, kind: str) -> bool:
        """Whether messages of this kind are used."""
        return kind in ubx.READERS

    def add(self, frame: Frame) -> Iterator[Received | Skipped]:
        """The fix that a message completes, or the message as `Skipped`."""
        try:
            if frame.fault:
                raise LogError(frame.fault)
            if (done := self._epochs.add(frame.data)) is not None:
                yield self._received(done)
        except LogError as error:
            yield Skipped(utc_of_gps(self._calendar.now_ns), UBX, STREAM, str(error))

    def finish(self) -> Iterator[Received]:
        """The fix of the last epoch."""
        if (done := self._epochs.finish()) is not None:
            yield self._received(done)

    def timing(self) -> Timing:
        """The timing of the messages so far."""
        return Timing(self._calendar.start_ns or 0, self._calendar.start_ns is not None)

    def _received(self, epoch: ubx.Epoch) -> Received:
        if epoch.gps_ns is not None:
            self._calendar.set(epoch.gps_ns)
        stamp_ns = utc_of_gps(self._calendar.at(epoch.tow_ns))
        return stamp_ns, TOPICS[UBX], fix_of(epoch.merged(), stamp_ns)


TOPICS = {NMEA: "gnss/nmea", UBX: "gnss/ubx"}
FIXES: dict[str, type[Fixes]] = {NMEA: NmeaFixes, UBX: UbxFixes}
