"""Scene: what does not move, and the dimensions of machine and implement, from the resolved configuration of a run."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import yaml
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from configs.site import Site
from configs.strict import Config, parse
from configs.vehicle import Body, Implement, TrailedImplement, Vehicle, outlines
from geometry.arrays import Float64
from geometry.pose2 import Pose2
from geometry.rectangle import Rectangle
from messages.errors import ConfigError


class _Sections(Config):
    site: Site
    machine: Vehicle
    implement: Implement


@dataclass(frozen=True)
class Scene:
    """Site, machine and implement of a run, and the planned lines, each (N, 2) in `map`, where they are known.

    Corrections older than `max_correction_age_s` are not used.
    """

    site: Site
    vehicle: Vehicle
    implement: Implement
    planned_map_m: tuple[Float64, ...] = ()
    max_correction_age_s: float = math.inf

    @property
    def working_point_m(self) -> float:
        """Working point of the implement along x of `base`; a trailed one is taken as straight behind."""
        return float(getattr(self.implement, "working_point_m", np.mean(self.implement.ends_m)))

    @cached_property
    def field(self) -> BaseGeometry:
        """The field without its no-go areas."""
        field: BaseGeometry = Polygon(self.site.boundary_m)
        for area in self.site.no_go:
            field = field.difference(Polygon(area.outline_m))
        return field


def placed_outlines(body: Body, implement: Implement, hitch_rad: float) -> list[tuple[Rectangle, Pose2]]:
    """Outlines of machine and implement, each with the pose of its carrier in `base`: a trailed one is at its hitch."""
    if not isinstance(implement, TrailedImplement):
        return [(outline, Pose2(0.0, 0.0, 0.0)) for outline in outlines(body, implement)]
    trailed = Rectangle(-implement.total_length_m, 0.0, implement.width_m)
    return [
        *((outline, Pose2(0.0, 0.0, 0.0)) for outline in outlines(body, None)),
        (trailed, Pose2(implement.hitch_m, 0.0, hitch_rad)),
    ]


def scene_of(text: str, where: str, planned_map_m: tuple[Float64, ...] = ()) -> Scene:
    """Scene of the resolved configuration (`config.yaml` of a run or of a log); raises ConfigError."""
    values: Any = yaml.load(text, yaml.CSafeLoader)
    if not isinstance(values, dict) or not _Sections.model_fields.keys() <= values.keys():
        raise ConfigError(f"{where}: has no site, machine and implement; a log of `headland run` or `live` is needed")
    found = parse(_Sections, {name: values[name] for name in _Sections.model_fields}, where)
    try:
        age_s = float(values["stack"]["localization"]["map_alignment"]["gnss"]["max_correction_age_s"])
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{where}: has no stack.localization.map_alignment.gnss.max_correction_age_s") from error
    return Scene(found.site, found.machine, found.implement, planned_map_m, age_s)
