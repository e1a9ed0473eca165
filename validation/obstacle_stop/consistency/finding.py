"""Result of a check."""

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Finding:
    """A contradiction in a log, or what could not be checked; a blocking one makes a verdict meaningless.

    `text` names the cause with numbers; `numbers` holds them with units in their names.
    """

    code: str
    text: str
    numbers: dict[str, float]
    is_blocking: bool

    @property
    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; numbers that are not finite are left out."""
        numbers = {name: round(float(value), 4) for name, value in self.numbers.items() if math.isfinite(value)}
        return {"code": self.code, "text": self.text, "numbers": numbers, "is_blocking": self.is_blocking}


def not_checked(what: str, reason: str, numbers: dict[str, float] | None = None) -> Finding:
    """A check that the log does not allow."""
    return Finding("not_checked", f"not checked: {what} ({reason})", numbers or {}, False)
