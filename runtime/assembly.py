"""Which nodes there are, and who is told what: the only place that knows every room."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import count

import can

from configs.site import PoseConfig
from configs.strict import CONFIGS, load
from control.controller import Controller
from interfaces.gateway import CanBus, Gateway
from localization.lidar.lidar_odometry import LidarOdometryNode
from localization.lidar.map_localization import LidarMap
from localization.localizer import Localizer
from messages.node import Node, World
from planning.mission import MissionNode
from runtime.executor import FAULT_TOPIC, check_wiring
from runtime.perception_nodes import perceiving
from runtime.setup import Setup
from safety.rules import OBSTACLE_RULES
from safety.supervisor import Supervisor
from safety.zones.geofence import geofence_of
from safety.zones.known_structure import structure_of_site
from simulation.faults.config import FaultsConfig
from simulation.faults.frames import FaultyBus
from simulation.faults.injection import FaultInjection
from simulation.faults.node_faults import FaultyNode, SteppingClock
from simulation.machine.tractor_bus import load_database
from simulation.scenario import Scenario
from simulation.world import SimulationWorld

FAULT_TOPICS = ("fault/localizer", "fault/gateway", FAULT_TOPIC)
_CHANNELS = count()


@contextmanager
def assemble(
    setup: Setup, scenario: Scenario, is_ablation: bool = False, injection: FaultInjection | None = None
) -> Iterator[tuple[World, list[tuple[Node, int]]]]:
    """The simulated world and the nodes with their latencies in ns, wired and checked; closes the bus afterwards.

    Raises WiringError. With `is_ablation` the supervisor's obstacle rules are off. `injection` breaks what its faults
    say; the executor must have it as its tap.
    """
    channel = f"headland-{next(_CHANNELS)}"
    with (
        can.Bus(interface="virtual", channel=channel) as bus,
        can.Bus(interface="virtual", channel=channel) as tractor,
        closing(simulated(setup, scenario, tractor)) as world,
    ):
        heard = bus if injection is None else FaultyBus(bus, injection, load_database())
        chain = [
            *seeing(setup),
            *locating(setup),
            *planning(setup),
            *steering(setup),
            *guarding(setup, heard, is_ablation),
        ]
        nodes = [(node, setup.stack.executor.latency_ns(node.name)) for node in chain]
        check_wiring(world, nodes, setup.stack.executor.cores)
        if injection is None:
            yield world, nodes
        else:
            injection.check_topics([*world.writes, *(topic for node in chain for topic in node.writes)])
            yield SteppingClock(world, injection), [(FaultyNode(node, injection), ns) for node, ns in nodes]


def simulated(setup: Setup, scenario: Scenario, bus: can.BusABC, renders_in_thread: bool = False) -> SimulationWorld:
    """The simulated world with its machine on this bus, ready for the first scan."""
    world = SimulationWorld(
        setup.site,
        setup.vehicle,
        setup.implement,
        scenario,
        setup.plan.paths,
        bus,
        setup.seed,
        setup.stack.simulation,
        setup.start,
        setup.is_folded,
        renders_in_thread,
    )
    world.warm()
    return world


def planted(setup: Setup, scenario: Scenario) -> FaultInjection | None:
    """The faults that a scenario states, or None; raises ConfigError when one cannot be."""
    if not scenario.faults:
        return None
    config = load(FaultsConfig, CONFIGS / "faults.yaml")
    return FaultInjection(scenario.faults, config, setup.stack.simulation.start_stamp_ns, setup.seed)


def seeing(setup: Setup) -> list[Node]:
    """From sensors to tracks."""
    return perceiving(setup.vehicle, setup.implement, setup.stack.perception)


def locating(setup: Setup) -> list[Node]:
    """From sensors to the pose."""
    localization = setup.stack.localization
    return [
        LidarOdometryNode(setup.vehicle, "front", localization.lidar_odometry),
        LidarMap(setup.vehicle, setup.implement, setup.site.shed, localization.lidar_map),
        Localizer(setup.vehicle, setup.site.datum.datum, localization, setup.site.shed, _dock(setup)),
    ]


def _dock(setup: Setup) -> PoseConfig | None:
    """Where the machine was left in the shed, None when it was left outside."""
    mission, shed = setup.mission, setup.site.shed
    if shed is None or mission.bay is None or mission.start is not None:
        return None
    return shed.bay(mission.bay).dock


def planning(setup: Setup) -> list[Node]:
    """From tracks and pose to the path."""
    return [MissionNode(setup.plan, setup.stack.planning.mission, setup.seed)]


def steering(setup: Setup) -> list[Node]:
    """From path and pose to the wish."""
    return [Controller(setup.vehicle, setup.implement, setup.stack.control)]


def guarding(setup: Setup, bus: CanBus, is_ablation: bool) -> list[Node]:
    """From the wish to the machine's bus."""
    disabled = OBSTACLE_RULES if is_ablation else frozenset()
    return [
        Supervisor(
            setup.vehicle,
            setup.implement,
            setup.stack.safety,
            geofence_of(setup.site),
            FAULT_TOPICS,
            disabled,
            structure_of_site(setup.site),
            idle_of(setup),
        ),
        Gateway(bus, setup.vehicle, setup.stack.interfaces.gateway),
    ]


def idle_of(setup: Setup) -> frozenset[str]:
    """Cameras without a model detect nothing: the supervisor does not count on them, and does not miss them."""
    has_model = setup.stack.perception.camera.detector.model is not None
    return frozenset() if has_model else frozenset(f"camera_{name}" for name in setup.vehicle.sensors.camera)
