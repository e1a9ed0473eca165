"""Section `perception` of the stack configuration."""

from configs.strict import Config
from perception.camera.obstacles import CameraConfig
from perception.fusion.tracks import TrackerConfig
from perception.lidar.obstacles import LidarConfig
from perception.radar.obstacles import RadarConfig
from perception.ultrasonic.obstacles import UltrasonicConfig


class PerceptionConfig(Config):
    """Configuration of perception; the sensors themselves are part of the machine."""

    lidar: LidarConfig
    tracker: TrackerConfig
    camera: CameraConfig
    radar: RadarConfig
    ultrasonic: UltrasonicConfig
