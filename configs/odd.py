"""Operational design domain: conditions in which the machine works, and the smallest object promised in each."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal, Self, get_args

from pydantic import Field, model_validator

from configs.strict import CONFIGS, Config, load
from messages.errors import ConfigError

Quantity = Literal[
    "crop_height_m", "stubble_height_m", "visibility_m", "dust_visibility_m", "dust_ray_share", "slope_deg",
    "roughness_m", "light_lux", "wind_mps",
]  # fmt: skip
FALLING = ("visibility_m", "dust_visibility_m", "light_lux")  # the lower, the worse


class Band(Config):
    """Range of one quantity up to (falling quantities: down to) `limit`, and the smallest object promised in it.

    An object is promised that reaches `object_height_m` above the ground and whose middle one of three extents is at
    least `object_width_m`.
    """

    limit: float = Field(ge=0.0, le=1e6)
    object_height_m: float = Field(gt=0.0, le=3.0)
    object_width_m: float = Field(gt=0.0, le=3.0)


class OddConfig(Config):
    """Bands of every quantity, from easy to hard; beyond the last one is outside of the domain."""

    version: Literal[1]
    quantities: dict[Quantity, tuple[Band, ...]]

    @model_validator(mode="after")
    def _is_complete_and_ordered(self) -> Self:
        missing = [name for name in get_args(Quantity) if name not in self.quantities]
        if missing:
            raise ValueError(f"quantities lacks {missing[0]}")
        for name, bands in self.quantities.items():
            if not bands:
                raise ValueError(f"{name} needs a band")
            sign = -1.0 if name in FALLING else 1.0
            limits = [sign * band.limit for band in bands]
            if any(a >= b for a, b in pairwise(limits)):
                raise ValueError(f"{name}: limits {[band.limit for band in bands]} must go from easy to hard")
            for a, b in pairwise(bands):
                if b.object_height_m < a.object_height_m or b.object_width_m < a.object_width_m:
                    raise ValueError(f"{name}: the band up to {b.limit:g} promises more than the one before")
        return self

    def promise(self, conditions: Mapping[str, float]) -> "Promise":
        """What is promised in these conditions; quantities that are not given are at their best.

        Raises ConfigError for an unknown quantity or a value that is no number.
        """
        best = [bands[0] for bands in self.quantities.values()]
        height, width = max(b.object_height_m for b in best), max(b.object_width_m for b in best)
        outside: list[str] = []
        for name, value in conditions.items():
            if name not in self.quantities:
                raise ConfigError(f"{name!r} is no quantity of the operational design domain")
            if math.isnan(value):
                raise ConfigError(f"{name} {value}: not a number")
            sign = -1.0 if name in FALLING else 1.0
            bands = self.quantities[name]
            band = next((b for b in bands if sign * value <= sign * b.limit + 1e-9), None)
            if band is None:
                outside.append(f"{name} {value:g}")
                continue
            height, width = max(height, band.object_height_m), max(width, band.object_width_m)
        return Promise(tuple(outside), height, width)


@dataclass(frozen=True)
class Promise:
    """Quantities outside of the domain (none: inside), and the smallest object promised inside."""

    outside: tuple[str, ...]
    object_height_m: float
    object_width_m: float

    def covers(self, height_m: float, width_m: float) -> bool:
        """Whether an object of this height and middle extent is promised."""
        return not self.outside and height_m >= self.object_height_m and width_m >= self.object_width_m


def load_odd(path: Path | None = None) -> OddConfig:
    """Operational design domain from `configs/odd.yaml` or another file; raises ConfigError."""
    return load(OddConfig, path or CONFIGS / "odd.yaml")
