"""Nodes of the ultrasonic sensors of a vehicle."""

from configs.vehicle import Implement, Vehicle
from messages.node import Node
from perception.ultrasonic.health import UltrasonicHealth
from perception.ultrasonic.obstacles import UltrasonicConfig, UltrasonicObstacles


def make_nodes(
    vehicle: Vehicle, implement: Implement | None, config: UltrasonicConfig
) -> tuple[list[Node], list[Node]]:
    """Obstacle nodes and health nodes."""
    sensors = vehicle.sensors.ultrasonic.items()
    obstacles: list[Node] = [UltrasonicObstacles(name, one, vehicle, implement, config) for name, one in sensors]
    return obstacles, [UltrasonicHealth(name, one, config) for name, one in sensors]
