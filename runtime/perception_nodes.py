"""The perceiving nodes for every sensor that a vehicle lists."""

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


def perceiving(vehicle: Vehicle, implement: Implement | None, config: PerceptionConfig) -> list[Node]:
    """Obstacles and health of each sensor, and the tracker over all obstacles; raises ConfigError for a bad model.

    A camera without a model has its health alone, which says so.
    """
    sensors = vehicle.sensors
    detector = detector_of(config.camera.detector) if sensors.camera else None
    eyes: list[Node] = [
        *(LidarObstacles(name, one, vehicle, implement, config.lidar) for name, one in sensors.lidar.items()),
        *(RadarObstacles(name, one, vehicle, implement, config.radar) for name, one in sensors.radar.items()),
        *(
            UltrasonicObstacles(name, one, vehicle, implement, config.ultrasonic)
            for name, one in sensors.ultrasonic.items()
        ),
    ]
    if detector is not None:
        eyes += [
            CameraObstacles(name, one, vehicle, implement, detector, config.camera)
            for name, one in sensors.camera.items()
        ]
    health: list[Node] = [
        *(RadarHealth(name, one, config.radar) for name, one in sensors.radar.items()),
        *(UltrasonicHealth(name, one, config.ultrasonic) for name, one in sensors.ultrasonic.items()),
        *(CameraHealth(name, one, detector is not None, config.camera) for name, one in sensors.camera.items()),
    ]
    return [*eyes, *health, Tracker([f"obstacles/{eye.name}" for eye in eyes], config.tracker)]


def detector_of(config: DetectorConfig) -> Detector | None:
    """The detector that the configuration names, or None; a relative path counts from the repository's root."""
    return load_detector(CONFIGS.parent / Path(config.model), config) if config.model else None
