"""Assembly of the simulated world and all nodes; the only module that imports every folder."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import count

import can

from configs.site import PoseConfig
from configs.strict import CONFIGS, load
from control.controller import Controller
from interfaces.orders.port import OrderPort
from localization.lidar.lidar_odometry import LidarOdometryNode
from localization.lidar.map_localization import LidarMap
from localization.localizer import Localizer
from messages.node import Node, World
from planning.mission import MissionNode
from runtime.executor import check_wiring
from runtime.order_gate import order_gate
from runtime.perception_nodes import perception_nodes
from runtime.safety_nodes import safety_nodes
from runtime.setup import Setup
from simulation.faults.config import FaultsConfig
from simulation.faults.frames import FaultyBus
from simulation.faults.injection import FaultInjection
from simulation.faults.node_faults import FaultyNode, SteppingClock
from simulation.machine.tractor_bus import load_database
from simulation.operator import SimulatedOperator
from simulation.plant import Plant, PlantModels, calibrated, draw_plant
from simulation.scenario import Scenario
from simulation.world import Rendering, SimulationWorld

_CHANNELS = count()


@contextmanager
def assemble(
    setup: Setup, scenario: Scenario, is_ablation: bool = False, injection: FaultInjection | None = None,
    rendering: Rendering = Rendering.IN_THREAD, order_port: OrderPort | None = None,
) -> Iterator[tuple[World, list[tuple[Node, int]]]]:  # fmt: skip
    """Simulated world and nodes with their latencies (ns), wired and checked; closes the CAN bus afterwards.

    The order gate takes orders from `order_port` too. `is_ablation` omits the supervisor's obstacle rules. The executor
    must have `injection` as its tap. Raises WiringError.
    """
    channel = f"headland-{next(_CHANNELS)}"
    with (
        can.Bus(interface="virtual", channel=channel) as bus,
        can.Bus(interface="virtual", channel=channel) as tractor,
        closing(simulated_world(setup, scenario, tractor, rendering)) as world,
    ):
        stack_bus = bus if injection is None else FaultyBus(bus, injection, load_database())
        chain = [
            order_gate(setup, port=order_port),
            *perception_nodes(setup.vehicle, setup.implement, setup.stack.perception),
            *localization_nodes(setup),
            *planning_nodes(setup),
            *control_nodes(setup),
            *safety_nodes(setup, stack_bus, is_ablation),
        ]
        nodes = [(node, setup.stack.executor.latency_ns(node.name)) for node in chain]
        check_wiring(world, nodes, setup.stack.executor.cores)
        if injection is None:
            yield world, nodes
        else:
            injection.check_topics([*world.writes, *(topic for node in chain for topic in node.writes)])
            yield SteppingClock(world, injection), [(FaultyNode(node, injection), ns) for node, ns in nodes]


def simulated_world(
    setup: Setup, scenario: Scenario, bus: can.BusABC, rendering: Rendering = Rendering.IN_THREAD
) -> SimulationWorld:
    """Simulated world whose machine is on this bus, with all kernels compiled."""
    world = SimulationWorld(
        plant_of(setup, scenario), scenario, setup.plan.paths, bus, setup.seed, setup.stack.simulation, setup.is_folded,
        SimulatedOperator(setup.seed, setup.machine_id, setup.session), rendering,
    )  # fmt: skip
    world.machine.attached.hitch = setup.hitch
    world.warm()
    return world


def plant_of(setup: Setup, scenario: Scenario) -> Plant:
    """Plant of a scenario and seed, drawn around the configuration files.

    What the stack assumes instead of them changes what wheel and angle sensors report, and nothing that is true.
    """
    config = setup.stack.simulation
    models = PlantModels(config.machine, config.gnss, config.imu)
    vehicle, implement = setup.built or (setup.vehicle, setup.implement)
    configured = Plant(setup.site, vehicle, implement, models, setup.start)
    plant = draw_plant(scenario.plant, configured, config.plant, setup.seed)
    return plant if setup.built is None else calibrated(plant, vehicle, setup.vehicle)


def fault_injection_for(setup: Setup, scenario: Scenario) -> FaultInjection | None:
    """FaultInjection of the scenario's faults, None without faults; raises ConfigError for an unknown fault."""
    if not scenario.faults:
        return None
    config = load(FaultsConfig, CONFIGS / "faults.yaml")
    return FaultInjection(scenario.faults, config, setup.stack.simulation.start_stamp_ns, setup.seed)


def localization_nodes(setup: Setup) -> list[Node]:
    """Lidar odometry, map localization and localizer: from sensor messages to the pose."""
    localization = setup.stack.localization
    return [
        LidarOdometryNode(setup.vehicle, setup.implement, localization.lidar_odometry),
        LidarMap(setup.vehicle, setup.implement, setup.site.shed, localization.lidar_map),
        Localizer(setup.vehicle, setup.site.datum.datum, localization, setup.site.shed, _dock_pose(setup)),
    ]


def _dock_pose(setup: Setup) -> PoseConfig | None:
    """Dock pose at which the machine was parked, None outside the shed."""
    mission, shed = setup.mission, setup.site.shed
    if shed is None or mission.bay is None or mission.start is not None:
        return None
    return shed.bay(mission.bay).dock


def planning_nodes(setup: Setup) -> list[Node]:
    """Mission node: from tracks and pose to the path."""
    return [MissionNode(setup.plan, setup.stack.planning.mission, setup.seed)]


def control_nodes(setup: Setup) -> list[Node]:
    """Controller: from path and pose to the control command."""
    return [Controller(setup.vehicle, setup.implement, setup.stack.control)]
