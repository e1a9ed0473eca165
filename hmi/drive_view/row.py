"""A shown value with its label."""

import math
from dataclasses import dataclass
from typing import Literal

Level = Literal["plain", "good", "warning", "alarm"]
UNKNOWN = "–"


@dataclass(frozen=True)
class Row:
    """A value with its label; `level` is shown by a sign and by colour, `symbol` is one of `hmi/symbols.py`."""

    key: str
    label: str
    value: str
    level: Level = "plain"
    symbol: str = ""


def number(value: float, digits: int, unit: str) -> str:
    """A number with its unit; a dash for NaN and infinity."""
    if not math.isfinite(value):
        return UNKNOWN
    return f"{value:.{digits}f}\u202f{unit}" if unit else f"{value:.{digits}f}"
