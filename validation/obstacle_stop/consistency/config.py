"""Limits of the checks, key `consistency` of the conditions; the reasons stand in the file."""

from typing import Annotated

from pydantic import Field

from configs.strict import Config

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Metres = Annotated[float, Field(gt=0.0, le=100.0)]
Degrees = Annotated[float, Field(gt=0.0, le=45.0)]
Seconds = Annotated[float, Field(gt=0.0, le=100.0)]
Count = Annotated[int, Field(ge=1, le=10000)]


class Sampling(Config):
    """Intervals between the scans that are used, and returns kept per scan."""

    registration_s: Seconds
    ground_s: Seconds
    truth_s: Seconds
    max_points: int = Field(ge=2000, le=200000)


class CoverageLimits(Config):
    """Gaps in scans, odometry and truth."""

    min_scans: Count
    max_gap_s: Seconds
    max_missing_share: Share


class MotionLimits(Config):
    """Odometry against the scans and other sources."""

    min_driven_m: Metres
    block_s: Seconds
    speed_mps: float = Field(gt=0.0, le=10.0)
    speed_share: Share
    turn_degps: Degrees
    min_blocks: Count
    min_block_share: Share
    min_gain: Share


class MountLimits(Config):
    """Mounts against the ground plane and the direction of travel."""

    tilt_deg: Degrees
    height_m: Metres
    yaw_deg: Degrees
    position_m: Metres
    axle_m: Metres
    sigmas: float = Field(ge=2.0, le=10.0)
    max_lateral_mps2: float = Field(gt=0.0, le=10.0)
    max_share_below: Share


class RingLimits(Config):
    """Returns against the configured rings."""

    elevation_deg: Degrees
    elevation_share: Share
    max_share_outside: Share
    max_missing_share: Share
    min_density: Share
    min_share_on_rings: Share


class TimeLimits(Config):
    """Times of the scans against those of the odometry."""

    max_lag_s: Seconds
    search_s: Seconds
    sigmas: float = Field(ge=2.0, le=20.0)
    min_ratio: float = Field(ge=1.0, le=10.0)


class TruthLimits(Config):
    """Search of shifts of the truth in place and time."""

    search_m: Metres
    step_m: Metres
    search_s: Seconds
    step_s: Seconds
    min_score: Share
    min_gain: Share
    min_share: Share
    max_by_chance: Share
    min_returns: Count


class ConsistencyConditions(Config):
    """Limits of all checks."""

    sampling: Sampling
    coverage: CoverageLimits
    motion: MotionLimits
    mount: MountLimits
    rings: RingLimits
    time: TimeLimits
    truth: TruthLimits
