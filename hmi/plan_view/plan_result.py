"""Result of the planner: file `plan.json` of a mission."""

import json
from pathlib import Path
from typing import Any

from configs.strict import Config, parse
from messages.errors import ConfigError


class PlanResult(Config):
    """Figures of a plan, the areas that it does not work by reason (m²), and its lines for the map.

    `refills`: area worked (m²) and distance driven (m) before each one.
    """

    length_m: float
    time_s: float
    planned_share: float
    least_share: float
    field_m2: float
    swaths: int
    headland_passes: int
    has_gate: bool
    uncovered: tuple[tuple[str, float], ...]
    map: dict[str, Any]
    refills: tuple[tuple[float, float], ...] = ()
    moved_swaths: int = 0


def write_result(result: PlanResult, path: Path) -> None:
    """Writes a result."""
    path.write_text(result.model_dump_json() + "\n", encoding="utf-8")


def read_result(path: Path) -> PlanResult:
    """Reads a result; raises ConfigError."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    return parse(PlanResult, values, str(path))
