"""Values of a setup by section, and a value from the text that a person has entered."""

import math
from typing import Any

from configs.machine_setup import MachineSetup, leaves
from messages.errors import ConfigError

SECTIONS = ("vehicle", "implement", "mounts", "sensors", "corrections", "work")
HIDDEN = (".solids.", ".elevation_deg.", ".kind", ".topic", "vehicle.name", "implement.name", ".guidance", "swath_")
MAX_TEXT = 60


def section_of(key: str) -> str:
    """Section of a dotted key, "" for one that is not edited on the page."""
    if any(part in key for part in HIDDEN):
        return ""
    if ".mount." in key:
        return "mounts"
    if ".sensors." in key:
        return "sensors"
    return key.partition(".")[0]


def settings_of(setup: MachineSetup, section: str) -> dict[str, Any]:
    """Values of a section by dotted key."""
    return {key: value for key, value in leaves(setup).items() if section_of(key) == section}


def shown_text(value: Any) -> str:
    """A value as it is entered."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def value_from(key: str, text: str, before: Any) -> Any:
    """The value that a text means where `before` was; raises ConfigError that names key and text."""
    text = text.strip()[:MAX_TEXT]
    if isinstance(before, bool):
        if text not in ("yes", "no"):
            raise ConfigError(f"{key} {text!r}: must be yes or no")
        return text == "yes"
    if isinstance(before, int | float):
        try:
            number = float(text.replace(",", "."))
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ConfigError(f"{key} {text!r}: must be a number")
        return round(number) if isinstance(before, int) and number == round(number) else number
    return text
