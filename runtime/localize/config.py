"""Configuration of `headland localize`."""

from pydantic import Field

from configs.strict import Config
from localization.config import LocalizationConfig


class LocalizeConfig(Config):
    """File `configs/localize.yaml`."""

    max_imu_gap_s: float = Field(gt=0.0, le=1.0)
    max_wheel_gap_s: float = Field(gt=0.0, le=1.0)
    max_speed_mps: float = Field(gt=0.0, le=50.0)
    max_sample_age_s: float = Field(gt=0.0, le=5.0)
    gnss_timeout_s: float = Field(gt=0.0, le=10.0)
    max_standstill_rate_radps: float = Field(gt=0.0, le=1.0)
    realign_moving_s: float = Field(gt=0.0, le=3600.0)
    least_placed_share: float = Field(gt=0.0, le=1.0)

    def of(self, stack: LocalizationConfig) -> LocalizationConfig:
        """The stack's localization with the values for recordings."""
        values = stack.model_dump()
        values["max_sample_age_s"], values["gnss_timeout_s"] = self.max_sample_age_s, self.gnss_timeout_s
        values["odometry"]["imu"]["max_gap_s"] = self.max_imu_gap_s
        values["odometry"]["wheels"] |= {"max_gap_s": self.max_wheel_gap_s, "max_speed_mps": self.max_speed_mps}
        values["map_alignment"]["realign_moving_s"] = self.realign_moving_s
        values["map_alignment"]["initial_alignment"]["max_rate_radps"] = self.max_standstill_rate_radps
        return LocalizationConfig.model_validate(values)
