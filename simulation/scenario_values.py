"""Values of scenario files: ranges that are drawn from the seed, names, kinds of sensors."""

import re
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from configs.sensor_kinds import SENSOR_KINDS
from configs.strict import Config

Bounds = tuple[float, float]


def _is_rising(value: Bounds) -> Bounds:
    if value[0] > value[1]:
        raise ValueError(f"{value[0]} to {value[1]} is not a range")
    return value


def _is_known_kind(value: str) -> str:
    if value not in SENSOR_KINDS:
        raise ValueError(f"{value!r} is not a kind of sensor ({', '.join(SENSOR_KINDS)})")
    return value


def _as_range(value: Any) -> Any:
    return (value, value) if isinstance(value, (int, float)) and not isinstance(value, bool) else value


def _limits(low: float, high: float) -> AfterValidator:
    def check(value: Bounds) -> Bounds:
        if not low <= value[0] <= value[1] <= high:
            raise ValueError(f"must be a number or a rising range between {low:g} and {high:g}")
        return value

    return AfterValidator(check)


def draw(config: Config, random: np.random.Generator) -> dict[str, float]:
    """A value for each range of a section, in the order of its keys."""
    ranges = {name: getattr(config, name) for name in type(config).model_fields}
    return {name: float(random.uniform(*value)) for name, value in ranges.items() if _is_range(value)}


def _is_range(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(isinstance(v, float) for v in value)


def _is_name(value: str) -> str:
    if not re.fullmatch(r"[a-z0-9_ ]{1,40}", value):
        raise ValueError(f"{value!r} is not a name (1 to 40 of a-z, 0-9, _ and space)")
    return value


Bound = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Range = Annotated[tuple[Bound, Bound], AfterValidator(_is_rising)]
KindName = Annotated[str, AfterValidator(_is_known_kind)]
ALL_SENSORS = tuple(SENSOR_KINDS)
Name = Annotated[str, AfterValidator(_is_name)]
# a number, or a range [low, high] that is drawn from the seed
Distance = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 1000.0)]
Offset = Annotated[Bounds, BeforeValidator(_as_range), _limits(-500.0, 500.0)]
Gap = Annotated[Bounds, BeforeValidator(_as_range), _limits(-1.0, 100.0)]
Coordinate = Annotated[Bounds, BeforeValidator(_as_range), _limits(-20000.0, 20000.0)]
Angle = Annotated[Bounds, BeforeValidator(_as_range), _limits(-360.0, 360.0)]
Time = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 1e5)]
Speed = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.05, 15.0)]
Height = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 20.0)]
# of the environment
GroundHeight = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 0.5)]
HillHeight = Annotated[Bounds, BeforeValidator(_as_range), _limits(-5.0, 5.0)]
FeatureWidth = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.2, 5.0)]
WaveLength = Annotated[Bounds, BeforeValidator(_as_range), _limits(2.0, 200.0)]
SideSlope = Annotated[Bounds, BeforeValidator(_as_range), _limits(-20.0, 20.0)]
PlantHeight = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 1.2)]
AreaDensity = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 20.0)]
Visibility = Annotated[Bounds, BeforeValidator(_as_range), _limits(10.0, 20000.0)]
DustVisibility = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.5, 1000.0)]
Wind = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 20.0)]
Share = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 0.1)]
Divergence = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 10.0)]
PerArea = Annotated[Bounds, BeforeValidator(_as_range), _limits(0.0, 10.0)]
