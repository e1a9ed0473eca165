"""Objects of a scenario: what, where, when, and how they behave."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from configs.strict import Config
from simulation.actors.phases import PhaseName
from simulation.objects.catalogue import CATALOGUE
from simulation.objects.people import PERSON_POSTURES
from simulation.scenario_values import (
    ALL_SENSORS,
    Angle,
    Coordinate,
    Distance,
    Gap,
    Height,
    KindName,
    Name,
    Offset,
    Speed,
    Time,
)


def _is_in_catalogue(value: str) -> str:
    if value not in CATALOGUE:
        raise ValueError(f"{value!r} is not in the catalogue ({', '.join(CATALOGUE)})")
    return value


CatalogueName = Annotated[str, AfterValidator(_is_in_catalogue)]
Side = Literal[
    "front", "rear", "left", "right", "wing_front_left", "wing_front_right", "wing_rear_left", "wing_rear_right",
    "wing_left", "wing_right", "wheel_front_left", "wheel_front_right", "wheel_rear_left", "wheel_rear_right",
]  # fmt: skip


class PathPlace(Config):
    """On the planned path: `ahead_m` of the leading end of the machine, or at a distance `path_m` along the plan.

    `left_m` and `heading_deg` (0: as the machine drives there) are relative to the direction of travel.
    """

    frame: Literal["path"]
    ahead_m: Offset | None = None
    path_m: Distance | None = None
    left_m: Offset = (0.0, 0.0)
    heading_deg: Angle = (0.0, 0.0)

    @model_validator(mode="after")
    def _has_one_position(self) -> Self:
        if (self.ahead_m is None) == (self.path_m is None):
            raise ValueError("needs either ahead_m or path_m")
        return self


class MapPlace(Config):
    """In `map`; heading counter-clockwise from east."""

    frame: Literal["map"]
    x_m: Coordinate
    y_m: Coordinate
    heading_deg: Angle = (0.0, 0.0)


class OutlinePlace(Config):
    """Beside the outline of machine and implement, at a horizontal gap between the bodies.

    `along_m` is from the middle of this side, forward (left and right sides) or to the left (front and rear);
    `heading_deg` is relative to the machine.
    """

    frame: Literal["outline"]
    side: Side
    gap_m: Gap
    along_m: Offset = (0.0, 0.0)
    heading_deg: Angle = (0.0, 0.0)


class ObjectPlace(Config):
    """Relative to another object: ahead and left of its origin, heading relative to its heading."""

    frame: Literal["object"]
    of: Name
    ahead_m: Offset = (0.0, 0.0)
    left_m: Offset = (0.0, 0.0)
    heading_deg: Angle = (0.0, 0.0)


Place = Annotated[PathPlace | MapPlace | OutlinePlace | ObjectPlace, Field(discriminator="frame")]


class When(Config):
    """One condition, and a delay after it is first met.

    `at_s`: time of the run. `phase`: the machine enters it. `path_m`: the machine has come so far along the plan.
    `near_m`: its outline is so close to the object. `meets`: the named object is within `within_m` of this one.
    """

    at_s: Time | None = None
    phase: PhaseName | None = None
    path_m: Distance | None = None
    near_m: Distance | None = None
    meets: Name | None = None
    within_m: Distance = (1.0, 1.0)
    after_s: Time = (0.0, 0.0)

    @model_validator(mode="after")
    def _has_one_condition(self) -> Self:
        given = [key for key in ("at_s", "phase", "path_m", "near_m", "meets") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"needs one of at_s, phase, path_m, near_m, meets; has {', '.join(given) or 'none'}")
        return self


class _Behaviour(Config):
    when: When | None = Field(default=None, description="start of the motion; default: with the appearance")


class Stand(_Behaviour):
    """Stays where it is."""

    kind: Literal["stand"]


class LieDown(_Behaviour):
    """Changes its posture, and stays."""

    kind: Literal["lie_down"]
    posture: Literal["lying_along", "lying_across", "lying_curled", "sitting", "crouching"] = "lying_along"
    over_s: Time = (1.0, 1.0)


class Cross(_Behaviour):
    """Goes straight ahead without halting over `distance_m`, or to another object, and stays there."""

    kind: Literal["cross", "run", "step_out"]
    speed_mps: Speed
    distance_m: Distance | None = None
    to: Name | None = None
    near_m: Distance | None = Field(default=None, description="step_out: distance of the machine at which it starts")

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if (self.distance_m is None) == (self.to is None):
            raise ValueError("needs either distance_m or to")
        if (self.kind == "step_out") != (self.near_m is not None):
            raise ValueError("near_m belongs to step_out" if self.near_m is not None else "step_out needs near_m")
        if self.kind == "step_out" and self.when is not None:
            raise ValueError("step_out starts at near_m; it has no when")
        return self


class Accompany(_Behaviour):
    """Moves towards a place beside the outline and keeps it as the machine moves, no faster than its speed.

    `follow` and `stay_in_blind_zone` need and keep `gap_m`; `approach` closes it (default 0: contact).
    """

    kind: Literal["follow", "approach", "stay_in_blind_zone"]
    side: Side = "rear"
    gap_m: Gap = (0.0, 0.0)
    along_m: Offset = (0.0, 0.0)
    speed_mps: Speed

    @model_validator(mode="after")
    def _keeps_its_gap(self) -> Self:
        if self.kind != "approach" and "gap_m" not in self.model_fields_set:
            raise ValueError(f"{self.kind} needs gap_m")
        return self


Behaviour = Annotated[Stand | LieDown | Cross | Accompany, Field(discriminator="kind")]


class ScenarioObject(Config):
    """One object of the catalogue: where and when it appears, and what it then does."""

    name: Name
    object: CatalogueName
    posture: str | None = Field(default=None, description="default: the first of the catalogue")
    height_m: Height | None = Field(default=None, description="default: usual range of the catalogue")
    place: Place
    when: When = When(at_s=(0.0, 0.0))
    behaviour: Behaviour = Stand(kind="stand")
    must_avoid: bool | None = Field(default=None, description="default: of the catalogue")
    expected_stops: int = Field(default=0, ge=0, le=1, description="stops that it must cause")
    visible_to: tuple[KindName, ...] = Field(default=ALL_SENSORS, description="kinds of sensors that detect it")

    @model_validator(mode="after")
    def _fits_the_catalogue(self) -> Self:
        entry = CATALOGUE[self.object]
        if self.posture is not None and self.posture not in entry.postures:
            raise ValueError(f"posture {self.posture!r}: {self.object} has {', '.join(entry.postures)}")
        low, high = self.height_m or entry.usual_m
        if low < entry.height_m[0] or high > entry.height_m[1]:
            between = f"{entry.height_m[0]:g} to {entry.height_m[1]:g}"
            raise ValueError(f"height_m {low:g} to {high:g}: {self.object} is {between} m high")
        if isinstance(self.behaviour, LieDown) and entry.postures != PERSON_POSTURES:
            raise ValueError(f"behaviour lie_down: {self.object} cannot; only adult and child can")
        if isinstance(self.behaviour, (Cross, Accompany)) and entry.walk_mps == 0.0:
            raise ValueError(f"behaviour {self.behaviour.kind}: {self.object} does not move")
        if self.when.near_m is not None or self.when.meets is not None:
            raise ValueError("when near_m or meets: only a behaviour can wait for it, the object is not there before")
        return self

    @property
    def references(self) -> tuple[str, ...]:
        """Names of the objects that this one refers to."""
        place, behaviour = self.place, self.behaviour
        names = [place.of if isinstance(place, ObjectPlace) else None, getattr(behaviour, "to", None)]
        return tuple(n for n in [*names, behaviour.when.meets if behaviour.when else None] if n is not None)


def check_objects(objects: tuple[ScenarioObject, ...], taken: tuple[str, ...]) -> tuple[ScenarioObject, ...]:
    """Names are unique and refer to objects of the scenario, places to earlier ones; raises ValueError."""
    known: list[str] = list(taken)
    every = [one.name for one in objects]
    for one in objects:
        if one.name in known:
            raise ValueError(f"name {one.name!r} is not unique")
        if isinstance(one.place, ObjectPlace) and one.place.of not in known[len(taken) :]:
            raise ValueError(f"{one.name}.place.of = {one.place.of!r}: no earlier object has this name")
        for name in one.references:
            if name not in every or name == one.name:
                raise ValueError(f"{one.name}: {name!r} is no other object of this scenario")
        known.append(one.name)
    return objects
