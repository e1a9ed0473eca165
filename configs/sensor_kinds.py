"""Kinds of obstacle sensors: the table `configs.vehicle.Sensors` by name, and the registries of the folders.

A folder processes the kinds by modules of its own, `<package>.<kind>` or `<package>.<kind>.nodes`, collected by
`registry`. tests/test_sensor_kinds.py checks that every registry is complete.
"""

from collections.abc import Collection, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeVar, get_args

from configs.vehicle import SensorKind, Sensors

V = TypeVar("V")
SENSOR_KINDS: dict[str, SensorKind] = {
    name: fact
    for name, field in Sensors.model_fields.items()
    for fact in field.metadata
    if isinstance(fact, SensorKind)
}
MONITORED_KINDS = tuple(kind for kind, facts in SENSOR_KINDS.items() if not facts.is_required)


def require_kinds(values: dict[str, V], kinds: Collection[str]) -> dict[str, V]:
    """Values by kind as they are; raises ValueError for a missing or unknown kind."""
    if values.keys() != set(kinds):
        raise ValueError(f"must have the kinds {', '.join(kinds)}; found: {', '.join(values)}")
    return values


def config_class_of(kind: str) -> type[Any]:
    """Configuration class of one sensor of a kind."""
    config: type[Any] = get_args(Sensors.model_fields[kind].annotation)[1]
    return config


def sensors_of(sensors: Sensors, kind: str) -> Mapping[str, Any]:
    """Sensors of a kind by name."""
    found: Mapping[str, Any] = getattr(sensors, kind)
    return found


def registry(module: str, attribute: str) -> dict[str, Any]:
    """Attribute of the module of each kind, in the order of the table; `module` has `{}` for the kind.

    A kind without such a module is left out.
    """
    return {
        kind: getattr(import_module(module.format(kind)), attribute) for kind in SENSOR_KINDS if _exists(module, kind)
    }


def _exists(module: str, kind: str) -> bool:
    parent = module.format(kind).rpartition(".")[0]
    return find_spec(parent) is not None and find_spec(module.format(kind)) is not None
