"""The supervisor's configuration, a machine, and a world around it."""

import numpy as np
import pytest
from safety_world import ROOT, World, straight_path

from configs.strict import load, parse, read_yaml
from configs.vehicle import ImplementFile, Vehicle
from safety.config import SafetyConfig
from safety.fence import Fence
from safety.supervisor import Supervisor


@pytest.fixture(scope="session")
def config() -> SafetyConfig:
    return parse(SafetyConfig, read_yaml(ROOT / "configs/stack.yaml")["safety"], "stack.yaml safety")


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load(Vehicle, ROOT / "configs/machines/tractor_e.yaml")


@pytest.fixture(scope="session")
def implement():
    return load(ImplementFile, ROOT / "configs/implements/harrow_6m.yaml").implement


@pytest.fixture
def fence() -> Fence:
    return Fence((np.array([(-50.0, -50.0), (200.0, -50.0), (200.0, 50.0), (-50.0, 50.0)]),))


@pytest.fixture(scope="session")
def thin(vehicle: Vehicle) -> Vehicle:
    """The same machine with a quarter of the columns, so that the loop is quick."""
    lidars = {n: lidar.model_copy(update={"columns": lidar.columns // 4}) for n, lidar in vehicle.sensors.lidar.items()}
    return vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"lidar": lidars})})


@pytest.fixture
def world(config, thin, implement, fence) -> World:
    supervisor = Supervisor(thin, implement, config, fence, ("fault/executor",))
    return World(supervisor, thin, straight_path(), is_plain=True)
