"""Setup of a machine: what a person enters or calibrates, of which each change is a version of its own."""

import json
from typing import Any

from pydantic import Field, model_validator

from configs.mission import Work
from configs.sensor_kinds import SENSOR_KINDS, sensors_of
from configs.strict import Config, parse
from configs.vehicle import Implement, MountedImplement, Vehicle
from messages.errors import ConfigError


class Corrections(Config):
    """Which GNSS solutions are used, and how old their corrections may be."""

    min_satellites: int = Field(ge=4, le=30)
    max_correction_age_s: float = Field(gt=0.0, le=600.0)
    uses_rtk_float: bool
    uses_ppp: bool
    uses_sbas: bool
    uses_single: bool


class MachineSetup(Config):
    """Vehicle and implement with their mounts, corrections, and work mode of new plans."""

    vehicle: Vehicle
    implement: Implement
    corrections: Corrections
    work: Work

    @model_validator(mode="after")
    def _sensor_names_are_unique(self) -> "MachineSetup":
        if isinstance(self.implement, MountedImplement):
            for kind in SENSOR_KINDS:
                names = sensors_of(self.vehicle.sensors, kind).keys() & sensors_of(self.implement.sensors, kind).keys()
                if names:
                    raise ValueError(f"sensors.{kind}.{min(names)}: is on the machine and on the implement")
        return self

    @property
    def machine(self) -> str:
        """Name of machine and implement, to which versions belong."""
        return f"{self.vehicle.name} + {self.implement.name}"

    def to_json(self) -> str:
        """The setup as JSON; equal setups give the same text."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, ensure_ascii=False)


def setup_from_json(text: str, where: str) -> MachineSetup:
    """The setup of a text; raises ConfigError."""
    try:
        values: Any = json.loads(text)
    except ValueError as error:
        raise ConfigError(f"{where}: not JSON ({error})") from error
    return parse(MachineSetup, values, where)


def leaves(setup: MachineSetup) -> dict[str, Any]:
    """Values by dotted key, such as `vehicle.sensors.lidar.front.mount.xyz_m.2`."""
    return dict(_leaves("", setup.model_dump(mode="json")))


def with_values(setup: MachineSetup, changes: dict[str, Any]) -> MachineSetup:
    """The setup with other values by dotted key; raises ConfigError that names key and value."""
    values = setup.model_dump(mode="json")
    for key, value in changes.items():
        *path, last = key.split(".")
        place: Any = values
        try:
            for name in path:
                place = place[int(name)] if isinstance(place, list) else place[name]
            index: Any = int(last) if isinstance(place, list) else last
            if isinstance(place[index], list | dict):
                raise KeyError(last)
            place[index] = value
        except (KeyError, IndexError, ValueError, TypeError) as error:
            raise ConfigError(f"{key[:120]}: no such value of the setup") from error
    return parse(MachineSetup, values, "setup")


def _leaves(prefix: str, value: Any) -> list[tuple[str, Any]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if items is None:
        return [(prefix, value)]
    return [leaf for key, one in items for leaf in _leaves(f"{prefix}.{key}" if prefix else str(key), one)]
