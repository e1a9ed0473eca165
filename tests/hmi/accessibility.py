"""Size of the controls and contrast of the texts of a page in Chromium."""

from pathlib import Path
from typing import Any

TARGET_PX = 56.0
CONTRAST = 7.0
CHECKS = (Path(__file__).parent / "accessibility.js").read_text(encoding="utf-8").partition("\n")[2]


def small_targets(page: Any) -> list[str]:
    """Controls below 56 px in width or height."""
    return list(page.evaluate(f"({CHECKS}).smallTargets({TARGET_PX})"))


def low_contrasts(page: Any) -> list[str]:
    """Texts with a contrast below 7:1."""
    return list(page.evaluate(f"({CHECKS}).lowContrasts({CONTRAST})"))
