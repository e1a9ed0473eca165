"""What the planner may ask of machine and ground."""

from typing import Annotated

from pydantic import Field

from configs.strict import Config
from configs.vehicle import Kmh

Metres = Annotated[float, Field(gt=0.0, le=50.0)]


class PlannerConfig(Config):
    """Limits of a plan; section `planner` of `configs/stack.yaml`."""

    curvature_share: float = Field(gt=0.3, le=1.0, description="of the machine's tightest curvature that a plan uses")
    steering_rate_share: float = Field(gt=0.05, le=1.0, description="of the actuator's rate that a plan uses")
    lateral_acceleration_mps2: float = Field(gt=0.1, le=5.0)
    deceleration_mps2: float = Field(gt=0.1, le=3.0, description="planned slowing; the brakes can do more")
    smoothing_m: float = Field(ge=0.3, le=6.0, description="window of the smoothing that makes curvature continuous")
    run_out_m: float = Field(ge=0.0, le=20.0, description="straight way after the implement has left the line")
    line_up_m: float = Field(ge=0.5, le=20.0, description="straight way before the implement reaches the line")
    least_swath_m: Metres
    edge_slack_m: float = Field(ge=0.0, le=0.5, description="more than the margin for the first round, for tail swing")
    sampling_iterations: int = Field(ge=100, le=1_000_000, description="of OMPL for one way, a count and never a time")


class MissionConfig(Config):
    """What the mission node does when something stays in the way."""

    blocked_s: float = Field(
        gt=0.0, le=600.0, description="stop before something that stands, until it is driven round"
    )
    blocked_alive_s: float = Field(gt=0.0, le=600.0, description="the same before a person or animal")
    standing_mps: float = Field(gt=0.0, le=1.0)
    clearance_m: Metres = Field(description="beside what is driven round; more than the supervisor's lateral margin")
    rear_clearance_m: Metres = Field(description="behind the implement when backing up to where work goes on")
    unseen_depth_m: float = Field(ge=0.0, le=20.0, description="least depth of what is seen from one side")
    join_m: Metres = Field(description="standing things nearer to each other than this are one")
    look_m: Metres = Field(description="how far ahead on the path the cause of a stop is looked for")
    most_reverse_m: Metres
    reverse_kmh: Kmh
    most_detours: int = Field(ge=0, le=100)
    least_rest_m: float = Field(ge=0.0, le=100.0, description="a shorter rest of a line is not worth going back to")


class PlanningConfig(Config):
    """Section `planning` of `configs/stack.yaml`."""

    planner: PlannerConfig
    mission: MissionConfig
