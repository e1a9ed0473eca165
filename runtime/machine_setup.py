"""Setup of a machine from the configuration files, and its corrections in the stack. Imports no part of the stack."""

from typing import TYPE_CHECKING, Any

import yaml

from configs.machine_setup import Corrections, MachineSetup
from configs.mission import Mission
from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import Implement, ImplementFile, MountedImplement, Vehicle
from hmi.plan_view.options import default_work

if TYPE_CHECKING:
    from runtime.stack import StackConfig

SOLUTIONS = ("rtk_float", "ppp", "sbas", "single")


def configured_setup(mission: str, machine: str | None, implement: str | None) -> MachineSetup:
    """Setup of the files that a mission names, or the caller; raises ConfigError."""
    chosen = load(Mission, find("missions", mission))
    vehicle = load(Vehicle, find("machines", machine or chosen.machine))
    mounted = load(ImplementFile, find("implements", implement or chosen.implement)).implement
    return MachineSetup(vehicle=vehicle, implement=mounted, corrections=configured_corrections(), work=default_work())


def configured_corrections() -> Corrections:
    """Corrections of `configs/stack/localization.yaml`; raises ConfigError."""
    path = CONFIGS / "stack" / "localization.yaml"
    return corrections_in(read_yaml(path)["map_alignment"]["gnss"], str(path))


def corrections_in(gnss: dict[str, Any], where: str) -> Corrections:
    """Corrections of a section `localization.map_alignment.gnss`; raises ConfigError."""
    values = {key: gnss[key] for key in ("min_satellites", "max_correction_age_s")}
    uses = {f"uses_{name}": gnss[name]["is_used"] for name in SOLUTIONS}
    return parse(Corrections, values | uses, where)


def with_corrections(stack: "StackConfig", corrections: Corrections) -> "StackConfig":
    """Stack with these corrections."""
    alignment = stack.localization.map_alignment
    changes: dict[str, Any] = {
        name: getattr(alignment.gnss, name).model_copy(update={"is_used": getattr(corrections, f"uses_{name}")})
        for name in SOLUTIONS
    }
    changes |= {key: getattr(corrections, key) for key in ("min_satellites", "max_correction_age_s")}
    gnss = alignment.gnss.model_copy(update=changes)
    localization = stack.localization.model_copy(update={"map_alignment": alignment.model_copy(update={"gnss": gnss})})
    return stack.model_copy(update={"localization": localization})


def running_setup(text: str) -> MachineSetup:
    """Setup of a running machine by its resolved configuration, whose machine has the implement's sensors too."""
    values: Any = yaml.load(text, yaml.CSafeLoader)
    implement: Implement = parse(ImplementFile, {"implement": values["implement"]}, "config.yaml").implement
    vehicle = parse(Vehicle, values["machine"], "config.yaml")
    if isinstance(implement, MountedImplement):
        own = {
            kind: {name: one for name, one in some.items() if name not in (getattr(implement.sensors, kind) or {})}
            for kind, some in vehicle.sensors
            if isinstance(some, dict)
        }
        vehicle = vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update=own)})
    gnss = values["stack"]["localization"]["map_alignment"]["gnss"]
    return MachineSetup(
        vehicle=vehicle, implement=implement, corrections=corrections_in(gnss, "config.yaml"), work=default_work()
    )
