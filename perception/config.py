"""The section `perception` of the stack's configuration."""

from configs.strict import Config
from perception.camera.obstacles import CameraConfig
from perception.fusion.tracks import TrackerConfig
from perception.lidar.obstacles import LidarConfig
from perception.radar.obstacles import RadarConfig
from perception.ultrasonic.obstacles import UltrasonicConfig


class PerceptionConfig(Config):
    """All that perception is told, apart from the sensors themselves."""

    lidar: LidarConfig
    tracker: TrackerConfig
    camera: CameraConfig
    radar: RadarConfig
    ultrasonic: UltrasonicConfig
