"""Fixtures: parts of the demo mission and its plan."""

import pytest

from configs.mission import Mission
from configs.site import Site
from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import ImplementFile, MountedImplement, TrailedImplement, Vehicle
from planning.config import PlanningConfig
from planning.plan import Plan, plan_field


@pytest.fixture(scope="session")
def planning() -> PlanningConfig:
    return parse(PlanningConfig, read_yaml(CONFIGS / "stack/planning.yaml"), "stack/planning.yaml")


@pytest.fixture(scope="session")
def mission() -> Mission:
    return load(Mission, find("missions", "demo"))


@pytest.fixture(scope="session")
def site() -> Site:
    return load(Site, find("sites", "demo"))


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load(Vehicle, find("machines", "tractor_e"))


@pytest.fixture(scope="session")
def harrow() -> MountedImplement:
    found = load(ImplementFile, find("implements", "harrow_6m")).implement
    assert isinstance(found, MountedImplement)
    return found


@pytest.fixture(scope="session")
def disc_harrow() -> TrailedImplement:
    found = load(ImplementFile, find("implements", "disc_harrow_3m")).implement
    assert isinstance(found, TrailedImplement)
    return found


@pytest.fixture(scope="session")
def plan(site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig) -> Plan:
    return plan_field(site, vehicle, harrow, mission.work, planning.planner, 0)
