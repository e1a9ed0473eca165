"""Site: field, lanes, no-go areas, yard and shed, in `map`."""

import math
from typing import Annotated

from pydantic import Field

from configs.strict import Config
from geometry.geodesy import Datum
from geometry.pose2 import Pose2
from messages.errors import ConfigError

Coordinate = Annotated[float, Field(ge=-20000.0, le=20000.0)]
Point = tuple[Coordinate, Coordinate]
Outline = Annotated[tuple[Point, ...], Field(min_length=3)]


class DatumConfig(Config):
    """Origin of `map` on WGS 84 with ellipsoid height."""

    latitude_deg: float = Field(ge=-90.0, le=90.0)
    longitude_deg: float = Field(ge=-180.0, le=180.0)
    height_m: float = Field(ge=-500.0, le=9000.0)

    @property
    def datum(self) -> Datum:
        """Converter between ellipsoid and `map`."""
        return Datum(math.radians(self.latitude_deg), math.radians(self.longitude_deg), self.height_m)


class PoseConfig(Config):
    """A pose in `map`; heading counter-clockwise from east."""

    x_m: Coordinate
    y_m: Coordinate
    heading_deg: float = Field(ge=-360.0, le=360.0)

    @property
    def pose(self) -> Pose2:
        """The same in radians."""
        return Pose2(self.x_m, self.y_m, math.radians(self.heading_deg))


class Area(Config):
    """Named area with its outline."""

    name: str
    outline_m: Outline


class Lane(Config):
    """Lane, driven along its centre line in both directions."""

    name: str
    center_m: Annotated[tuple[Point, ...], Field(min_length=2)]
    width_m: float = Field(gt=0.0, le=50.0)


class Gate(Config):
    """Opening in the fence between two posts."""

    name: str
    posts_m: tuple[Point, Point]


class Post(Config):
    """Round post of the roof."""

    at_m: Point
    radius_m: float = Field(gt=0.0, le=2.0)


class Bay(Config):
    """Parking bay, free over `width_m`; `dock` is the pose of `base` when docked, heading out of the bay."""

    name: str
    dock: PoseConfig
    width_m: float = Field(gt=0.5, le=20.0)


class Shed(Config):
    """Machine shed: centre lines of the walls, posts, bays, and UWB anchors, in `map`.

    `outline_m` is the roof (no GNSS below it). The floor is level at height 0 of `map`, as is the yard.
    """

    name: str
    outline_m: Outline
    height_m: float = Field(gt=1.0, le=30.0)
    walls_m: tuple[Annotated[tuple[Point, ...], Field(min_length=2)], ...] = ()
    wall_thickness_m: float = Field(default=0.15, gt=0.0, le=2.0)
    posts: tuple[Post, ...] = ()
    bays: tuple[Bay, ...] = ()
    anchors: dict[str, tuple[Coordinate, Coordinate, Coordinate]] = Field(default_factory=dict)

    def bay(self, name: str) -> Bay:
        """Bay by name; raises ConfigError."""
        found = [bay for bay in self.bays if bay.name == name]
        if not found:
            known = ", ".join(bay.name for bay in self.bays) or "none"
            raise ConfigError(f"bay {name!r}: shed {self.name!r} has no such bay (there are: {known})")
        return found[0]


class Site(Config):
    """Surveyed site; `boundary_m` is the field, `is_fenced` its edge, `start` a pose in the yard towards the lane."""

    name: str
    version: int = Field(ge=1)
    datum: DatumConfig
    boundary_m: Outline
    no_go: tuple[Area, ...] = ()
    lanes: tuple[Lane, ...] = ()
    gates: tuple[Gate, ...] = ()
    yard: Area
    start: PoseConfig
    is_fenced: bool
    shed: Shed | None = None

    def bay(self, name: str) -> Bay:
        """Bay of the shed by name; raises ConfigError."""
        if self.shed is None:
            raise ConfigError(f"bay {name!r}: site {self.name!r} has no shed")
        return self.shed.bay(name)
