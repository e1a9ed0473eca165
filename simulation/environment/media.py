"""What beams pass on their way in a scenario's environment: plants, fog, rain, dust."""

import math

import numpy as np

from configs.site import Site
from configs.vehicle import Vehicle
from geometry.arrays import Float32, Float64
from simulation.environment.air import (
    APERTURE_M,
    LIDAR_RATIO_SR,
    OVERLAP_M,
    PULSE_M,
    SMALLEST_DROP_M,
    draw_air,
)
from simulation.environment.canopy import Canopy
from simulation.environment.dust import LIDAR_RATIO_SR as DUST_RATIO_SR
from simulation.environment.dust import DustClouds
from simulation.environment.terrain import Terrain
from simulation.machine.machine import Machine
from simulation.randomness import generator
from simulation.scenario_environment import Environment
from simulation.scenario_values import draw


class Media:
    """Drawn once per run; `update` moves the dust."""

    def __init__(self, environment: Environment, site: Site, vehicle: Vehicle, terrain: Terrain, seed: int) -> None:
        values = draw(environment, generator(seed, "environment"))
        self.divergence_rad = 1e-3 * values["beam_divergence_mrad"]
        stands = environment.vegetation
        self.canopy = Canopy(site, terrain, stands, seed) if stands else None
        self.air = draw_air(environment, seed)
        heading = math.radians(values["wind_heading_deg"])
        wind = values["wind_mps"] * np.array([math.cos(heading), math.sin(heading), 0.0])
        dust = {} if environment.dust is None else draw(environment.dust, generator(seed, "environment/dust"))
        self.dust_ray_share = dust.get("ray_share")
        self._clouds = None
        if "visibility_m" in dust:
            self._clouds = DustClouds(dust["visibility_m"], wind, vehicle.drivetrain.track_m)
        self._elapsed_s = 0.0

    def update(self, elapsed_s: float, machine: Machine) -> None:
        """Emits dust until now."""
        self._elapsed_s = elapsed_s
        if self._clouds is not None:
            self._clouds.update(elapsed_s, machine)

    @property
    def has_clouds(self) -> bool:
        """Whether the machine stirs up dust."""
        return self._clouds is not None

    @property
    def has_returns(self) -> bool:
        """Whether anything but surfaces returns or weakens a beam."""
        return self.has_clouds or self.air.extinction_per_m > 0.0

    def puffs(self) -> Float64:
        """Dust now, as in `DustClouds.puffs`."""
        return np.zeros((0, 5)) if self._clouds is None else self._clouds.puffs(self._elapsed_s)

    def packed_air(self) -> Float64:
        """Parameters of `simulation.sensors.beams.strongest_returns`."""
        air = self.air
        return np.array([
            air.extinction_per_m, PULSE_M, air.fog_reflectivity, *OVERLAP_M, air.drops_per_m3, air.drop_scale_m,
            SMALLEST_DROP_M, APERTURE_M, self.divergence_rad, LIDAR_RATIO_SR, DUST_RATIO_SR,
        ])  # fmt: skip

    def radar_loss_db(self, rays: Float32, range_m: Float64) -> Float64:
        """Two-way loss of a radar wave to targets at `range_m` (N,) along `rays` (N, 6) by plants and rain.

        Leaves are larger than the wave (4 mm): geometric extinction as for light (assumed; pessimistic for dry straw).
        """
        loss = 2.0 * self.air.radar_db_per_m * range_m
        if self.canopy is None or len(rays) == 0:
            return loss
        depth = self.canopy.optical_depth(rays, range_m.astype(np.float32))
        return np.asarray(loss + 2.0 * 10.0 / math.log(10.0) * depth)
