"""Perception nodes for every sensor of a vehicle."""

from configs.sensor_kinds import SENSOR_KINDS
from configs.vehicle import Implement, Vehicle
from messages.node import Node
from perception.config import PerceptionConfig
from perception.fusion.tracker import Tracker
from perception.sensor_registry import NODES


def perception_nodes(vehicle: Vehicle, implement: Implement | None, config: PerceptionConfig) -> list[Node]:
    """Obstacle and health nodes of all sensors, and the tracker over all obstacles; raises ConfigError for a bad model.

    Kinds that need a detector come last, which sets the order of the tracker's inputs.
    """
    obstacles, health = list[Node](), list[Node]()
    for kind in sorted(NODES, key=lambda name: SENSOR_KINDS[name].needs_detector):
        more_obstacles, more_health = NODES[kind](vehicle, implement, getattr(config, kind, None))
        obstacles += more_obstacles
        health += more_health
    tracker = Tracker([f"obstacles/{node.name}" for node in obstacles], config.tracker)
    return [*obstacles, *health, tracker]
