"""Environment of a scenario: ground, vegetation, weather, dust, birds and surroundings (docs/scenarios.md)."""

from typing import Literal, Self

from pydantic import Field, model_validator

from configs.strict import Config
from simulation.scenario_values import (
    Angle,
    AreaDensity,
    Coordinate,
    Distance,
    Divergence,
    DustVisibility,
    FeatureWidth,
    GroundHeight,
    Height,
    HillHeight,
    PerArea,
    PlantHeight,
    Share,
    SideSlope,
    Speed,
    Visibility,
    WaveLength,
    Wind,
)

AreaName = Literal["field", "outside", "everywhere"]


class Crest(Config):
    """A straight ridge (a hollow, if negative) with the section of one cosine period, through a point in `map`."""

    height_m: HillHeight
    length_m: WaveLength = Field(description="from foot to foot")
    x_m: Coordinate
    y_m: Coordinate
    heading_deg: Angle = Field(default=(90.0, 90.0), description="of the ridge, counter-clockwise from east")


class Waves(Config):
    """Superposed sine waves; height, length, direction and phase of each are drawn."""

    count: int = Field(default=1, ge=1, le=20)
    height_m: GroundHeight = Field(description="from trough to crest, of each")
    length_m: WaveLength
    heading_deg: Angle = Field(default=(0.0, 0.0), description="across the crests, against the longest edge")


class Furrows(Config):
    """Sine furrows along the longest edge of the field; they replace those of the simulation's configuration."""

    depth_m: GroundHeight
    spacing_m: FeatureWidth


class Ruts(Config):
    """Pairs of wheel tracks along the longest edge of the field, with the section of one cosine period."""

    depth_m: GroundHeight
    width_m: FeatureWidth = (0.5, 0.5)
    track_m: FeatureWidth = Field(default=(1.9, 1.9), description="between the two of a pair")
    spacing_m: WaveLength = Field(default=(12.0, 12.0), description="between pairs")


class Clods(Config):
    """Clods on the field: half ellipsoids of random place and size, twice as wide as high; wheels crush them."""

    height_m: GroundHeight
    per_m2: PerArea


class Ditch(Config):
    """A straight ditch with the section of one cosine period, through a point in `map`."""

    depth_m: Height
    width_m: FeatureWidth
    x_m: Coordinate
    y_m: Coordinate
    heading_deg: Angle = (0.0, 0.0)


class Bank(Config):
    """A step down of the ground along a straight edge through a point in `map`; the ground to its right is lower."""

    height_m: Height
    width_m: FeatureWidth = Field(default=(0.3, 0.3), description="of the face")
    x_m: Coordinate
    y_m: Coordinate
    heading_deg: Angle = Field(default=(0.0, 0.0), description="of the edge, counter-clockwise from east")


class Ground(Config):
    """Shape of the ground besides that of the simulation's configuration; shed and yard stay level."""

    crest: Crest | None = None
    waves: Waves | None = None
    furrows: Furrows | None = None
    ruts: Ruts | None = None
    clods: Clods | None = None
    ditch: Ditch | None = None
    bank: Bank | None = None
    side_slope_deg: SideSlope = Field(default=(0.0, 0.0), description="of the field, rising from the edge at the start")


class Vegetation(Config):
    """A stand of plants: a layer on the ground that beams enter; it replaces the crop rows of the configuration."""

    kind: Literal["crop", "stubble", "grass"]
    height_m: PlantHeight
    density_m2pm3: AreaDensity | None = Field(
        default=None, description="leaf (one-sided) or frontal stem area per volume; default: usual of the kind"
    )
    area: AreaName = "field"


class Fog(Config):
    """Homogeneous fog."""

    visibility_m: Visibility = Field(description="meteorological optical range (5 % contrast)")


class Rain(Config):
    """Homogeneous rain; the rate follows from the visibility."""

    visibility_m: Visibility = Field(description="meteorological optical range (5 % contrast)")


class Dust(Config):
    """Dust: clouds from wheels and working implement, carried by the wind, and isolated returns."""

    visibility_m: DustVisibility | None = Field(
        default=None, description="in a fresh cloud of the implement; default: no clouds"
    )
    ray_share: Share | None = Field(
        default=None, description="rays with an isolated return near the sensor; default: of the configuration"
    )


class Birds(Config):
    """Gulls that circle around the implement."""

    gulls: int = Field(ge=1, le=30)
    height_m: Height = (1.0, 4.0)
    radius_m: Distance = (3.0, 12.0)
    speed_mps: Speed = (6.0, 10.0)


class Boundary(Config):
    """Hedge and trees along the boundary, outside the fence, open at lanes and gates."""

    hedge_height_m: Height | None = Field(default=None, description="default: no hedge")
    trees: int = Field(default=0, ge=0, le=200)
    distance_m: Distance = Field(default=(2.0, 2.0), description="of hedge and trunks from the boundary")

    @model_validator(mode="after")
    def _has_something(self) -> Self:
        if self.hedge_height_m is None and self.trees == 0:
            raise ValueError("needs hedge_height_m or trees")
        return self


class Neighbour(Config):
    """A tractor with trailer that drives to and fro in the next field, along the longest edge."""

    distance_m: Distance = Field(default=(6.0, 10.0), description="from the boundary, away from the yard")
    speed_mps: Speed = (2.0, 3.0)


class Environment(Config):
    """Environment of a run; without it ground, air and beams are those of the simulation's configuration."""

    beam_divergence_mrad: Divergence = Field(default=(3.0, 3.0), description="full angle of a lidar beam")
    wind_mps: Wind = (3.0, 3.0)
    wind_heading_deg: Angle = Field(default=(90.0, 90.0), description="to which it blows, counter-clockwise from east")
    ground: Ground = Ground()
    vegetation: tuple[Vegetation, ...] = Field(default=(), max_length=4)
    fog: Fog | None = None
    rain: Rain | None = None
    dust: Dust | None = None
    birds: Birds | None = None
    boundary: Boundary | None = None
    neighbour: Neighbour | None = None

    @model_validator(mode="after")
    def _areas_are_separate(self) -> Self:
        areas = [stand.area for stand in self.vegetation]
        if len(set(areas)) < len(areas) or ("everywhere" in areas and len(areas) > 1):
            raise ValueError(f"vegetation of areas {', '.join(areas)}: each area once, everywhere alone")
        return self
