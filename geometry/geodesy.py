"""Conversion between the ellipsoid and the `map` frame (east-north-up at a datum)."""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from pyproj import Transformer

from geometry.arrays import Float64


@cache
def _from_earth() -> Transformer:
    return Transformer.from_pipeline("+proj=pipeline +step +inv +proj=cart +ellps=WGS84")


@dataclass(frozen=True)
class Datum:
    """Origin of `map` on WGS 84, with ellipsoid height."""

    latitude_rad: float
    longitude_rad: float
    height_m: float

    @cached_property
    def _transformer(self) -> Transformer:
        pipeline = (
            "+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
            f"+lon_0={self.longitude_rad!r}r +lat_0={self.latitude_rad!r}r +h_0={self.height_m!r}"
        )
        return Transformer.from_pipeline(pipeline)

    def to_map(self, latitude_rad: float, longitude_rad: float, height_m: float) -> tuple[float, float, float]:
        """East, north and up of a point on the ellipsoid."""
        e, n, u = self._transformer.transform(longitude_rad, latitude_rad, height_m, radians=True)
        return float(e), float(n), float(u)

    def points_to_map(self, longitude_latitude_deg: Float64) -> Float64:
        """East and north (N, 2) of points (N, 2) in degrees on the ellipsoid at height 0."""
        longitude, latitude = longitude_latitude_deg.T
        e, n, _ = self._transformer.transform(longitude, latitude, np.zeros(len(longitude)))
        return np.column_stack([e, n])

    def to_ellipsoid(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
        """Latitude, longitude (radians) and height of a point in `map`."""
        lon, lat, h = self._transformer.transform(x_m, y_m, z_m, radians=True, direction="INVERSE")
        return float(lat), float(lon), float(h)


def ellipsoidal(x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
    """Latitude, longitude (radians) and height of an earth-fixed position."""
    lon, lat, h = _from_earth().transform(x_m, y_m, z_m, radians=True)
    return float(lat), float(lon), float(h)
