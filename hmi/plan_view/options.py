"""Choices of a plan: machine, implement, headland, turns, direction and consent, as a mission file."""

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import yaml

from configs.mission import Consent, EdgeMargin, Mission, Refill, Work
from configs.site import Point
from configs.strict import CONFIGS, load
from configs.vehicle import ImplementFile, MountedImplement, Vehicle
from messages.errors import ConfigError

MAX_PASSES, MAX_SKIP = 10, 9
HEIGHTS_CM = (10, 15, 20, 25, 30, 35)  # of plants, for which consent can be given
Turns = Literal["forward", "reverse"]
Headland = Literal["first", "last", "none"]
HEADLAND: tuple[Headland, ...] = ("first", "last", "none")
TURNS: tuple[Turns, ...] = ("forward", "reverse")
AUTO = ""  # the planner finds the direction


@dataclass(frozen=True)
class PlanOptions:
    """What is chosen; `heading_deg` is clockwise from north, None: found by the planner.

    The guidance line of the swaths has that heading through the point `through_m` in `map`, or `guidance` is the number
    of a line of the field file. `swath_skip`, `swaths_from_m`, `margins` and `refill` are those of `Work`.
    `consent` of the person who has chosen a height of plants, None: no work where plants hide whoever lies there.
    """

    machine: str
    implement: str
    headland_passes: int
    turns: Turns
    heading_deg: float | None = None
    through_m: tuple[float, float] | None = None
    guidance: str | None = None
    consent: Consent | None = None
    headland: Headland = "first"
    swath_skip: int | None = None
    swaths_from_m: Point | None = None
    margins: tuple[EdgeMargin, ...] = ()
    refill: Refill | None = None

    def changed(self, name: str, value: str, by: str) -> "PlanOptions":
        """Options with one changed, by a person; raises ConfigError that names the value."""
        if name == "vegetation_cm":
            low, high = HEIGHTS_CM[0], HEIGHTS_CM[-1]
            consent = None if value == "" else Consent(by=by, vegetation_m=_whole(name, value, low, high) / 100.0)
            return replace(self, consent=consent)
        if name == "swath_skip":
            return replace(self, swath_skip=None if value == AUTO else _whole(name, value, 0, MAX_SKIP))
        if name == "headland_passes":
            return replace(self, headland_passes=_whole(name, value, 1, MAX_PASSES))
        if name == "heading_deg":
            heading = None if value == AUTO else float(_whole(name, value, 0, 359))
            return replace(self.without_line(), heading_deg=heading)
        if name not in choices() or value not in choices()[name]:
            raise ConfigError(f"{name} {value[:60]!r}: not one of {', '.join(choices().get(name, ()))}")
        return replace(self, **{name: value})  # type: ignore[arg-type]

    def without_places(self) -> "PlanOptions":
        """Options without what belongs to places of one field."""
        return replace(self, swaths_from_m=None, margins=(), refill=None)

    def without_line(self) -> "PlanOptions":
        """Options without guidance line."""
        heading = None if self.through_m is not None else self.heading_deg
        return replace(self, heading_deg=heading, through_m=None, guidance=None)

    def with_line(self, through_m: tuple[float, float], heading_deg: float) -> "PlanOptions":
        """Options with a guidance line through a point."""
        return replace(self, heading_deg=round(heading_deg % 360.0, 3), through_m=through_m, guidance=None)

    def with_guidance(self, number: str) -> "PlanOptions":
        """Options with a line of the field file."""
        return replace(self, heading_deg=None, through_m=None, guidance=number)

    def mission(self, name: str, work: Work) -> Mission:
        """Mission with these choices; speeds, overlap and margin are those of `work`."""
        direction = None if self.heading_deg is None else _to_yaw(self.heading_deg)
        changes = {
            "headland_passes": self.headland_passes, "headland": self.headland, "turns": self.turns,
            "swath_direction_deg": direction, "swath_through_m": self.through_m, "guidance": self.guidance,
            "swath_skip": self.swath_skip, "swaths_from_m": self.swaths_from_m, "margins": self.margins,
            "refill": self.refill,
        }  # fmt: skip
        return Mission(
            name=name, site="field", machine=self.machine, implement=self.implement,
            work=work.model_copy(update=changes), consent=self.consent,
        )  # fmt: skip


def options_of(mission: Mission, work: Work) -> PlanOptions:
    """Options that give this mission."""
    yaw = work.swath_direction_deg
    heading = None if yaw is None else round((90.0 - yaw) % 360.0, 3)
    return PlanOptions(
        mission.machine, mission.implement, work.headland_passes, work.turns, heading, work.swath_through_m,
        work.guidance, mission.consent, work.headland, work.swath_skip, work.swaths_from_m, work.margins, work.refill,
    )  # fmt: skip


@cache
def choices() -> dict[str, tuple[str, ...]]:
    """Values of each option that is one of several names; machines and implements are files of `configs/`."""
    names = {one: tuple(sorted(path.stem for path in (CONFIGS / f"{one}s").glob("*.yaml"))) for one in _FOLDERS}
    return names | {"turns": TURNS, "headland": HEADLAND}


_FOLDERS = ("machine", "implement")


def write_mission(mission: Mission, path: Path) -> None:
    """Writes a mission file, which `headland run --mission` reads as well."""
    values: dict[str, Any] = mission.model_dump(mode="json", exclude_none=True)
    path.write_text(yaml.safe_dump(values, sort_keys=False, allow_unicode=True), encoding="utf-8")


def read_mission(path: Path) -> tuple[Mission, Work]:
    """A mission file with field work; raises ConfigError."""
    mission = load(Mission, path)
    if mission.work is None:
        raise ConfigError(f"{path}: has no field work")
    return mission, mission.work


def default_work() -> Work:
    """Field work of `configs/missions/yard.yaml`: speeds, overlap and margin of missions that are planned here."""
    return read_mission(CONFIGS / "missions" / "yard.yaml")[1]


def default_options(vehicle_name: str, implement_name: str) -> PlanOptions:
    """Options at the start: the files of `configs/` with these names, else the first ones that are driven."""
    known, work = choices(), default_work()
    machines = {load(Vehicle, CONFIGS / "machines" / f"{stem}.yaml").name: stem for stem in known["machine"]}
    files = {stem: load(ImplementFile, CONFIGS / "implements" / f"{stem}.yaml") for stem in known["implement"]}
    implements = {file.implement.name: stem for stem, file in files.items()}
    driven = next(stem for stem, file in files.items() if isinstance(file.implement, MountedImplement))
    return PlanOptions(
        machines.get(vehicle_name, known["machine"][0]), implements.get(implement_name, driven),
        work.headland_passes, work.turns, headland=work.headland,
    )  # fmt: skip


def _to_yaw(heading_deg: float) -> float:
    """Degrees counter-clockwise from east, in (-180, 180]."""
    return 180.0 - math.fmod(heading_deg + 90.0, 360.0)


def _whole(name: str, value: str, low: int, high: int) -> int:
    if not (value.isascii() and value.isdecimal() and len(value) < 6 and low <= int(value) <= high):
        raise ConfigError(f"{name} {value[:60]!r}: must be a whole number from {low} to {high}")
    return int(value)
