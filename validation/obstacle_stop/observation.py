"""Data gathered from a replay: motion, true objects, stop requests, and observations of each true object by scan."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float64
from validation.obstacle_stop.recorded_motion import OdometryHistory, RecordedMotion
from validation.obstacle_stop.structure import Structure
from validation.obstacle_stop.swept_path import Outline
from validation.obstacle_stop.true_tracks import TrueTrack
from validation.obstacle_stop.visibility import View

NO_CLEARANCE = float("inf")


@dataclass(frozen=True, eq=False)
class Setting:
    """Geometry of the recording vehicle and frame of the truth.

    `T_base_lidar` by lidar name; `truth_frame` is `map` (by the true machine pose) or a lidar name; `view_rad` is the
    labelled half angle about the x axis of that lidar, π without limit. `half_width_m` is that of the corridor of the
    stack; `working` and `transport` outlines decide contact. `views` are those of the obstacle sensors. `is_manual`: a
    person drove.
    """

    log: str
    T_base_lidar: dict[str, Float64]
    front_m: float
    width_m: float
    half_width_m: float
    truth_frame: str | None
    view_rad: float
    working: Outline
    transport: Outline
    views: tuple[View, ...]
    is_manual: bool

    @property
    def side_margin_m(self) -> float:
        """Margin of the corridor beside the widest body."""
        bodies = [*self.working.bodies, *([] if self.working.trailer is None else [self.working.trailer.body])]
        return max(0.0, self.half_width_m - max(body.half_width_m for body in bodies))


@dataclass(frozen=True)
class Scene:
    """Data of one figure, in base: returns (N, 2), corridor ring, true boxes, triggering points."""

    t_s: float
    points_m: Float64
    corridor_m: Float64
    boxes: tuple[tuple[str, Float64], ...]
    hits_m: Float64


@dataclass(frozen=True, slots=True)
class ObjectObservation:
    """One true object in one scan.

    `returns` in its box; `front_distance_m` is the horizontal distance from the vehicle front, `bearing_rad` the
    direction of the box centre from there. `is_detected`: clusters hold half of the returns; `is_detected_strictly`:
    one cluster does, and half of that cluster lies at the box.
    """

    id: int
    label: str
    role: str
    stamp_ns: int
    returns: int
    front_distance_m: float
    bearing_rad: float
    is_detected: bool
    is_detected_strictly: bool


@dataclass
class ObservedObject:
    """All observations of one true object as columns; iteration gives them in their order."""

    id: int
    label: str
    role: str
    integers: "array[int]" = field(default_factory=lambda: array("q"))  # stamp, returns, detected, detected strictly
    values: "array[float]" = field(default_factory=lambda: array("d"))  # distance, bearing

    def add(self, one: ObjectObservation) -> None:
        """Appends an observation."""
        self.integers.extend((one.stamp_ns, one.returns, one.is_detected, one.is_detected_strictly))
        self.values.extend((one.front_distance_m, one.bearing_rad))

    def __iter__(self) -> Iterator[ObjectObservation]:
        for k in range(len(self.values) // 2):
            stamp_ns, returns, is_detected, is_strict = self.integers[4 * k : 4 * k + 4]
            distance, bearing = self.values[2 * k : 2 * k + 2]
            yield ObjectObservation(
                self.id, self.label, self.role, stamp_ns, returns, distance, bearing, bool(is_detected), bool(is_strict)
            )


@dataclass(frozen=True, slots=True)
class StopRequest:
    """Output of the supervisor, delivered at `receive_ns`; `limit_mps` is the requested speed (infinite: no request).

    `touched` are ids of true objects at any triggering point, `cause` those at the nearest ones. `is_false`: truth is
    complete at the nearest ones and no true object is there; None where truth does not decide it.
    """

    receive_ns: int
    stamp_ns: int
    reason: str
    label: str
    clearance_m: float
    limit_mps: float
    is_stop: bool
    touched: tuple[int, ...]
    cause: tuple[int, ...]
    is_false: bool | None
    hit_odom_m: Float64 | None

    @property
    def is_braking(self) -> bool:
        """Whether less speed is requested."""
        return bool(np.isfinite(self.limit_mps))


@dataclass(frozen=True)
class TrackObservation:
    """One track in the corridor at one time, for logs without truth."""

    id: int
    label: str
    stamp_ns: int
    clearance_m: float
    is_confirmed: bool


@dataclass
class LogObservation:
    """Input of the evaluation; times are stamps, `first_ns` to `last_ns` the evaluated interval.

    `observations` by object id (recall), `true_tracks` by object id, `requests` by delivery. By object id too:
    `countable_ns` is the first scan with enough returns, `confirmed_ns` the receive time of the first confirmed track.
    """

    setting: Setting
    motion: OdometryHistory = field(default_factory=OdometryHistory)
    recorded: RecordedMotion | None = None
    true_tracks: dict[int, TrueTrack] = field(default_factory=dict)
    requests: list[StopRequest] = field(default_factory=list)
    structure: Structure = field(default_factory=Structure)
    observations: dict[int, ObservedObject] = field(default_factory=dict)
    tracks: dict[int, list[TrackObservation]] = field(default_factory=dict)
    truth_ns: "array[int]" = field(default_factory=lambda: array("q"))
    box_faults: dict[int, str] = field(default_factory=dict)
    scans: list[int] = field(default_factory=list)
    evaluated_scans: int = 0
    first_ns: int = 0
    last_ns: int = 0
    scenes: dict[tuple[int, str], Scene] = field(default_factory=dict)
    countable_ns: dict[int, int] = field(default_factory=dict)
    confirmed_ns: dict[int, int] = field(default_factory=dict)

    @property
    def driven_m(self) -> float:
        """Distance driven."""
        return 0.0 if self.recorded is None else float(self.recorded.s_m[-1])

    @property
    def period_s(self) -> float:
        """Median scan period (s)."""
        stamps = sorted(set(self.scans))
        return float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.1

    def time_s(self, stamp_ns: int) -> float:
        """Seconds since the first scan."""
        return (stamp_ns - self.first_ns) * 1e-9
