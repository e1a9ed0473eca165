"""Drives of the campaign: the named scenarios and the pairwise list of `configs/hazards.yaml`, or draws of it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from configs.strict import CONFIGS, Config, load, parse, read_yaml
from simulation.randomness import generator
from simulation.scenario import Scenario

FILE = CONFIGS / "hazards.yaml"
CORE = 60  # drives of `--core`: the first of the list
START = {"at_s": 3.0, "command": "start", "expires_s": 5.0}
Plain = dict[str, Any]
Row = tuple[str, str, str, str]


class NamedDrive(Config):
    """A scenario file with its mission, seeds and longest duration."""

    scenario: str
    mission: str
    seeds: tuple[int, ...] = Field(min_length=1)
    limit_s: float = Field(gt=0.0, le=600.0)


class ObjectLevel(Config):
    """An object of the catalogue, and the placements that it can have."""

    object: Plain
    moves: bool = False
    lies_down: bool = False


class PlacementLevel(Config):
    """Place and behaviour, objects before it, and what the object must be able to do."""

    place: Plain
    behaviour: Plain = Field(default_factory=lambda: {"kind": "stand"})
    others: tuple[Plain, ...] = ()
    needs: Literal["moves", "lies_down"] | None = None
    is_near: bool = Field(default=False, description="beside the machine: only where it stands or sets off")


class PhaseLevel(Config):
    """Mission, appearance of the object, and longest duration."""

    mission: str
    when: Plain
    limit_s: float = Field(gt=0.0, le=600.0)
    stands: bool = Field(default=False, description="the machine stands, or has just set off, as the object appears")
    operator_commands: tuple[Plain, ...] = ()


class HazardList(Config):
    """Named drives, levels of the four factors, and rows of one level each: object, placement, phase, environment."""

    version: Literal[1]
    named: tuple[NamedDrive, ...]
    objects: dict[str, ObjectLevel]
    placements: dict[str, PlacementLevel]
    phases: dict[str, PhaseLevel]
    environments: dict[str, Plain]
    drives: tuple[Row, ...] = ()

    @model_validator(mode="after")
    def _rows_are_possible(self) -> Self:
        factors = self.factors
        for row in self.drives:
            for level, (factor, known) in zip(row, factors.items(), strict=True):
                if level not in known:
                    raise ValueError(f"drives {list(row)}: {level!r} is not one of the {factor}s")
            if not self.is_possible(dict(enumerate(row))):
                raise ValueError(f"drives {list(row)}: {row[1]!r} is not possible for {row[0]!r} in {row[2]!r}")
        return self

    @property
    def factors(self) -> dict[str, tuple[str, ...]]:
        """Levels of each factor, in the order of a row."""
        return {"object": tuple(self.objects), "placement": tuple(self.placements), "phase": tuple(self.phases),
                "environment": tuple(self.environments)}  # fmt: skip

    def is_possible(self, row: dict[int, str]) -> bool:
        """Whether object and phase of a row, or of part of one (factor number -> level), allow its placement."""
        if 1 not in row:
            return True
        placement = self.placements[row[1]]
        can = placement.needs is None or 0 not in row or bool(getattr(self.objects[row[0]], placement.needs))
        return can and (not placement.is_near or 2 not in row or self.phases[row[2]].stands)


@dataclass(frozen=True)
class HazardDrive:
    """One drive: mission, scenario as plain data, seed, longest duration and levels of its factors."""

    name: str
    mission: str
    scenario: Plain
    seed: int
    limit_s: float
    labels: dict[str, str]


def load_list(path: Path = FILE) -> HazardList:
    """The list; raises ConfigError."""
    return load(HazardList, path)


def with_plant(drive: HazardDrive, plant: str) -> HazardDrive:
    """The same drive with the plant `drawn`, `worst` or `nominal`."""
    return replace(drive, name=f"{drive.name}-{plant}", scenario=drive.scenario | {"plant": plant})


def without(drive: HazardDrive, sensor: str) -> HazardDrive:
    """The same drive with a sensor, such as `lidar/front`, that is off from the beginning."""
    fault = {"topic": sensor, "kind": "off", "from_s": 0.0, "for_s": 1e6}
    return replace(drive, name=f"{drive.name}-without-{sensor.replace('/', '_')}",
                   scenario=drive.scenario | {"faults": [fault]})  # fmt: skip


def draws_of(hazards: HazardList, seeds: range) -> list[HazardDrive]:
    """A random possible row for each seed, all of them equally likely, with that seed."""
    return [_drive(hazards, _drawn_row(hazards, seed), f"draw-{seed}", seed) for seed in seeds]


def _drawn_row(hazards: HazardList, seed: int) -> Row:
    random, levels = generator(seed, "hazards"), tuple(hazards.factors.values())
    while True:
        a, b, c, d = (names[int(random.integers(len(names)))] for names in levels)
        if hazards.is_possible({0: a, 1: b, 2: c, 3: d}):
            return a, b, c, d


def drives_of(hazards: HazardList, seeds: int, is_core: bool) -> list[HazardDrive]:
    """Named drives, also with seeds of their own, then rows, with seeds 1 to `seeds`; or the first `CORE` with one."""
    some = 1 if is_core else seeds
    named = [_named(one, seed) for one in hazards.named for seed in sorted({*one.seeds, *range(1, some + 1)})]
    if is_core:
        rows = [_row(hazards, number, 1) for number in range(1, CORE - len(named) + 1)]
        return [*named, *rows]
    numbers = range(1, len(hazards.drives) + 1)
    return [*named, *(_row(hazards, number, seed) for seed in range(1, seeds + 1) for number in numbers)]


def _named(one: NamedDrive, seed: int) -> HazardDrive:
    folder, _, name = one.scenario.rpartition("/")
    values = read_yaml(CONFIGS / "scenarios" / f"{one.scenario}.yaml")
    parse(Scenario, values, one.scenario)
    label = "" if folder == "hazards" else name
    labels = {"object": name if folder == "hazards" else "", "placement": "", "phase": "", "environment": label}
    return HazardDrive(f"{name}-{seed}", one.mission, values, seed, one.limit_s, labels)


def _row(hazards: HazardList, number: int, seed: int) -> HazardDrive:
    return _drive(hazards, hazards.drives[number - 1], f"{number:03d}-{seed}", seed)


def _drive(hazards: HazardList, row: Row, name: str, seed: int) -> HazardDrive:
    phase = hazards.phases[row[2]]
    labels = dict(zip(hazards.factors, row, strict=True))
    return HazardDrive(name, phase.mission, scenario_of(hazards, row), seed, phase.limit_s, labels)


def scenario_of(hazards: HazardList, row: Row) -> Plain:
    """Scenario of a row as plain data; raises ConfigError."""
    one, placement = hazards.objects[row[0]], hazards.placements[row[1]]
    phase, environment = hazards.phases[row[2]], hazards.environments[row[3]]
    late = {"when": phase.when}
    objects = [{**other, **late} for other in placement.others]
    main = {"name": "object", **one.object, "place": placement.place, "behaviour": placement.behaviour, **late}
    values: Plain = {
        "name": ", ".join(row), "operator_commands": [START, *phase.operator_commands], "objects": [*objects, main],
    }  # fmt: skip
    if environment:
        values["environment"] = environment
    parse(Scenario, values, f"{FILE.name} {list(row)}")
    return values
