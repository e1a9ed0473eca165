"""Where the machine may start without any fix, at a surveyed pose in the shed; and where fixes suffer from its roof."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from pydantic import Field

from configs.site import PoseConfig, Shed
from configs.strict import Config
from geometry.transforms import Float64, transform
from localization.dead_reckoning.initial_alignment import Level


class DockedConfig(Config):
    """What the surveyed pose is worth, and how far a roof spoils the sky."""

    sigma_m: float = Field(gt=0.0, le=2.0, description="how exactly the machine was put there")
    heading_sigma_deg: float = Field(gt=0.0, le=20.0)
    height_sigma_m: float = Field(gt=0.0, le=1.0)
    roof_margin_m: float = Field(ge=0.0, le=30.0, description="about the roof, where fixes suffer from it")
    ranging_margin_m: float = Field(ge=0.0, le=200.0, description="about the roof, where ranges enter the graph always")


@dataclass(frozen=True)
class Docked:
    """The pose that the machine was left at, in `map`, and how far the roof is from any place."""

    start: PoseConfig | None
    shed: Shed | None
    config: DockedConfig

    def pose_of(self, level: Level) -> Float64:
        """`T_map_base` at the surveyed pose with the roll and pitch measured."""
        assert self.start is not None, "asked only where there is one"
        s = self.start
        return transform((s.x_m, s.y_m, 0.0), (level.roll_rad, level.pitch_rad, math.radians(s.heading_deg)))

    def sigmas(self, tilt_sigma_rad: float) -> Float64:
        """Of that pose, (6,): rotation then translation."""
        c = self.config
        heading = math.radians(c.heading_sigma_deg)
        return np.array([tilt_sigma_rad, tilt_sigma_rad, heading, c.sigma_m, c.sigma_m, c.height_sigma_m])

    def is_shaded(self, p_map_m: Float64) -> bool:
        """Whether a place is under the roof or so near that it hides much of the sky or mirrors it."""
        return self._roof_m(p_map_m) <= self.config.roof_margin_m

    def is_near(self, p_map_m: Float64) -> bool:
        """Whether a place is so near to the shed that ranges must have been learnt to know before fixes end."""
        return self._roof_m(p_map_m) <= self.config.ranging_margin_m

    @cached_property
    def _roof(self) -> shapely.Polygon:
        roof = shapely.Polygon() if self.shed is None else shapely.Polygon(self.shed.outline_m)
        shapely.prepare(roof)
        return roof

    def _roof_m(self, p_map_m: Float64) -> float:
        """How far the roof is, infinite where there is none."""
        return math.inf if self.shed is None else float(shapely.distance(self._roof, shapely.Point(p_map_m[:2])))
