"""What the localizer reports as wrong, each once when it begins and once when it ends."""

from dataclasses import dataclass

from messages.faults import Fault, Response, Severity


@dataclass(frozen=True)
class Alarm:
    """One kind of fault."""

    severity: Severity
    response: Response
    text_en: str
    text_zh: str


STOP, NOTICE = (Severity.ALARM, Response.CONTROLLED_STOP), (Severity.NOTICE, Response.NONE)
ALARMS = {
    "imu.silent": Alarm(*STOP, "Inertial unit is silent", "Inertialsensor schweigt"),
    "wheel.silent": Alarm(*STOP, "Wheel speed is silent", "Raddrehzahl schweigt"),
    "imu.frozen": Alarm(*STOP, "Inertial unit repeats itself", "Inertialsensor wiederholt denselben Messwert"),
    "imu.noisy": Alarm(*STOP, "Inertial unit is too noisy", "Inertialsensor rauscht zu stark"),
    "imu.implausible": Alarm(*STOP, "Inertial unit is implausible", "Inertialsensor unplausibel"),
    "wheel.implausible": Alarm(*STOP, "Wheel speed or angle is implausible", "Raddrehzahl oder Lenkwinkel unplausibel"),
    "imu_or_wheel.implausible": Alarm(
        *STOP, "Inertial unit and wheels contradict each other", "Inertialsensor und Räder widersprechen sich"
    ),
    "gnss.silent": Alarm(Severity.WARNING, Response.NONE, "No GNSS fixes come in", "Keine GNSS-Positionen"),
    "gnss.refused": Alarm(Severity.WARNING, Response.NONE, "GNSS fixes are refused", "GNSS-Positionen verworfen"),
    "gnss.no_heading": Alarm(*STOP, "No heading from GNSS: cannot start", "Kein GNSS-Kurs: Start nicht möglich"),
    "localization.not_docked": Alarm(*STOP, "Not known to stand at the dock", "Stand am Stellplatz nicht bestätigt"),
    "uwb.refused": Alarm(Severity.WARNING, Response.NONE, "UWB ranges are refused", "UWB-Abstände verworfen"),
    "localization.lost": Alarm(
        *STOP, "Position lost; stand still to find it", "Position verloren; bitte stehen bleiben"
    ),
    "localization.rebuilt": Alarm(*NOTICE, "Position graph was rebuilt", "Positionsgraph neu aufgebaut"),
    "localization.garbage": Alarm(*NOTICE, "Sensor values dropped", "Messwerte verworfen"),
    "clock.jumped": Alarm(Severity.WARNING, Response.NONE, "The clock jumped", "Die Uhr ist gesprungen"),
}


class Alarms:
    """Holds which alarms are on and turns changes into messages."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._active: set[str] = set()
        self._changes: list[tuple[str, bool, str]] = []

    def set(self, code: str, is_active: bool, detail: str = "") -> None:
        """Says how it is now; only a change becomes a message."""
        if is_active == (code in self._active):
            return
        (self._active.add if is_active else self._active.discard)(code)
        self._changes.append((code, is_active, detail))

    def note(self, code: str, detail: str) -> None:
        """Reports something that happened and is over."""
        self._changes += [(code, True, detail), (code, False, detail)]

    def is_on(self, code: str) -> bool:
        """Whether an alarm is active."""
        return code in self._active

    def take(self, now_ns: int) -> list[Fault]:
        """The changes since the last call."""
        changes, self._changes = self._changes, []
        return [self._fault(now_ns, *change) for change in changes]

    def _fault(self, now_ns: int, code: str, is_active: bool, detail: str) -> Fault:
        alarm, more = ALARMS[code], f" ({detail})" if detail else ""
        return Fault(
            now_ns, code, self._source, alarm.severity, False, alarm.response, is_active,
            alarm.text_en + more, alarm.text_zh + more,
        )  # fmt: skip
