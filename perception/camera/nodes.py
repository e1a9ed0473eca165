"""Nodes of the cameras of a vehicle."""

from configs.known_models import model_path
from configs.vehicle import Implement, Vehicle
from messages.node import Node
from perception.camera.detector import Detector, DetectorConfig, load_detector
from perception.camera.health import CameraHealth
from perception.camera.obstacles import CameraConfig, CameraObstacles


def make_nodes(vehicle: Vehicle, implement: Implement | None, config: CameraConfig) -> tuple[list[Node], list[Node]]:
    """Obstacle nodes, none without a detector model, and health nodes; raises ConfigError for a bad model."""
    cameras = vehicle.sensors.camera.items()
    detector = detector_of(config.detector) if cameras else None
    obstacles: list[Node] = []
    if detector is not None:
        obstacles = [CameraObstacles(name, one, vehicle, implement, detector, config) for name, one in cameras]
    return obstacles, [CameraHealth(name, one, detector is not None, config) for name, one in cameras]


def detector_of(config: DetectorConfig) -> Detector | None:
    """Detector of the configured model, None without a model; raises ConfigError."""
    return load_detector(model_path(config.model), config) if config.model else None
