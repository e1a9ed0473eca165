"""Sun and sky: drawn once per run, from low sun to overcast."""

import math
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64

FOG_LENGTHS = math.sqrt(39.0) - 1.0  # x at which 1 + x + x²/2 = 20
SILHOUETTE = 2048  # columns of the skyline, 360 degrees


class SkyConfig(Config):
    """Ranges from which the light of a run is drawn."""

    sun_elevation_deg: tuple[float, float] = Field(description="lowest and highest elevation of the sun")
    overcast: tuple[float, float] = Field(description="share of sunlight that clouds scatter")
    haze_length_m: tuple[float, float] = Field(description="distance over which haze takes 63 % of the contrast")
    skyline_elevation_deg: tuple[float, float] = Field(description="elevation of distant woods and hills")


@dataclass(frozen=True)
class Light:
    """Light of all images of a run; colours are linear RGB.

    `sun_direction` unit (3,) in `map`; `sun`, `sky` (ambient from above), `zenith`, `horizon` (3,); `skyline`
    (SILHOUETTE,): tangent of its elevation, by azimuth from -pi; `cloud_offset` (2,) into the cloud texture.
    """

    sun_direction: Float64
    sun: Float64
    sky: Float64
    zenith: Float64
    horizon: Float64
    overcast: float
    haze_length_m: float
    cloud_offset: Float64
    skyline: Float64

    def packed(self) -> Float64:
        """All numbers but the skyline in the order of the shading kernel, (19,)."""
        parts = [self.sun_direction, self.sun, self.sky, self.zenith, self.horizon, [self.overcast, self.haze_length_m],
                 self.cloud_offset]  # fmt: skip
        return np.concatenate([np.asarray(p, np.float64) for p in parts])


def draw_light(config: SkyConfig, random: np.random.Generator) -> Light:
    """The light of one run."""
    azimuth, elevation = random.uniform(-math.pi, math.pi), math.radians(random.uniform(*config.sun_elevation_deg))
    overcast, haze = random.uniform(*config.overcast), random.uniform(*config.haze_length_m)
    sun_direction = np.array([math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth),
                       math.sin(elevation)])  # fmt: skip
    # air mass: a low sun passes more air, which absorbs blue most
    air = 1.0 / max(math.sin(elevation), 0.1)
    direct = np.exp(-np.array([0.10, 0.16, 0.30]) * air) * 3.2
    grey = np.array([0.62, 0.64, 0.68])
    blue = np.array([0.30, 0.48, 0.85])
    power = 0.35 + 0.65 * math.sin(elevation)
    zenith = (1.0 - overcast) * blue * (0.5 + 0.5 * power) + overcast * grey * power
    horizon = (1.0 - overcast) * np.array([0.75, 0.86, 1.0]) * (0.5 + 0.5 * power) + overcast * 1.1 * grey * power
    sky = 0.75 * zenith + 0.25 * horizon + overcast * 0.35 * power
    skyline = draw_skyline(config, random)
    sun = direct * (1.0 - overcast)
    cloud_offset = random.uniform(0.0, 512.0, 2)
    return Light(sun_direction, sun, sky, zenith, horizon, overcast, haze, cloud_offset, skyline)


def in_fog(light: Light, visibility_m: float) -> Light:
    """The light in fog or rain of a visibility (5 % contrast, Koschmieder): no sun, and no sky but the veil.

    The shading kernel's transmission 1 / (1 + x + x²/2), x = range over haze length, is 5 % at x = 5.245.
    """
    everywhere = np.full(SILHOUETTE, 1e6)  # woods up to the zenith, behind fog
    return replace(light, sun=np.zeros(3), sky=light.sky + 0.3 * light.sun, haze_length_m=visibility_m / FOG_LENGTHS,
                   skyline=everywhere)  # fmt: skip


def draw_skyline(config: SkyConfig, random: np.random.Generator) -> Float64:
    """Tangent of the skyline's elevation (SILHOUETTE,): woods with crowns and gaps on low hills."""
    low, high = (math.tan(math.radians(d)) for d in config.skyline_elevation_deg)
    azimuth = np.linspace(0.0, 2.0 * math.pi, SILHOUETTE, endpoint=False)
    hills, woods, crowns = np.zeros(SILHOUETTE), np.zeros(SILHOUETTE), np.zeros(SILHOUETTE)
    for k in range(1, 6):
        hills += np.sin(k * azimuth + random.uniform(0.0, 2.0 * math.pi)) / k
    for k in range(5, 30):
        woods += np.sin(k * azimuth + random.uniform(0.0, 2.0 * math.pi)) / math.sqrt(k)
    for k in range(80, 420, 3):
        crowns += np.sin(k * azimuth + random.uniform(0.0, 2.0 * math.pi)) / math.sqrt(k)
    span = high - low
    wood = 0.25 + 0.75 * np.clip(1.5 * woods, 0.0, 1.0)
    height = low + 0.3 * span * np.clip(0.5 + 0.3 * hills, 0.0, 1.0) + 0.45 * span * wood * (1.0 + 0.10 * crowns)
    return np.asarray(np.maximum(height, 0.0), np.float64)
