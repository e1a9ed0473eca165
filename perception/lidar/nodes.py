"""Nodes of the lidars of a vehicle."""

from configs.vehicle import Implement, Vehicle
from messages.node import Node
from perception.lidar.obstacles import LidarConfig, LidarObstacles


def make_nodes(vehicle: Vehicle, implement: Implement | None, config: LidarConfig) -> tuple[list[Node], list[Node]]:
    """Obstacle nodes, which also publish the health; no health nodes.

    A lidar without a beam at or above its horizon sees no tops and cuts objects off: it serves the raw protective field
    alone, if there is another one.
    """
    lidars = vehicle.sensors.lidar
    upright = {name: one for name, one in lidars.items() if max(one.elevation_deg) >= 0.0}
    return [LidarObstacles(name, one, vehicle, implement, config) for name, one in (upright or lidars).items()], []
