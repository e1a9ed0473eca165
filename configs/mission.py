"""A mission: what to work, with what, and how."""

from typing import Annotated

from pydantic import Field

from configs.strict import Config
from configs.vehicle import Kmh


class Work(Config):
    """How the field is worked."""

    headland_rounds: int = Field(ge=1, le=10)
    swath_direction_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None
    overlap_m: float = Field(ge=0.0, le=2.0)
    work_speed_kmh: Kmh
    turn_speed_kmh: Kmh
    lane_speed_kmh: Kmh
    boundary_margin_m: float = Field(ge=0.0, le=5.0, description="between the swept area and the edge")


class Mission(Config):
    """A mission by the names of its parts in `configs/`; with `bay` it starts docked there and ends so."""

    name: str
    site: str
    machine: str
    implement: str
    work: Work
    bay: str | None = None
