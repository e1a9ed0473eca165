"""Faults that a part raises and takes back, told once each time they change."""

from dataclasses import dataclass

from messages.faults import Fault, Response, Severity


@dataclass(frozen=True)
class Alarm:
    """One fault as it stands in a table of a part."""

    code: str
    severity: Severity
    response: Response
    text_en: str
    text_zh: str


class Alarms:
    """Which of a part's alarms are on; `source` is the part's name."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._active: set[str] = set()

    def update(self, now_ns: int, states: list[tuple[Alarm, bool]]) -> list[Fault]:
        """The faults to tell: those whose state is another than before."""
        changed = [(alarm, is_on) for alarm, is_on in states if is_on != (alarm.code in self._active)]
        for alarm, is_on in changed:
            (self._active.add if is_on else self._active.discard)(alarm.code)
        return [self._fault(now_ns, alarm, is_on) for alarm, is_on in changed]

    def _fault(self, now_ns: int, alarm: Alarm, is_on: bool) -> Fault:
        return Fault(
            stamp_ns=now_ns,
            code=alarm.code,
            source=self._source,
            severity=alarm.severity,
            is_latched=False,
            response=alarm.response,
            is_active=is_on,
            text_en=alarm.text_en,
            text_zh=alarm.text_zh,
        )
