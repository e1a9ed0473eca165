"""Where encounters happen: places on the planned swaths, drawn from the seed, far enough from each other."""

import math
from dataclasses import dataclass

import numpy as np
from shapely import LineString, Point
from shapely.geometry.base import BaseGeometry

from messages.errors import FieldError
from messages.plan import Path, PathSection, PathSectionType
from simulation.actors.encounter import EncounterPoint, EncounterSite, Walk, draw_bystander, draw_crossing
from simulation.scenario import Bystander, Crossing, Encounter, Parked

RUN_UP_M = 12.0  # straight way before the trigger: front, turning in and gaining work speed
RUN_OUT_M = 8.0  # straight way behind, so that a stop or detour does not touch the turn
APART_M = 6.0
STRAIGHT_RADPM = 0.01
DRAWS = 2000


@dataclass(frozen=True)
class ParkedVehicle:
    """A vehicle left on the way."""

    place: EncounterPoint
    p_map_m: tuple[float, float]
    heading_rad: float


@dataclass(frozen=True)
class Swath:
    """A straight section of planned work: its start, direction, length and speed."""

    start_map_m: tuple[float, float]
    heading_rad: float
    length_m: float
    speed_mps: float
    line: int

    def place(self, way_m: float) -> EncounterPoint:
        """The place some way along it."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        p = (self.start_map_m[0] + way_m * c, self.start_map_m[1] + way_m * s)
        return EncounterPoint(p, self.heading_rad, self.speed_mps, self.line)


PlacedEncounter = Walk | ParkedVehicle


def find_swaths(paths: tuple[Path, ...]) -> list[Swath]:
    """All straight swaths of a plan that are driven forward."""
    return [
        swath
        for path in paths if path.direction > 0
        for section in path.sections if section.section_type == PathSectionType.SWATH
        if (swath := _longest_straight(path, section)) is not None
    ]  # fmt: skip


def _longest_straight(path: Path, section: PathSection) -> Swath | None:
    """The longest part without bend and in work."""
    index = np.arange(section.first, section.last + 1)
    is_straight = (np.abs(path.curvature_radpm[index]) < STRAIGHT_RADPM) & (path.is_working[index] == 1)
    runs = np.split(index, np.flatnonzero(np.diff(is_straight.astype(int))) + 1)
    runs = [r for r in runs if is_straight[r[0] - section.first] and len(r) > 2]
    if not runs:
        return None
    run = max(runs, key=len)
    (x0, y0), (x1, y1) = path.p_map_m[run[0]], path.p_map_m[run[-1]]
    speed = float(np.max(path.speed_mps[run]))
    return Swath(
        (float(x0), float(y0)), math.atan2(y1 - y0, x1 - x0), math.hypot(x1 - x0, y1 - y0), speed, section.line
    )


def place_encounters(
    encounters: tuple[Encounter, ...],
    paths: tuple[Path, ...],
    setting: EncounterSite,
    random: np.random.Generator,
) -> list[PlacedEncounter]:
    """One place for each encounter, each on a swath of its own or before its bay; FieldError where there is none."""
    swaths = find_swaths(paths)
    drawn: list[PlacedEncounter] = []
    for encounter in encounters:
        if isinstance(encounter, Bystander):
            drawn.append(draw_bystander(encounter, setting, random))
            continue
        found = next((d for _ in range(DRAWS) if (d := _draw(encounter, swaths, drawn, setting, random))), None)
        if found is None:
            raise FieldError(f"encounter {encounter.name!r}: none of the {len(swaths)} planned swaths has room for it; "
                             "take a larger field or a scenario without it")  # fmt: skip
        drawn.append(found)
    return drawn


def _draw(
    encounter: Crossing | Parked,
    swaths: list[Swath],
    others: list[PlacedEncounter],
    setting: EncounterSite,
    random: np.random.Generator,
) -> PlacedEncounter | None:
    """One try: None when it does not fit."""
    lines = [o.place.line for o in others]
    free = [s for s in swaths if s.line not in lines]
    if not free:
        return None
    swath = free[int(random.integers(len(free)))]
    way = swath.length_m * random.uniform(*encounter.swath_fraction)
    place = swath.place(way)
    drawn = _draw_at(encounter, place, setting, random)
    run_up = RUN_UP_M + (drawn.trigger_m if isinstance(drawn, Walk) else RUN_UP_M)
    fits = way >= run_up and swath.length_m - way >= RUN_OUT_M
    is_apart = all(ground_geometry(drawn).distance(ground_geometry(o)) >= APART_M for o in others)
    return drawn if fits and is_apart else None


def _draw_at(
    encounter: Crossing | Parked, place: EncounterPoint, setting: EncounterSite, random: np.random.Generator
) -> PlacedEncounter:
    if isinstance(encounter, Crossing):
        return draw_crossing(encounter, place, setting, random)
    return draw_parked(encounter, place, random)


def draw_parked(parked: Parked, place: EncounterPoint, random: np.random.Generator) -> ParkedVehicle:
    """A vehicle about the middle of the way and nearly along it, facing either way."""
    aside = random.uniform(*parked.lateral_m)
    turned = math.radians(random.uniform(*parked.yaw_offset_deg)) + (math.pi if random.random() < 0.5 else 0.0)
    c, s = math.cos(place.heading_rad), math.sin(place.heading_rad)
    p = (place.p_map_m[0] - aside * s, place.p_map_m[1] + aside * c)
    return ParkedVehicle(place, p, place.heading_rad + turned)


def ground_geometry(drawn: PlacedEncounter) -> BaseGeometry:
    """The ground that an encounter takes."""
    if isinstance(drawn, Walk):
        return LineString([drawn.start_map_m, drawn.exit_map_m])
    return Point(drawn.p_map_m).buffer(2.5)
