"""What the operator is told: the cause first, at most one new alarm a second, each in two languages."""

from collections.abc import Iterable

from messages.command import RuleResult
from messages.faults import Fault, Response, Severity

SPACING_NS = 1_000_000_000

GERMAN = {
    "emergency_stop.button": "Not-Halt gedrückt",
    "emergency_stop.pedal": "Bremspedal getreten",
    "operator_command.emergency_stop": "Not-Halt befohlen",
    "driver_override": "Hand am Lenkrad: Fahrer übernimmt",
    "control_command.silent": "Regelung schweigt",
    "mission.silent": "Auftragssteuerung schweigt",
    "supply_voltage": "Versorgungsspannung außerhalb der Grenzen",
    "steering.not_following": "Lenkung folgt nicht",
    "steering.not_ready": "Lenkung nicht bereit",
    "brake.weak": "Bremse wirkt zu schwach",
    "brake.test_failed": "Bremsprobe nicht bestanden",
    "clock_step": "Uhr ist gesprungen",
    "machine.implement.silent": "Keine Nachricht vom Anbaugerät",
    "localization.uwb_lost": "Kein UWB im Schuppen",
    "localization.none": "Keine Position",
    "localization.gnss_age": "Zu lange keine GNSS-Position",
    "localization.gnss_lost": "GNSS-Korrekturen ausgefallen",
    "localization.protection": "Position zu ungenau",
    "geofence.outside": "Maschine außerhalb der erlaubten Fläche",
    "tilt.roll": "Zu große Seitenneigung",
    "tilt.pitch": "Zu große Längsneigung",
    "safety.ablation": "ACHTUNG: Sicherheitsregeln abgeschaltet (Versuch)",
}


def german(code: str, text_en: str) -> str:
    """The text for the German operator; codes made from topics are put together here."""
    subject, _, state = code.rpartition(".")
    states = {"silent": f"Keine Nachricht von {subject}", "frozen": f"{subject} liefert immer dasselbe Bild",
              "blind": f"{subject} ist blind"}  # fmt: skip
    return GERMAN.get(code) or states.get(state) or f"{code}: {text_en}"


def alarm(now_ns: int, result: RuleResult, is_active: bool) -> Fault:
    """A rule's result as a fault message; what only informs is a warning."""
    severity = Severity.ALARM if result.response >= Response.CONTROLLED_STOP else Severity.WARNING
    is_latched = result.response >= Response.CONTROLLED_STOP
    return Fault(
        now_ns, result.code, "supervisor", severity, is_latched, result.response, is_active, result.text,
        german(result.code, result.text),
    )  # fmt: skip


class Alarms:
    """Turns the results that hold now into messages on change."""

    def __init__(self) -> None:
        self._active: dict[str, RuleResult] = {}
        self._last_ns: int | None = None

    def update(self, now_ns: int, results: Iterable[RuleResult]) -> list[Fault]:
        """What ended, and the first of what is new once the last alarm is a second old."""
        wanted = {result.code: result for result in reversed(tuple(results))}
        ended = [self._active.pop(code) for code in tuple(self._active) if code not in wanted]
        out = [alarm(now_ns, result, False) for result in ended]
        new = next((wanted[code] for code in reversed(wanted) if code not in self._active), None)
        if new is not None and (self._last_ns is None or abs(now_ns - self._last_ns) >= SPACING_NS):
            self._active[new.code], self._last_ns = new, now_ns
            out.append(alarm(now_ns, new, True))
        return out
