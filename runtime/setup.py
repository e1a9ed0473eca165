"""What a mission needs, loaded and checked before anything is written."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from configs.mission import Mission, Spread
from configs.site import PoseConfig, Site
from configs.strict import find, load
from configs.vehicle import ImplementFile, MountedImplement, TrailedImplement, Vehicle
from datasets.viewer import Viewer
from messages.errors import ConfigError
from planning.field.field import read_field
from planning.field.site_generation import site_around
from planning.plan import Plan, plan_mission
from runtime.stack import StackConfig, load_stack, with_detector

START_STREAM = 0x5747  # of random numbers, apart from those of world and planner


@dataclass(frozen=True)
class Setup:
    """Everything that a run is made of, besides its world; at `start` it stands when the run begins."""

    mission: Mission
    site: Site
    vehicle: Vehicle
    implement: MountedImplement | TrailedImplement
    stack: StackConfig
    plan: Plan
    seed: int
    start: PoseConfig
    is_folded: bool

    def viewer(self) -> Viewer:
        """What turns messages into topics that the usual viewers draw."""
        return Viewer(self.stack.datasets.viewer, self.vehicle, self.implement, self.site)


def load_setup(
    mission: str, machine: str | None, implement: str | None, field: str | None, seed: int, bay: str | None = None
) -> Setup:
    """Load the named files and plan the mission, docking in `bay` where given; raises ConfigError or FieldError."""
    chosen = load(Mission, find("missions", mission))
    # a field drawn by itself has no shed
    chosen = chosen.model_copy(update={"site": field, "bay": None} if field else {})
    names = {"machine": machine or chosen.machine, "implement": implement or chosen.implement, "bay": bay or chosen.bay}
    chosen = chosen.model_copy(update=names)
    vehicle = load(Vehicle, find("machines", chosen.machine))
    carried = load(ImplementFile, find("implements", chosen.implement)).implement
    vehicle = carrying(vehicle, carried)
    stack = load_stack()
    site = _site(chosen, field, vehicle, carried)
    start, is_folded = start_of(chosen, site, seed)
    plan = plan_mission(chosen, site, vehicle, carried, stack.planning, start, seed)
    return Setup(chosen, site, vehicle, carried, stack, plan, seed, start, is_folded)


def with_model(setup: Setup, model: Path | None) -> Setup:
    """The same with the cameras' detector from this file, where one is given; raises ConfigError when there is none."""
    return replace(setup, stack=with_detector(setup.stack, model))


def start_of(mission: Mission, site: Site, seed: int) -> tuple[PoseConfig, bool]:
    """Where the machine stands at first, and whether folded: docked, at the site's start, or as the seed draws it."""
    if mission.start is not None:
        return _drawn(mission.start, mission.spread, seed), False
    if mission.bay is None:
        return site.start, False
    return site.bay(mission.bay).dock, True


def _drawn(pose: PoseConfig, spread: Spread | None, seed: int) -> PoseConfig:
    """A pose evenly drawn from the disc and the headings about another."""
    if spread is None:
        return pose
    share, angle, turn = np.random.default_rng([seed, START_STREAM]).uniform(size=3)
    away = spread.distance_m * math.sqrt(share)
    return PoseConfig(
        x_m=pose.x_m + away * math.cos(2.0 * math.pi * angle),
        y_m=pose.y_m + away * math.sin(2.0 * math.pi * angle),
        heading_deg=pose.heading_deg + spread.heading_deg * (2.0 * turn - 1.0),
    )


def _site(
    mission: Mission, field: str | None, vehicle: Vehicle, implement: MountedImplement | TrailedImplement
) -> Site:
    if field is None:
        return load(Site, find("sites", mission.site))
    if mission.work is None:
        raise ConfigError(f"mission {mission.name!r} has no work to do on the field {field}; name another mission")
    return site_around(read_field(Path(field)), vehicle, implement, mission.work)


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
