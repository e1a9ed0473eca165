"""Data gathered from a replay: observations of each true object by scan, stop requests, odometry."""

import math
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float64
from geometry.transforms import yaw_of

NO_CLEARANCE = float("inf")
STANDSTILL_MPS = 0.1


@dataclass(frozen=True, eq=False)
class Setting:
    """Geometry of the recording vehicle and frame of the truth.

    `T_base_lidar` by lidar name; `truth_frame` is `map` (by the true machine pose) or a lidar name; `view_rad` is the
    labelled half angle about the x axis of that lidar, π without limit; `half_width_m` is that of the corridor.
    """

    log: str
    T_base_lidar: dict[str, Float64]
    front_m: float
    width_m: float
    half_width_m: float
    truth_frame: str | None
    view_rad: float


@dataclass(frozen=True)
class Scene:
    """Data of one figure, in base: returns (N, 2), corridor ring, true boxes, triggering points."""

    t_s: float
    points_m: Float64
    corridor_m: Float64
    boxes: tuple[tuple[str, Float64], ...]
    hits_m: Float64


@dataclass(frozen=True)
class ObjectObservation:
    """One true object in one scan.

    `returns` in its box, `above_ground` those above the ground margin, `in_corridor` those of them in the corridor;
    `clearance_m` to the nearest of these, `box_clearance_m` to the box (infinite: not in the corridor).
    `beams_through` end behind the box, `beams_before` in front of it. `front_distance_m` is the horizontal distance
    from the vehicle front, `bearing_rad` the direction of the box centre from there. `is_detected`: clusters hold half
    of the returns; `is_detected_strictly`: one cluster does, and half of that cluster lies at the box.
    """

    id: int
    label: str
    role: str
    stamp_ns: int
    returns: int
    above_ground: int
    in_corridor: int
    clearance_m: float
    box_clearance_m: float
    beams_through: int
    beams_before: int
    front_distance_m: float
    bearing_rad: float
    is_detected: bool
    is_detected_strictly: bool
    center_odom_m: Float64


@dataclass(frozen=True)
class StopRequest:
    """Output of the supervisor at one time; `is_braking`: less speed requested, `is_stop`: standstill requested.

    `touched` are ids of true objects at the triggering points; `has_no_true_cause`: triggering points lie where truth
    is complete, and no true object is there.
    """

    stamp_ns: int
    reason: str
    clearance_m: float
    allowance_m: float
    is_braking: bool
    is_stop: bool
    touched: tuple[int, ...]
    has_no_true_cause: bool
    hit_odom_m: Float64 | None
    label: str


@dataclass(frozen=True)
class TrackObservation:
    """One track in the corridor at one time, for logs without truth."""

    id: int
    label: str
    stamp_ns: int
    clearance_m: float
    is_confirmed: bool


@dataclass
class OdometryHistory:
    """Odometry as columns, looked up by time."""

    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Float64] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    turns_radps: list[float] = field(default_factory=list)
    sigmas_mps: list[float] = field(default_factory=list)

    def add(self, stamp_ns: int, T_odom_base: Float64, speed_mps: float, turn_radps: float, variance: float) -> None:
        """Appends a sample; a stamp that does not increase is ignored."""
        if self.stamps_ns and stamp_ns <= self.stamps_ns[-1]:
            return
        self.stamps_ns.append(stamp_ns)
        self.poses.append(np.array([T_odom_base[0, 3], T_odom_base[1, 3], yaw_of(T_odom_base)]))
        self.speeds_mps.append(speed_mps)
        self.turns_radps.append(turn_radps)
        self.sigmas_mps.append(math.sqrt(variance) if variance > 0.0 else 0.0)

    def index(self, stamp_ns: int) -> int | None:
        """Index of the nearest sample within 0.2 s, or None."""
        if not self.stamps_ns:
            return None
        stamps = self.stamps_ns
        k = int(np.searchsorted(stamps, stamp_ns)) if stamp_ns <= stamps[-1] else len(stamps)
        best = min((j for j in (k - 1, k) if 0 <= j < len(stamps)), key=lambda j: abs(stamps[j] - stamp_ns))
        return best if abs(stamps[best] - stamp_ns) <= 200_000_000 else None

    def speed_at(self, stamp_ns: int) -> float:
        """Forward speed (m/s) at a time; 0 when unknown."""
        k = self.index(stamp_ns)
        return 0.0 if k is None else self.speeds_mps[k]

    def max_speed_at(self, stamp_ns: int) -> float:
        """Upper speed (m/s) at a time: measured plus one standard deviation, 0 when unknown."""
        k = self.index(stamp_ns)
        return (
            0.0
            if k is None
            else abs(self.speeds_mps[k]) + (self.sigmas_mps[k] if abs(self.speeds_mps[k]) > STANDSTILL_MPS else 0.0)
        )


@dataclass
class LogObservation:
    """Input of the evaluation; times are stamps, `first_ns` to `last_ns` the evaluated interval.

    By object id: `countable_ns` is the first scan with enough returns, `confirmed_ns` the receive time of the first
    confirmed track there.
    """

    observations: dict[int, list[ObjectObservation]] = field(default_factory=dict)
    requests: list[StopRequest] = field(default_factory=list)
    tracks: dict[int, list[TrackObservation]] = field(default_factory=dict)
    motion: OdometryHistory = field(default_factory=OdometryHistory)
    scans: list[int] = field(default_factory=list)
    evaluated_scans: int = 0
    first_ns: int = 0
    last_ns: int = 0
    scenes: dict[tuple[int, str], Scene] = field(default_factory=dict)
    driven_m: float = 0.0
    countable_ns: dict[int, int] = field(default_factory=dict)
    confirmed_ns: dict[int, int] = field(default_factory=dict)

    @property
    def period_s(self) -> float:
        """Median scan period (s)."""
        stamps = sorted(set(self.scans))
        return float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.1

    def time_s(self, stamp_ns: int) -> float:
        """Seconds since the first scan."""
        return (stamp_ns - self.first_ns) * 1e-9
