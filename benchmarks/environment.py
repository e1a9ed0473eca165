"""Cost of the environment in lidar scans: ns per ray of a sweep of the front lidar, the machine at rest on the
field; with dust, as many puffs about it as in work.

./headland benchmark environment [SWEEPS]
"""

import sys
import time

import can
import numpy as np

from configs.site import PoseConfig, Site
from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import ImplementFile, Vehicle
from simulation.operator import SimulatedOperator
from simulation.plant import Plant, PlantModels
from simulation.scenario import Scenario
from simulation.sensors.lidar import LidarModel
from simulation.sensors.sensor import WorldState
from simulation.world import SimulationConfig, SimulationWorld

Values = dict[str, object]
CROP: Values = {"vegetation": [{"kind": "crop", "height_m": 0.35}]}
STUBBLE: Values = {"vegetation": [{"kind": "stubble", "height_m": 0.2}]}
GULLS: Values = {"birds": {"gulls": 6}}
DUST: Values = {"dust": {"visibility_m": 5.0}}
ENVIRONMENTS: dict[str, Values | None] = {
    "none": None, "beams alone": {}, "crop 0.35 m": CROP, "stubble 0.2 m": STUBBLE,
    "fog 50 m": {"fog": {"visibility_m": 50.0}}, "rain 100 m": {"rain": {"visibility_m": 100.0}}, "dust": DUST,
    "six gulls": GULLS, "crop, dust, fog, gulls": {**CROP, **GULLS, **DUST, "fog": {"visibility_m": 100.0}},
}  # fmt: skip
START = PoseConfig(x_m=10.0, y_m=25.0, heading_deg=0.0)
DRIVE_S = 1.0
PUFFS = (-20.0, 15.0, 0.3, 0.5, 0.05), (30.0, 35.0, 1.5, 1.7, 1.0)  # place in `map`, sigma, optical depth times area


def world_of(environment: Values | None, channel: str) -> SimulationWorld:
    """The demo farm with the front lidar alone, on the field."""
    site, vehicle = load(Site, find("sites", "demo")), load(Vehicle, find("machines", "tractor_e"))
    sensors = type(vehicle.sensors)(lidar={"front": vehicle.sensors.lidar["front"]})
    config = parse(SimulationConfig, read_yaml(CONFIGS / "stack/simulation.yaml"), "stack/simulation.yaml")
    values: Values = {"name": "benchmark", "operator_commands": []}
    scenario = parse(Scenario, values if environment is None else values | {"environment": environment}, "benchmark")
    implement = load(ImplementFile, find("implements", "harrow_6m")).implement
    models = PlantModels(config.machine, config.gnss, config.imu)
    plant = Plant(site, vehicle.model_copy(update={"sensors": sensors}), implement, models, START)
    bus, operator = can.Bus(interface="virtual", channel=channel), SimulatedOperator(1, "benchmark", "00")
    return SimulationWorld(plant, scenario, (), bus, 1, config, False, operator)


def ns_per_ray(world: SimulationWorld, sweeps: int) -> float:
    """Median of processor time over sweeps."""
    (model,) = (s for s in world._sensors if isinstance(s, LidarModel))
    now_ns = 0
    for _ in range(round(DRIVE_S * 100)):
        now_ns = world.next_ns() or now_ns
        list(world.step(now_ns))
    media = world._scene.media
    if media is not None and media.has_clouds:
        puffs = np.random.default_rng(1).uniform(*PUFFS, (74, 5))
        media.puffs = lambda: puffs  # type: ignore[method-assign]
    state = WorldState(now_ns, DRIVE_S, world._poses, world.machine, world._scene)
    taken = []
    for _ in range(sweeps):
        start = time.process_time()
        scan = model.sample(state)
        taken.append(time.process_time() - start)
    return float(1e9 * np.median(taken) / scan.ranges_mm.size)  # type: ignore[attr-defined]


def main() -> int:
    """Prints one line per environment."""
    sweeps = int(sys.argv[1]) if len(sys.argv) > 1 else 30
    print("environment               ns per ray   ms per sweep")
    for k, (name, environment) in enumerate(ENVIRONMENTS.items()):
        world = world_of(environment, f"benchmark-{k}")
        taken = ns_per_ray(world, sweeps)
        world.close()
        print(f"{name:25s} {taken:10.0f} {taken * 32 * 1024e-6:14.1f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
