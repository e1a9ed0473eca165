"""Coordinates of a file as longitude and latitude on WGS 84; another system is transformed where the file names it."""

import math
import re
from functools import cached_property
from typing import Any

from planning.field.formats.contents import LonLat, Ring

WGS_84 = re.compile(r"(?:urn:ogc:def:crs:)?(?:EPSG:[\d.]*:?4326|OGC:[\d.]*:?CRS84|CRS84|WGS ?84)", re.IGNORECASE)
MAX_ERROR_M, NOTED_ERROR_M = 5.0, 1.0
DEGREES_PROBABLE = 1000.0
REMEDY = "export the field as WGS 84 (EPSG:4326)"


class CoordinateError(ValueError):
    """A point or coordinate system that cannot be used, with the reason."""


class CoordinateSystem:
    """Conversion to degrees on WGS 84 from an authority code, a URN or WKT; None is WGS 84.

    `order` are the words for the order of the coordinates in the file. Methods raise CoordinateError.
    """

    def __init__(self, crs: str | None, order: str = "[longitude, latitude]") -> None:
        self.crs = None if crs is not None and WGS_84.fullmatch(crs.strip()) else crs
        self.order = order
        self._error_m = 0.0

    @property
    def notes(self) -> tuple[str, ...]:
        """Note on the accuracy of the transformation, where it is worse than 1 m."""
        is_noted = self._error_m > NOTED_ERROR_M
        return (f"{self._known.name} is transformed within {self._error_m:g} m",) if is_noted else ()

    def check(self) -> None:
        """Checks that the system is known and can be transformed."""
        if self.crs is not None:
            _ = self._transformer

    def to_degrees(self, points: Ring) -> Ring:
        """Points as longitude and latitude."""
        if (wrong := _not_finite(points)) is not None:
            x, y = points[wrong]
            raise CoordinateError(f"point {x:g}, {y:g} is not a finite number; correct or remove it")
        if self.crs is not None and points:
            before = points
            x, y = self._transformer.transform([p[0] for p in points], [p[1] for p in points])
            points = list(zip(map(float, x), map(float, y), strict=True))
            if (wrong := _not_finite(points)) is not None:
                outside = f"{before[wrong][0]:g}, {before[wrong][1]:g}"
                raise CoordinateError(f"{outside} is outside the area of {self._known.name!r}")
            self._check_accuracy()
        for point in points:
            if not (-180.0 <= point[0] <= 180.0 and -90.0 <= point[1] <= 90.0):
                raise CoordinateError(_beyond(point, self.order))
        return points

    @cached_property
    def _known(self) -> Any:
        # only now: the import takes 0.2 s
        import pyproj
        from pyproj.exceptions import CRSError

        try:
            return pyproj.CRS.from_user_input(self.crs)
        except CRSError as error:
            raise CoordinateError(f"unknown coordinate system {_short(str(self.crs))}; {REMEDY}") from error

    @cached_property
    def _transformer(self) -> Any:
        import pyproj
        from pyproj.exceptions import ProjError

        try:
            return pyproj.Transformer.from_crs(self._known, "EPSG:4326", always_xy=True)
        except ProjError as error:
            raise CoordinateError(f"no transformation from {self._known.name!r}; {REMEDY}") from error

    def _check_accuracy(self) -> None:
        from pyproj.exceptions import ProjError

        try:
            accuracy_m = float(self._transformer.get_last_used_operation().accuracy)
        except ProjError:  # a transformation without alternatives
            accuracy_m = float(self._transformer.accuracy)
        if not 0.0 <= accuracy_m <= MAX_ERROR_M:
            error_m = f"within {accuracy_m:g} m only" if accuracy_m > 0.0 else "with unknown accuracy only"
            raise CoordinateError(f"{self._known.name!r} can be transformed {error_m}; {REMEDY}")
        self._error_m = max(self._error_m, accuracy_m)


def _not_finite(points: Ring) -> int | None:
    """Index of the first point that is not finite."""
    found = (k for k, (x, y) in enumerate(points) if not (math.isfinite(x) and math.isfinite(y)))
    return next(found, None)


def _beyond(point: LonLat, order: str) -> str:
    """Reason why a point is not in degrees."""
    longitude, latitude = point
    if max(abs(longitude), abs(latitude)) > DEGREES_PROBABLE:
        return (
            f"{longitude:.10g}, {latitude:.10g} are no degrees but metres of a projected system such as UTM, which the "
            f"file does not name; {REMEDY}"
        )
    if abs(latitude) > 90.0:
        return f"latitude {latitude:g} is beyond ±90°; points are {order}, in this order"
    return f"longitude {longitude:g} is beyond ±180°; points are {order} in degrees"


def closed(ring: Ring) -> Ring:
    """Ring with its first point repeated at the end."""
    return ring if not ring or ring[0] == ring[-1] else [*ring, ring[0]]


def _short(text: str) -> str:
    plain = " ".join(text.split())
    return repr(plain if len(plain) <= 60 else plain[:57] + "...")
