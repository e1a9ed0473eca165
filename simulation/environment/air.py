"""Fog and rain: extinction and false returns of a lidar beam.

Visibility V is the meteorological optical range, where contrast falls to 5 % (WMO; ICAO): extinction alpha = ln 20 /
V = 2.996 / V (Koschmieder 1924 with 5 % instead of 2 %, which gives 3.912 / V). Fog droplets are larger than the
wavelength: alpha at 905 nm is that of visible light (Kim et al. 2001, for V below 500 m).

Fog returns, from the lidar equation for a soft target (Rasshofer et al. 2011; Hahner et al. 2021, "Fog simulation on
real lidar point clouds"): backscatter beta = 0.046 / V per m and sr, power ~ beta c tau / 2 × overlap(r) exp(-2 alpha
r) / r². A hard target of reflectivity rho has rho / pi × exp(-2 alpha r) / r², so that fog equals a target of
reflectivity pi beta c tau / 2. Each beam gets one return, at a range drawn in proportion to the power, whose strength
is exponentially distributed (patches; assumed). The overlap of transmitter and receiver rises from 1 m to 10 m
(assumed: a receiver focused at far range).

Rain: rate R (mm/h) by alpha = 0.01 R^0.6 per m (Goodin et al. 2019, "Predicting the influence of rain on lidar in
ADAS"). Drops larger than 0.5 mm: Marshall and Palmer (1948), N(D) = 8000 exp(-4.1 R^-0.21 D) per m³ and mm. The first
drop in the beam returns the share that it covers; a sphere's backscatter is its cross-section over 19 sr (O'Connor et
al. 2004). The range error of Goodin et al. is not modelled. Radar: attenuation of rain 0.94 R^0.77 dB/km (ITU-R
P.838, 80 GHz); fog and dust have none.
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32
from simulation.randomness import generator
from simulation.scenario_environment import Environment
from simulation.scenario_values import draw

PULSE_M = 0.75  # c/2 × 5 ns: returns closer than this are one
OVERLAP_M = (1.0, 10.0)
FOG_BACKSCATTER = 0.046  # per sr, times 1 / V
SMALLEST_DROP_M, LIDAR_RATIO_SR, APERTURE_M = 0.5e-3, 19.0, 0.012
STEPS, FAR_M = 512, 60.0


@dataclass(frozen=True)
class Air:
    """Extinction (1/m), and parameters of the returns of fog and rain in the order of `simulation.sensors.beams`.

    `fog_ranges_m`: quantiles of the range of a fog return, without fog empty.
    """

    extinction_per_m: float
    fog_reflectivity: float
    drops_per_m3: float
    drop_scale_m: float
    rain_mmph: float
    fog_ranges_m: Float32

    @property
    def radar_db_per_m(self) -> float:
        """Attenuation of a radar wave, one way."""
        return 0.94e-3 * self.rain_mmph**0.77 if self.rain_mmph > 0.0 else 0.0


def draw_air(environment: Environment, seed: int) -> Air:
    """Air of one run."""
    fog_per_m = 0.0 if environment.fog is None else extinction_per_m(
        draw(environment.fog, generator(seed, "environment/fog"))["visibility_m"])  # fmt: skip
    rain_per_m = 0.0 if environment.rain is None else extinction_per_m(
        draw(environment.rain, generator(seed, "environment/rain"))["visibility_m"])  # fmt: skip
    rate = (rain_per_m / 0.01) ** (1.0 / 0.6)
    scale_m = 1e-3 / (4.1 * rate**-0.21) if rate > 0.0 else 0.0
    drops = 8e6 * scale_m * math.exp(-SMALLEST_DROP_M / scale_m) if rate > 0.0 else 0.0
    # beta = 0.046 / V = 0.046 alpha / ln 20
    fog = math.pi * FOG_BACKSCATTER * fog_per_m / math.log(20.0) * PULSE_M
    alpha = fog_per_m + rain_per_m
    ranges = fog_ranges_m(alpha) if fog > 0.0 else np.zeros(0, np.float32)
    return Air(alpha, fog, drops, scale_m, rate, ranges)


def extinction_per_m(visibility_m: float) -> float:
    """Extinction of air of a meteorological optical range."""
    return math.log(20.0) / visibility_m


def fog_ranges_m(alpha_per_m: float) -> Float32:
    """Quantiles (STEPS + 1,) of the range of a fog return: density ~ overlap exp(-2 alpha r) / r²."""
    r = np.linspace(OVERLAP_M[0], FAR_M, 20 * STEPS)
    overlap = np.clip((r - OVERLAP_M[0]) / (OVERLAP_M[1] - OVERLAP_M[0]), 0.0, 1.0)
    share = np.cumsum(overlap * np.exp(-2.0 * alpha_per_m * r) / r**2)
    return np.interp(np.linspace(0.0, 1.0, STEPS + 1), share / share[-1], r).astype(np.float32)
