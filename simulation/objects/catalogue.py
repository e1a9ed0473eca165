"""Catalogue of objects: postures, range of heights, and the solid of each."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from messages.errors import ConfigError
from simulation.objects.animals import fawn, gull, quadruped, roe_deer
from simulation.objects.people import PERSON_POSTURES, cyclist, person_solid
from simulation.objects.solid import Solid
from simulation.objects.things import thing
from simulation.objects.vehicles import vehicle


@dataclass(frozen=True)
class Entry:
    """An object: permitted and usual range of its height, and postures (the first is usual).

    `build` makes the solid from name, posture and height. `height` says what the height is.
    """

    build: Callable[[str, str, float], Solid]
    height_m: tuple[float, float]
    usual_m: tuple[float, float]
    postures: tuple[str, ...] = ("standing",)
    height: str = "of the body"
    walk_mps: float = 0.0  # usual speed; 0: does not move by itself


CATALOGUE: dict[str, Entry] = {
    "adult": Entry(person_solid, (1.5, 1.9), (1.6, 1.85), PERSON_POSTURES, "standing", 1.3),
    "child": Entry(person_solid, (0.9, 1.3), (1.0, 1.2), PERSON_POSTURES, "standing", 1.2),
    "cyclist": Entry(cyclist, (1.5, 1.9), (1.6, 1.85), ("riding",), "of the rider, standing", 4.0),
    "dog": Entry(quadruped, (0.3, 0.9), (0.6, 0.8), height="with the head", walk_mps=1.5),
    "calf": Entry(quadruped, (0.8, 1.2), (0.9, 1.1), height="with the head", walk_mps=1.0),
    "sheep": Entry(quadruped, (0.7, 1.1), (0.8, 1.0), height="with the head", walk_mps=1.0),
    "roe_deer": Entry(roe_deer, (1.0, 1.4), (1.2, 1.3), height="with the ears", walk_mps=2.0),
    "fawn": Entry(fawn, (0.2, 0.4), (0.3, 0.3), ("lying",), "lying, with the ears"),
    "gull": Entry(gull, (0.3, 15.0), (1.0, 4.0), ("flying",), "of flight", 8.0),
    "car": Entry(vehicle, (1.4, 2.0), (1.65, 1.65), ("parked",), "of the roof", 3.0),
    "quad": Entry(vehicle, (1.0, 1.4), (1.2, 1.2), ("parked",), "of the handlebar", 4.0),
    "tractor_with_trailer": Entry(vehicle, (2.5, 3.2), (2.8, 2.8), ("parked",), "of the cab", 3.0),
    "test_body": Entry(thing, (0.8, 0.8), (0.8, 0.8)),
    "post": Entry(thing, (0.5, 2.5), (1.2, 1.2), ("usual", "thin", "thick")),
    "wire": Entry(thing, (0.2, 2.5), (0.8, 1.2), ("taut",), "above the ground"),
    "low_wall": Entry(thing, (0.2, 0.6), (0.3, 0.3)),
    "branch": Entry(thing, (1.0, 2.5), (1.0, 2.5), ("hanging",), "above the ground"),
    "gate": Entry(thing, (0.9, 1.4), (1.1, 1.1), ("closed", "half_open")),
    "shed_door": Entry(thing, (2.0, 5.0), (4.0, 4.0), ("half_closed",)),
    "drawbar": Entry(thing, (0.3, 0.8), (0.45, 0.55), ("parked",), "of the eye"),
    "round_bale": Entry(thing, (1.0, 1.8), (1.2, 1.5), ("lying",), "diameter"),
    "stone": Entry(thing, (0.1, 0.6), (0.3, 0.3), ("lying",)),
    "puddle": Entry(thing, (0.002, 0.05), (0.005, 0.005), ("lying",), "above the ground"),
}


@cache
def solid_of(name: str, posture: str, height_m: float) -> Solid:
    """The solid of a catalogue entry, one object per argument; raises ConfigError."""
    entry = CATALOGUE.get(name)
    if entry is None:
        raise ConfigError(f"object {name!r}: not in the catalogue ({', '.join(CATALOGUE)})")
    if posture not in entry.postures:
        raise ConfigError(f"posture {posture!r}: {name} has {', '.join(entry.postures)}")
    low, high = entry.height_m
    if not low <= height_m <= high:
        raise ConfigError(f"height_m {height_m:g}: {name} is {low:g} to {high:g} m high")
    return entry.build(name, posture, height_m)
