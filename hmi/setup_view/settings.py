"""Values of a setup by section, and a value from the text that a person has entered."""

import math
from typing import Any

from configs.machine_setup import MachineSetup, leaves
from messages.errors import ConfigError

SECTIONS = ("vehicle", "implement", "corrections", "work")
MOUNTS = "mounts"
HIDDEN = (
    "work.headland",
    "work.margins",
    "work.turns",
    ".solids.",
    ".kind",
    "vehicle.name",
    "implement.name",
    ".sinks_m",
    ".guidance",
    ".swath_",
)
AXES = tuple(f"{name}.{k}" for name in ("xyz_m", "rpy_deg") for k in range(3))
UNITS = {
    "mps2": "m/s²", "kmh": "km/h", "deg": "°", "rpm": "1/min", "lpm": "L/min", "kg": "kg", "m": "m", "s": "s",
}  # fmt: skip
MAX_TEXT = 60


def section_of(key: str) -> str:
    """Section of a dotted key, "" for one that is not edited on the page."""
    if any(part in key for part in HIDDEN):
        return ""
    if ".mount." in key:
        return MOUNTS
    if ".sensors." in key and not key.endswith("angle_zero_deg"):
        return ""
    return key.partition(".")[0]


def settings_of(setup: MachineSetup, section: str) -> dict[str, Any]:
    """Values of a section by dotted key; none that is absent, such as the fold of an implement that does not fold."""
    return {key: value for key, value in leaves(setup).items() if section_of(key) == section and value is not None}


def mounts_of(setup: MachineSetup) -> dict[str, list[tuple[str, Any]]]:
    """Keys and values of x, y, z, roll, pitch and yaw of each mount, by the key of its sensor."""
    found = settings_of(setup, MOUNTS)
    sensors = list(dict.fromkeys(key.partition(".mount.")[0] for key in found))
    return {one: [(f"{one}.mount.{axis}", found[f"{one}.mount.{axis}"]) for axis in AXES] for one in sensors}


def unit_of(key: str) -> str:
    """Unit of a value by the last part of its name."""
    names = [name for name in key.split(".") if not name.isdecimal()]
    return UNITS.get(names[-1].rpartition("_")[2], "")


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
