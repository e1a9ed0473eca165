"""Nodes of the lidars of a vehicle."""

from configs.vehicle import Implement, Vehicle
from messages.node import Node
from perception.lidar.obstacles import LidarConfig, LidarObstacles


def make_nodes(vehicle: Vehicle, implement: Implement | None, config: LidarConfig) -> tuple[list[Node], list[Node]]:
    """Obstacle nodes, which also publish the health; no health nodes."""
    lidars = vehicle.sensors.segmented_lidars.items()
    return [LidarObstacles(name, one, vehicle, implement, config) for name, one in lidars], []
