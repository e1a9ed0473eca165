"""Nodes of the radars of a vehicle."""

from configs.vehicle import Implement, Vehicle
from messages.node import Node
from perception.radar.health import RadarHealth
from perception.radar.obstacles import RadarConfig, RadarObstacles


def make_nodes(vehicle: Vehicle, implement: Implement | None, config: RadarConfig) -> tuple[list[Node], list[Node]]:
    """Obstacle nodes and health nodes."""
    radars = vehicle.sensors.radar.items()
    obstacles: list[Node] = [RadarObstacles(name, one, vehicle, implement, config) for name, one in radars]
    return obstacles, [RadarHealth(name, one, config) for name, one in radars]
