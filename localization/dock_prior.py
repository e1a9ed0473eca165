"""Dock prior: surveyed start pose in the shed without GNSS, and the area where the roof obstructs the sky."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from pydantic import Field

from configs.site import PoseConfig, Shed
from configs.strict import Config
from geometry.arrays import Float64
from geometry.transforms import transform
from localization.dead_reckoning.initial_alignment import TiltEstimate
from messages.motion import LidarLocalization


class DockPriorConfig(Config):
    """Section `dock_prior` of map alignment."""

    sigma_m: float = Field(gt=0.0, le=2.0, description="of the parked machine about the surveyed pose")
    heading_sigma_deg: float = Field(gt=0.0, le=20.0)
    height_sigma_m: float = Field(gt=0.0, le=1.0)
    found_sigma_m: float = Field(gt=0.0, le=1.0, description="of a pose that the lidars find: survey and mounts")
    found_sigma_deg: float = Field(gt=0.0, le=10.0)
    roof_margin_m: float = Field(ge=0.0, le=30.0, description="about the roof, where it obstructs the sky")
    uwb_margin_m: float = Field(ge=0.0, le=200.0, description="about the roof, where ranges always enter the graph")


@dataclass(frozen=True)
class DockPrior:
    """Surveyed start pose in `map` and distance to the roof of the shed."""

    start: PoseConfig | None
    shed: Shed | None
    config: DockPriorConfig

    def pose(self, tilt: TiltEstimate) -> Float64:
        """`T_map_base` at the surveyed pose with measured roll and pitch."""
        assert self.start is not None, "called with a surveyed pose"
        s = self.start
        return transform((s.x_m, s.y_m, 0.0), (tilt.roll_rad, tilt.pitch_rad, math.radians(s.heading_deg)))

    def sigmas(self, tilt_sigma_rad: float) -> Float64:
        """Sigmas (6,) of that pose: rotation then translation."""
        c = self.config
        heading = math.radians(c.heading_sigma_deg)
        return np.array([tilt_sigma_rad, tilt_sigma_rad, heading, c.sigma_m, c.sigma_m, c.height_sigma_m])

    def sigmas_of(self, found: LidarLocalization, tilt_sigma_rad: float) -> Float64:
        """Sigmas (6,) of a pose that the lidars found in the shed."""
        c, own = self.config, np.sqrt(np.diag(found.covariance))
        heading = math.hypot(own[2], math.radians(c.found_sigma_deg))
        x_m, y_m = np.hypot(own[3:5], c.found_sigma_m).tolist()
        return np.array([tilt_sigma_rad, tilt_sigma_rad, heading, x_m, y_m, c.height_sigma_m])

    def has_sky_obstruction(self, p_map_m: Float64) -> bool:
        """Whether a position is under the roof or within its margin (blocked sky, multipath)."""
        return self._roof_m(p_map_m) <= self.config.roof_margin_m

    def is_near_shed(self, p_map_m: Float64) -> bool:
        """Whether a position is so near to the shed that range calibration must start before fixes end."""
        return self._roof_m(p_map_m) <= self.config.uwb_margin_m

    @cached_property
    def _roof(self) -> shapely.Polygon:
        roof = shapely.Polygon() if self.shed is None else shapely.Polygon(self.shed.outline_m)
        shapely.prepare(roof)
        return roof

    def _roof_m(self, p_map_m: Float64) -> float:
        """Distance to the roof, infinite without one."""
        return math.inf if self.shed is None else float(shapely.distance(self._roof, shapely.Point(p_map_m[:2])))
