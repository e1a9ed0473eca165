"""What a mission needs, loaded and checked before anything is written."""

from dataclasses import dataclass
from pathlib import Path

from configs.mission import Mission
from configs.site import Site
from configs.strict import CONFIGS, find, load
from configs.vehicle import ImplementFile, MountedImplement, TrailedImplement, Vehicle
from datasets.viewer import Viewer
from messages.errors import ConfigError
from planning.field import read_field
from planning.plan import Plan, plan_mission
from planning.surroundings import site_around
from runtime.stack import StackConfig


@dataclass(frozen=True)
class Setup:
    """Everything that a run is made of, besides its world."""

    mission: Mission
    site: Site
    vehicle: Vehicle
    implement: MountedImplement | TrailedImplement
    stack: StackConfig
    plan: Plan
    seed: int

    def viewer(self) -> Viewer:
        """What turns messages into topics that the usual viewers draw."""
        return Viewer(self.stack.datasets.viewer, self.vehicle, self.implement, self.site)


def load_setup(mission: str, machine: str | None, implement: str | None, field: str | None, seed: int) -> Setup:
    """Load the named files and plan the mission; raises ConfigError or FieldError."""
    chosen = load(Mission, find("missions", mission))
    names = {"machine": machine or chosen.machine, "implement": implement or chosen.implement}
    chosen = chosen.model_copy(update=names | ({"site": field} if field else {}))
    vehicle = load(Vehicle, find("machines", chosen.machine))
    carried = load(ImplementFile, find("implements", chosen.implement)).implement
    vehicle = carrying(vehicle, carried)
    stack = load(StackConfig, CONFIGS / "stack.yaml")
    site = (
        site_around(read_field(Path(field)), vehicle, carried, chosen.work)
        if field
        else load(Site, find("sites", chosen.site))
    )
    plan = plan_mission(site, vehicle, carried, chosen.work, stack.planning.planner, seed)
    return Setup(chosen, site, vehicle, carried, stack, plan, seed)


def carrying(vehicle: Vehicle, implement: MountedImplement | TrailedImplement) -> Vehicle:
    """The vehicle with the sensors that its implement brings; raises ConfigError when both use one name."""
    if not isinstance(implement, MountedImplement) or not implement.ultrasonic:
        return vehicle
    own = vehicle.sensors.ultrasonic
    twice = sorted(own.keys() & implement.ultrasonic.keys())
    if twice:
        raise ConfigError(f"ultrasonic {twice[0]!r} is on {vehicle.name!r} and on {implement.name!r}; rename one")
    sensors = vehicle.sensors.model_copy(update={"ultrasonic": own | implement.ultrasonic})
    return vehicle.model_copy(update={"sensors": sensors})
