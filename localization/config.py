"""Configuration of the localizer."""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64
from localization.dead_reckoning.dead_reckoning import DeadReckoningConfig
from localization.dead_reckoning.imu_track import ImuTrackConfig
from localization.dead_reckoning.initial_alignment import InitialAlignmentConfig
from localization.dead_reckoning.plausibility import PlausibilityConfig
from localization.dead_reckoning.steering_offset import SteeringOffsetConfig
from localization.dead_reckoning.wheel_track import WheelConfig
from localization.dock_prior import DockPriorConfig
from localization.gnss_gate import GnssConfig
from localization.gnss_monitor import GnssMonitorConfig
from localization.graph.motion_start import MotionStartConfig
from localization.graph.smoother import SmootherConfig
from localization.integrity import IntegrityConfig
from localization.lidar.lidar_odometry import LidarOdometryConfig
from localization.lidar.map_localization import LidarMapConfig
from localization.lidar.odometry_spans import OdometrySpansConfig
from localization.lidar.pose_measurement import PoseMeasurementConfig
from localization.uwb.range_gate import RangeGateConfig


class OdometryConfig(Config):
    """Section `odometry` of localization."""

    imu: ImuTrackConfig
    wheels: WheelConfig
    dead_reckoning: DeadReckoningConfig
    steering_offset: SteeringOffsetConfig
    plausibility: PlausibilityConfig
    history_s: float = Field(gt=1.0, le=60.0)
    acceleration_time_s: float = Field(gt=0.0, le=5.0, description="smoothing of the forward acceleration")


class MapAlignmentConfig(Config):
    """Section `map_alignment` of localization."""

    gnss: GnssConfig
    gnss_monitor: GnssMonitorConfig
    smoother: SmootherConfig
    initial_alignment: InitialAlignmentConfig
    motion_start: MotionStartConfig
    odometry_spans: OdometrySpansConfig
    pose_measurement: PoseMeasurementConfig
    range_gate: RangeGateConfig
    dock_prior: DockPriorConfig
    integrity: IntegrityConfig
    resume_turn_radps: float = Field(gt=0.0, le=2.0, description="assumed turn rate during a gap")
    resume_speed_ratio: float = Field(gt=0.0, le=2.0, description="assumed error of the speed during a gap")
    max_bridge_s: float = Field(gt=0.0, le=10.0, description="a longer gap while driving loses the position")
    reset_sigma_m: float = Field(gt=0.0, le=10.0, description="added when a failed graph is reset")
    reset_sigma_deg: float = Field(gt=0.0, le=20.0)
    realign_moving_s: float = Field(gt=0.0, le=3600.0, description="the same in motion, where the start must be proven")
    realign_s: float = Field(gt=0.0, le=600.0, description="fixes rejected at standstill for longer: restart")

    @property
    def reset_sigmas(self) -> Float64:
        """Sigmas (6,) added to the pose at a reset: rotation then translation."""
        return np.repeat([math.radians(self.reset_sigma_deg), self.reset_sigma_m], 3)


class LocalizationConfig(Config):
    """Section `localization` of the stack configuration."""

    period_s: float = Field(ge=0.005, le=0.1)
    pose_period_s: float = Field(ge=0.02, le=1.0)
    max_sample_age_s: float = Field(gt=0.0, le=5.0, description="older samples are dropped on arrival")
    max_sample_lead_s: float = Field(ge=0.0, le=1.0, description="samples stamped farther ahead are dropped")
    gnss_timeout_s: float = Field(gt=0.0, le=10.0)
    odometry: OdometryConfig
    map_alignment: MapAlignmentConfig
    lidar_odometry: LidarOdometryConfig
    lidar_map: LidarMapConfig
