"""Perception nodes for every sensor of a vehicle."""

from pathlib import Path

from configs.strict import CONFIGS
from configs.vehicle import Implement, Vehicle
from messages.node import Node
from perception.camera.detector import Detector, DetectorConfig, load_detector
from perception.camera.health import CameraHealth
from perception.camera.obstacles import CameraObstacles
from perception.config import PerceptionConfig
from perception.fusion.tracker import Tracker
from perception.lidar.obstacles import LidarObstacles
from perception.radar.health import RadarHealth
from perception.radar.obstacles import RadarObstacles
from perception.ultrasonic.health import UltrasonicHealth
from perception.ultrasonic.obstacles import UltrasonicObstacles


def perception_nodes(vehicle: Vehicle, implement: Implement | None, config: PerceptionConfig) -> list[Node]:
    """Obstacle and health node of each sensor, and the tracker over all obstacles; raises ConfigError for a bad model.

    Without a detector model a camera has a health node only, which reports the missing detector.
    """
    sensors = vehicle.sensors
    detector = detector_of(config.camera.detector) if sensors.camera else None
    obstacle_nodes: list[Node] = [
        *(LidarObstacles(name, one, vehicle, implement, config.lidar) for name, one in sensors.lidar.items()),
        *(RadarObstacles(name, one, vehicle, implement, config.radar) for name, one in sensors.radar.items()),
        *(
            UltrasonicObstacles(name, one, vehicle, implement, config.ultrasonic)
            for name, one in sensors.ultrasonic.items()
        ),
    ]
    if detector is not None:
        obstacle_nodes += [
            CameraObstacles(name, one, vehicle, implement, detector, config.camera)
            for name, one in sensors.camera.items()
        ]
    health: list[Node] = [
        *(RadarHealth(name, one, config.radar) for name, one in sensors.radar.items()),
        *(UltrasonicHealth(name, one, config.ultrasonic) for name, one in sensors.ultrasonic.items()),
        *(CameraHealth(name, one, detector is not None, config.camera) for name, one in sensors.camera.items()),
    ]
    tracker = Tracker([f"obstacles/{node.name}" for node in obstacle_nodes], config.tracker)
    return [*obstacle_nodes, *health, tracker]


def detector_of(config: DetectorConfig) -> Detector | None:
    """Detector of the configured model, None without a model; relative paths start at the repository root."""
    return load_detector(CONFIGS.parent / Path(config.model), config) if config.model else None
