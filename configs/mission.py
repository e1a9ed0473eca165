"""Mission: field work or a line, machine, implement and docking."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from configs.site import Coordinate, PoseConfig
from configs.strict import Config
from configs.vehicle import Kmh


class EdgeMargin(Config):
    """Margin along a part of the outline of the field, the shorter way between the points of it nearest to two."""

    from_m: tuple[Coordinate, Coordinate] = Field(description="point in `map`")
    to_m: tuple[Coordinate, Coordinate] = Field(description="point in `map`")
    margin_m: float = Field(ge=0.0, le=50.0, description="between the swept area and this part, if more than elsewhere")
    reason: str = Field(min_length=1, max_length=40, description="what is there, as hedge, ditch, road")


class Refill(Config):
    """Drives to a place at the edge, where the machine waits for an order before it goes on."""

    at_m: tuple[Coordinate, Coordinate] = Field(description="point in `map`: the place is at the edge next to it")
    every_m2: float = Field(gt=0.0, le=1e7, description="worked area after which the rig has driven there, at most")
    reason: str = Field(default="seed", min_length=1, max_length=40, description="what is refilled")


class Work(Config):
    """Field work."""

    headland_passes: int = Field(ge=1, le=10)
    headland: Literal["first", "last", "none"] = Field(
        default="first",
        description="headland passes before or after the swaths; none: no passes, swaths to the edge with "
        "`turns: reverse`, else up to where the passes would be",
    )
    swath_direction_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None
    swath_through_m: Annotated[
        tuple[Coordinate, Coordinate] | None,
        Field(description="point in `map`: swaths lie at whole spacings from the line through it, in that direction"),
    ] = None
    guidance: str | None = Field(
        default=None,
        description="name or number of a line of the field file, to which swaths are parallel: sets direction and "
        "point, or curve or circle",
    )
    swath_curve_m: Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(max_length=100_000)] = Field(
        default=(), description="points in `map` of an adaptive curve: swaths lie at whole spacings from it"
    )
    swath_circle_m: tuple[Coordinate, Coordinate, Annotated[float, Field(gt=0.0, le=5000.0)]] | None = Field(
        default=None, description="centre in `map` and radius of a circle: swaths lie at whole spacings from it"
    )
    swaths_from_m: tuple[Coordinate, Coordinate] | None = Field(
        default=None, description="point in `map`: the outermost swath next to it is worked first"
    )
    swath_skip: Annotated[int, Field(ge=0, le=9)] | None = Field(
        default=None,
        description="swaths left out between two that are worked one after the other, and worked on the way back; "
        "default: the order of least time",
    )
    refill: Refill | None = Field(default=None, description="stops at a place at the edge for refilling")
    no_go_m: tuple[Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(min_length=3, max_length=500)], ...] = (
        Field(default=(), max_length=100, description="areas to keep out of, besides those of the field file, in `map`")
    )
    gate_m: tuple[Coordinate, Coordinate] | None = Field(
        default=None,
        description="point in `map`: the gate of the site next to it, or on the edge of the field file next to it",
    )
    lane_m: Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(max_length=100)] = Field(
        default=(), description="points in `map` from the edge of the field file, where the gate is, to the yard"
    )
    overlap_m: float = Field(ge=0.0, le=2.0)
    work_speed_kmh: Kmh
    turn_speed_kmh: Kmh
    lane_speed_kmh: Kmh
    boundary_margin_m: float = Field(ge=0.0, le=5.0, description="between the swept area and the field edge")
    margins: Annotated[tuple[EdgeMargin, ...], Field(max_length=100)] = Field(
        default=(), description="larger margins along parts of the outline"
    )
    least_planned_share: float = Field(default=0.95, ge=0.0, le=1.0, description="`plan` returns 1 below it")
    turns: Literal["forward", "reverse"] = Field(
        default="forward", description="reverse: turns may reverse with the lifted implement, and corners are filled"
    )

    @model_validator(mode="after")
    def _check_lines(self) -> "Work":
        if self.swath_through_m is not None and self.swath_direction_deg is None:
            raise ValueError("swath_through_m: needs swath_direction_deg")
        if self.lane_m and (len(self.lane_m) < 2 or self.gate_m is not None):
            raise ValueError("lane_m: has two points at least, and no gate_m: the gate is where it leaves the field")
        lines = [self.swath_direction_deg is not None, bool(self.swath_curve_m), self.swath_circle_m is not None]
        if sum(lines) > 1:
            raise ValueError("swath_direction_deg, swath_curve_m, swath_circle_m: give one of them")
        if len(self.swath_curve_m) == 1:
            raise ValueError("swath_curve_m: has two points at least")
        if self.guidance is not None and self.swath_direction_deg is not None and self.swath_through_m is None:
            raise ValueError("guidance: gives the direction; leave out swath_direction_deg")
        return self


class Consent(Config):
    """Consent of a person to work where plants hide whoever lies there; they keep the field free of people."""

    by: str = Field(min_length=1, max_length=80, description="name of the person")
    vegetation_m: float = Field(
        ge=0.1,
        le=0.35,
        description="height of the plants up to which it holds; beyond 0.35 m the machine does not work",
    )


class Spread(Config):
    """Maximum deviation of a start pose drawn by the seed."""

    distance_m: float = Field(ge=0.0, le=50.0)
    heading_deg: float = Field(ge=0.0, le=180.0)


class Leg(Config):
    """Part of a line: an arc of constant curvature (left positive, of the forward motion)."""

    section: Literal["swath", "headland", "lane", "turn"] = "swath"
    length_m: float = Field(gt=0.5, le=500.0)
    curvature_radpm: float = Field(default=0.0, ge=-0.3, le=0.3)
    is_working: bool = False
    is_reverse: bool = False


class Line(Config):
    """Legs that are driven one after the other, without coverage planning; top speed forward and in reverse."""

    speed_kmh: Kmh
    reverse_kmh: Kmh = 3.0
    legs: tuple[Leg, ...] = Field(min_length=1)


class Mission(Config):
    """Mission by the names of its parts in `configs/`; with `bay` it starts and ends docked there.

    `start` sets another start pose with the implement unfolded, drawn by the seed within `spread`. A mission has field
    `work`, or only drives a `line` from its `start`, or is docking only. Without `consent` the machine stops in plants
    that hide a person who lies.
    """

    name: str
    site: str
    machine: str
    implement: str
    work: Work | None = None
    line: Line | None = None
    bay: str | None = None
    start: PoseConfig | None = None
    spread: Spread | None = None
    consent: Consent | None = None

    @model_validator(mode="after")
    def _check_tasks(self) -> "Mission":
        if self.line is not None and (self.work is not None or self.bay is not None or self.start is None):
            raise ValueError("line: a mission with a line needs a start, and has neither work nor a bay")
        if self.work is None and self.line is None and (self.bay is None or self.start is None):
            raise ValueError("a mission without work or a line needs a bay to dock in and a start")
        if self.work is not None and self.start is not None:
            raise ValueError("start: a mission with work starts docked or at the start of its site")
        return self
