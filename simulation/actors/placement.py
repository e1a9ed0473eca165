"""Places of encounters: points on the planned swaths, drawn from the seed, with minimum spacing."""

import math
from dataclasses import dataclass

import numpy as np
from shapely import LineString, Point
from shapely.geometry.base import BaseGeometry

from messages.errors import FieldError
from messages.plan import Path, PathSection, PathSectionType
from simulation.actors.encounter import EncounterPoint, EncounterSite, Walk, draw_bystander, draw_crossing
from simulation.scenario import Bystander, Crossing, Encounter, Parked

RUN_UP_M = 12.0  # straight path before the trigger: machine front, end of turn, acceleration
RUN_OUT_M = 8.0  # straight path behind: room for a stop or detour before the turn
APART_M = 6.0
STRAIGHT_RADPM = 0.01
DRAWS = 2000


@dataclass(frozen=True)
class ParkedVehicle:
    """A vehicle parked on the path."""

    point: EncounterPoint
    p_map_m: tuple[float, float]
    heading_rad: float


@dataclass(frozen=True)
class Swath:
    """A straight section of planned work: start, direction, length, speed and line number."""

    start_map_m: tuple[float, float]
    heading_rad: float
    length_m: float
    speed_mps: float
    line: int

    def point(self, s_m: float) -> EncounterPoint:
        """The point at a distance along it."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        p = (self.start_map_m[0] + s_m * c, self.start_map_m[1] + s_m * s)
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
    """The longest straight part with the implement working."""
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
    site: EncounterSite,
    random: np.random.Generator,
) -> list[PlacedEncounter]:
    """One placement per encounter, each on its own swath or at its bay; raises FieldError without room."""
    swaths = find_swaths(paths)
    placed: list[PlacedEncounter] = []
    for encounter in encounters:
        if isinstance(encounter, Bystander):
            placed.append(draw_bystander(encounter, site, random))
            continue
        found = next((d for _ in range(DRAWS) if (d := _draw(encounter, swaths, placed, site, random))), None)
        if found is None:
            raise FieldError(f"encounter {encounter.name!r}: none of the {len(swaths)} planned swaths has room for it; "
                             "take a larger field or a scenario without it")  # fmt: skip
        placed.append(found)
    return placed


def _draw(
    encounter: Crossing | Parked,
    swaths: list[Swath],
    others: list[PlacedEncounter],
    site: EncounterSite,
    random: np.random.Generator,
) -> PlacedEncounter | None:
    """One attempt; None when it does not fit."""
    lines = [o.point.line for o in others]
    free = [s for s in swaths if s.line not in lines]
    if not free:
        return None
    swath = free[int(random.integers(len(free)))]
    s_m = swath.length_m * random.uniform(*encounter.swath_fraction)
    point = swath.point(s_m)
    placed = _draw_at(encounter, point, site, random)
    run_up = RUN_UP_M + (placed.trigger_m if isinstance(placed, Walk) else RUN_UP_M)
    fits = s_m >= run_up and swath.length_m - s_m >= RUN_OUT_M
    is_apart = all(ground_geometry(placed).distance(ground_geometry(o)) >= APART_M for o in others)
    return placed if fits and is_apart else None


def _draw_at(
    encounter: Crossing | Parked, point: EncounterPoint, site: EncounterSite, random: np.random.Generator
) -> PlacedEncounter:
    if isinstance(encounter, Crossing):
        return draw_crossing(encounter, point, site, random)
    return draw_parked(encounter, point, random)


def draw_parked(parked: Parked, point: EncounterPoint, random: np.random.Generator) -> ParkedVehicle:
    """A vehicle near the centre of the path, nearly parallel to it, facing either direction."""
    lateral = random.uniform(*parked.lateral_m)
    yaw_offset = math.radians(random.uniform(*parked.yaw_offset_deg)) + (math.pi if random.random() < 0.5 else 0.0)
    c, s = math.cos(point.heading_rad), math.sin(point.heading_rad)
    p = (point.p_map_m[0] - lateral * s, point.p_map_m[1] + lateral * c)
    return ParkedVehicle(point, p, point.heading_rad + yaw_offset)


def ground_geometry(placed: PlacedEncounter) -> BaseGeometry:
    """Ground that an encounter covers."""
    if isinstance(placed, Walk):
        return LineString([placed.start_map_m, placed.exit_map_m])
    return Point(placed.p_map_m).buffer(2.5)
