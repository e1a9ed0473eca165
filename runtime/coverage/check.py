"""Refusal to drive with a machine whose sensors leave a place uncovered that it can reach."""

from configs.mission import Mission
from configs.strict import CONFIGS, load
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle, undriven
from messages.errors import ConfigError
from planning.config import PlanningConfig
from runtime.coverage.config import CoverageConfig
from runtime.coverage.evaluation import Coverage, evaluate
from runtime.coverage.states import states_of
from safety.config import SafetyConfig


def require_coverage(
    mission: Mission, vehicle: Vehicle, implement: MountedImplement | TrailedImplement, planning: PlanningConfig,
    safety: SafetyConfig,
) -> None:  # fmt: skip
    """Raises ConfigError that names place, body height and state if a place is uncovered that a mission can reach.

    Also for a trailed implement, whose angle is not measured.
    """
    if isinstance(implement, TrailedImplement):
        raise ConfigError(undriven(implement))
    parts = (mission, vehicle, implement, planning, safety)
    key = "".join(part.model_dump_json() for part in parts)
    refusal = _refusals.get(key)
    if refusal is None:
        config = load(CoverageConfig, CONFIGS / "coverage.yaml")
        found = evaluate(vehicle, implement, states_of(mission, vehicle, implement, planning), safety, config)
        refusal = _refusals[key] = refusal_of(found, vehicle, implement)
    if refusal:
        raise ConfigError(refusal)


_refusals: dict[str, str] = {}  # by configuration: a campaign drives one machine many times


def refusal_of(found: list[Coverage], vehicle: Vehicle, implement: MountedImplement | TrailedImplement) -> str:
    """What the sensors leave uncovered, the largest area first; empty without any."""
    rows = [row for row in (one.row() for one in found) if row["worst_m"] is not None]
    if not rows:
        return ""
    worst = max(rows, key=lambda row: float(str(row["uncovered_m2"])))
    return (
        f"{vehicle.name} with {implement.name}: no sensor covers the place (x, y) = {worst['worst_m']} m, which it can "
        f"reach within its stopping distance, for a body {worst['height_m']} m high while {worst['state']} "
        f"({worst['uncovered_m2']} m²; `headland coverage` shows all)"
    )
