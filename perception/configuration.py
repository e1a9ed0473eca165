"""The section `perception` of the stack's configuration."""

from configs.strict import Config
from perception.fusion.tracks import TrackerConfig
from perception.lidar.obstacles import LidarConfig


class PerceptionConfig(Config):
    """All that perception is told, apart from the sensors themselves."""

    lidar: LidarConfig
    tracker: TrackerConfig
