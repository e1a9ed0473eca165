"""Fixtures: configuration of the supervisor, machines, closed loops."""

import inspect
from pathlib import Path

import numpy as np
import pytest

from configs.strict import load, parse, read_yaml
from configs.vehicle import Camera, ImplementFile, Mount, Radar, Ultrasonic, Vehicle
from safety.supervisor import Supervisor
from safety.supervisor_config import SupervisorConfig
from safety.zones.geofence import Geofence
from tests.safety.safety_world import ROOT, World, straight_path, tractor

FOLDER = Path(__file__).parent
DRIVES = {"world", "seeing", "shed_world", "sparse", "lidar_world"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the tests that drive a machine in a closed loop, which runs for coverage and mutation leave out."""
    for item in items:
        if not item.path.is_relative_to(FOLDER):
            continue
        item.add_marker("safety")
        if isinstance(item, pytest.Function) and DRIVES & inspect.signature(item.function).parameters.keys():
            item.add_marker("drive")


@pytest.fixture(scope="session")
def config() -> SupervisorConfig:
    return parse(SupervisorConfig, read_yaml(ROOT / "configs/stack/safety.yaml"), "stack/safety.yaml")


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    """Machine with motion sensors and one lidar in each direction of travel only."""
    return tractor("front", "rear")


@pytest.fixture(scope="session")
def implement():
    return load(ImplementFile, ROOT / "configs/implements/harrow_6m.yaml").implement


@pytest.fixture
def geofence() -> Geofence:
    return Geofence((np.array([(-50.0, -50.0), (200.0, -50.0), (200.0, 50.0), (-50.0, 50.0)]),))


@pytest.fixture(scope="session")
def sparse(vehicle: Vehicle) -> Vehicle:
    """The same machine with a quarter of the lidar columns, for speed."""
    lidars = {n: lidar.model_copy(update={"columns": lidar.columns // 4}) for n, lidar in vehicle.sensors.lidar.items()}
    return vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"lidar": lidars})})


@pytest.fixture
def world(config, sparse, implement, geofence) -> World:
    supervisor = Supervisor(sparse, implement, config, geofence, ("fault/executor",))
    return World(supervisor, sparse, straight_path(), is_plain=True)


@pytest.fixture(scope="session")
def full(sparse: Vehicle) -> Vehicle:
    """The sparse machine with a radar and a camera in front, and ultrasonic sensors in front and behind."""
    around = Radar(
        mount=Mount(xyz_m=(3.5, 0.0, 0.8)), field_of_view_deg=120.0, rate_hz=25.0, range_m=(0.5, 60.0),
        range_sigma_m=0.15, azimuth_sigma_deg=1.0, doppler_sigma_mps=0.1,
    )  # fmt: skip
    ultrasonic = {
        name: Ultrasonic(mount=Mount(xyz_m=(x, y, 0.7), rpy_deg=(0.0, 0.0, yaw)), cone_deg=60.0, rate_hz=10.0,
                         range_m=(0.25, 4.5), range_sigma_m=0.01)
        for name, x, y, yaw in (("left", 3.5, 0.6, 0.0), ("right", 3.5, -0.6, 0.0), ("rear", -2.4, 0.0, 180.0))
    }  # fmt: skip
    camera = Camera(mount=Mount(xyz_m=(3.2, 0.0, 2.2)), size_px=(1280, 720), focal_px=(900.0, 900.0),
                    center_px=(640.0, 360.0), rate_hz=2.0)  # fmt: skip
    more = {"radar": {"front": around}, "ultrasonic": ultrasonic, "camera": {"front": camera}}
    lidars = {n: lidar.model_copy(update={"columns": lidar.columns // 2}) for n, lidar in sparse.sensors.lidar.items()}
    return sparse.model_copy(update={"sensors": sparse.sensors.model_copy(update=more | {"lidar": lidars})})


@pytest.fixture
def seeing(config, full, implement, geofence) -> World:
    """Closed loop with that machine."""
    return World(Supervisor(full, implement, config, geofence, ("fault/executor",)), full, straight_path())
