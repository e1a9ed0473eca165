"""Dust clouds behind wheels and implement: Gaussian puffs that the wind carries.

Gaussian puff model (Gifford 1959; Zannetti 1990, "Air pollution modeling"): each source emits a puff per `SPACING_M`
of travel; its centre moves with the wind, its sigma grows as sqrt(s0² + 2 K t), its mass falls by settling. Optical
depth along a line is exact. The lidar ratio of mineral dust is 50 sr (Veselovskii et al. 2020: 45 to 55 sr). A fresh
plume of the implement has the configured visibility at its middle; wheels emit a third of that (assumed), both in
proportion to speed. Diffusivity, settling and source sizes are assumed for loose dry soil.
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from simulation.environment.air import extinction_per_m
from simulation.machine.implement import working_point_m
from simulation.machine.machine import Machine

SPACING_M = 1.5
DIFFUSIVITY_M2PS, SETTLING_S, RISE_MPS = 0.15, 8.0, 0.15
MAX_AGE_S = 12.0
FULL_SPEED_MPS, MIN_SPEED_MPS = 10.0 / 3.6, 0.3
WHEEL_SIGMA_M, IMPLEMENT_SIGMA_M, WHEEL_SHARE = 0.4, 0.8, 1.0 / 3.0
LIDAR_RATIO_SR = 50.0


@dataclass(frozen=True)
class Puff:
    """Emission: time, place in `map` (3,), sigma, and optical depth times area (m²)."""

    at_s: float
    p_map_m: Float64
    sigma_m: float
    area_m2: float


class DustClouds:
    """All puffs in the air."""

    def __init__(self, visibility_m: float, wind_mps: Float64, track_m: float) -> None:
        self._extinction, self._wind, self._track_m = extinction_per_m(visibility_m), wind_mps, track_m
        self._puffs: list[Puff] = []
        self._next_m = 0.0
        self._travelled_m = 0.0
        self._last: tuple[float, Float64] | None = None

    def update(self, elapsed_s: float, machine: Machine) -> None:
        """Emits what the machine has stirred up until now."""
        here = machine.T_map_base[:3, 3].copy()
        if self._last is not None:
            self._travelled_m += float(np.linalg.norm(here - self._last[1]))
        self._last = (elapsed_s, here)
        if self._travelled_m < self._next_m or abs(machine.speed_mps) < MIN_SPEED_MPS:
            return
        self._next_m = self._travelled_m + SPACING_M
        speed_share = abs(machine.speed_mps) / FULL_SPEED_MPS
        self._puffs = [p for p in self._puffs if elapsed_s - p.at_s < MAX_AGE_S]
        left = machine.T_map_base[:3, 1]
        for side in (-0.5, 0.5):
            place = here + side * self._track_m * left
            self._emit(elapsed_s, place, WHEEL_SIGMA_M, WHEEL_SHARE * speed_share)
        if machine.attached.is_working:
            width = machine.attached.current.width_m
            behind = working_point_m(
                machine.attached.implement, (here[0], here[1], machine.yaw_rad), machine.attached.yaw_rad
            )
            count = max(1, round(width / (2.0 * IMPLEMENT_SIGMA_M)))
            for k in range(count):
                aside = width * ((k + 0.5) / count - 0.5)
                place = np.array([*behind, here[2]]) + aside * left
                self._emit(elapsed_s, place, IMPLEMENT_SIGMA_M, speed_share)

    def _emit(self, elapsed_s: float, place: Float64, sigma_m: float, share: float) -> None:
        """A line of puffs at this distance has the extinction area / (2 pi sigma² spacing) at its middle."""
        area = share * self._extinction * 2.0 * math.pi * sigma_m**2 * SPACING_M
        self._puffs.append(Puff(elapsed_s, place + np.array([0.0, 0.0, 0.5 * sigma_m]), sigma_m, area))

    def puffs(self, elapsed_s: float) -> Float64:
        """Puffs now, (N, 5): place in `map`, sigma, optical depth times area."""
        rows = []
        for puff in self._puffs:
            age = elapsed_s - puff.at_s
            if age < MAX_AGE_S:
                x, y, z = puff.p_map_m + age * self._wind + [0.0, 0.0, RISE_MPS * age]
                sigma = math.sqrt(puff.sigma_m**2 + 2.0 * DIFFUSIVITY_M2PS * age)
                rows.append([x, y, z, sigma, puff.area_m2 * math.exp(-age / SETTLING_S)])
        return np.array(rows).reshape(-1, 5)
