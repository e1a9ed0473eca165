"""Desk of the calibration: one recording at a time, which all pages show and the operator in control makes."""

import asyncio
from collections.abc import Iterable

from calibration.recording import Recorder
from calibration.result import CalibrationResult, NotEnough
from calibration.wizards import calibrate, calibrations_of
from hmi.feed import Feed
from hmi.refusal import Refused
from hmi.scene import Scene
from hmi.setup_view.desk import SetupDesk
from messages.message import Envelope


class CalibrationDesk:
    """Recording and result; `setup` has the vehicle that the machine drives with."""

    def __init__(self, setup: SetupDesk) -> None:
        self.setup = setup
        self.recorder: Recorder | None = None
        self.is_recording = self.is_busy = False
        self.name = "wheel_radius"
        self.result: CalibrationResult | None = None
        self.missing: NotEnough | None = None
        self._feed: Feed | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Calibrations of the machine."""
        return calibrations_of(self.setup.in_use.vehicle)

    def choose(self, name: str) -> None:
        """Chooses a calibration; the recording stays, it serves all of them."""
        self._check_free()
        if name not in self.names:
            raise Refused("no_setting", name=name[:80])
        self.name, self.result, self.missing = name, None, None

    def record(self, feed: Feed, scene: Scene) -> None:
        """Begins a new recording; raises Refused for a log."""
        self._check_free()
        if feed.playback is not None:
            raise Refused("no_trial")
        self.end()
        self.recorder, self._feed, self.is_recording = Recorder(scene.site.datum.datum), feed, True
        feed.is_recording = True
        self.result = self.missing = None

    def end(self) -> None:
        """Ends recording; what was recorded can be evaluated."""
        if self._feed is not None:
            self._feed.is_recording = False
        self._feed, self.is_recording = None, False

    def take(self, envelopes: Iterable[Envelope]) -> None:
        """Takes the messages of an update."""
        if self.is_recording and self.recorder is not None:
            self.recorder.take(envelopes)

    async def evaluate(self) -> None:
        """Estimates from what was recorded, also while the recording goes on."""
        self._check_free()
        if self.recorder is None:
            raise Refused("no_recording")
        recording, used = self.recorder.recording(), self.setup.in_use
        self.result = self.missing = None
        self.is_busy = True
        try:
            self.result = await asyncio.to_thread(calibrate, self.name, recording, used.vehicle, used.implement)
        except NotEnough as missing:
            self.missing = missing
        finally:
            self.is_busy = False

    def accept(self, author: str, note: str) -> int:
        """Stores the values as a new version of the setup; its number. Raises HeadlandError."""
        self._check_free()
        if self.result is None:
            raise Refused("no_result")
        if not self.result.is_verified:
            raise Refused("not_verified")
        number = self.setup.put_calibrated(
            {one.key: round(one.value, 5) for one in self.result.estimates}, author, note
        )
        self.result = None
        return number

    def _check_free(self) -> None:
        if self.is_busy:
            raise Refused("calibrating")
