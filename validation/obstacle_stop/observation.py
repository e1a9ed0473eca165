"""What is gathered from a replay: how each true object was seen at each scan, and what the supervisor asked for."""

import math
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float64
from geometry.transforms import yaw_of

NO_GAP = float("inf")
STILL_MPS = 0.1


@dataclass(frozen=True, eq=False)
class Setting:
    """What the judge must know of who recorded the log.

    `T_base_lidar` by the lidar's name; `truth_frame` is `map` (by the true machine's pose) or a lidar's name;
    `view_rad` is the labelled half angle about straight ahead of that lidar, π without limit; `width_m` the machine's.
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
    """A picture of one moment, in base: some returns (N, 2), the tube's ring, true boxes, hits."""

    t_s: float
    points_m: Float64
    tube_m: Float64
    boxes: tuple[tuple[str, Float64], ...]
    hits_m: Float64


@dataclass(frozen=True)
class Sighting:
    """One true object in one scan.

    `returns` in its box, `solid` of them off its foot, `inside` of these in the tube; `clearance_m` to the nearest of
    these, `box_gap_m` to the box itself (infinite: not in the tube). Beams that go on behind it are `through`, those
    that end before it `before`. `edge_m` is the level distance from the vehicle's front, `bearing_rad` where its
    middle is seen from there; `is_seen`: clusters hold half of the box's returns; `is_strict`: one does, and half of
    that cluster lies about the box.
    """

    id: int
    label: str
    role: str
    stamp_ns: int
    returns: int
    solid: int
    inside: int
    clearance_m: float
    box_gap_m: float
    through: int
    before: int
    edge_m: float
    bearing_rad: float
    is_seen: bool
    is_strict: bool
    center_odom_m: Float64


@dataclass(frozen=True)
class Asked:
    """What the supervisor said at one moment; `is_braking` when it asked for less speed, `is_stop` when for none.

    `touched` are ids of true objects at the points that caused it; `lonely` says that causes were where truth is
    complete and no true object stood there.
    """

    stamp_ns: int
    reason: str
    clearance_m: float
    allowance_m: float
    is_braking: bool
    is_stop: bool
    touched: tuple[int, ...]
    lonely: bool
    hit_odom_m: Float64 | None
    label: str


@dataclass(frozen=True)
class Seen:
    """One perceived obstacle in the tube, for logs without truth: a track with its gap and class."""

    id: int
    label: str
    stamp_ns: int
    clearance_m: float
    is_confirmed: bool


@dataclass
class Motion:
    """Odometry as columns, found by time."""

    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Float64] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    turns_radps: list[float] = field(default_factory=list)
    sigmas_mps: list[float] = field(default_factory=list)

    def add(self, stamp_ns: int, T_odom_base: Float64, speed_mps: float, turn_radps: float, variance: float) -> None:
        """Take the next; one whose stamp does not rise is left out."""
        if self.stamps_ns and stamp_ns <= self.stamps_ns[-1]:
            return
        self.stamps_ns.append(stamp_ns)
        self.poses.append(np.array([T_odom_base[0, 3], T_odom_base[1, 3], yaw_of(T_odom_base)]))
        self.speeds_mps.append(speed_mps)
        self.turns_radps.append(turn_radps)
        self.sigmas_mps.append(math.sqrt(variance) if variance > 0.0 else 0.0)

    def index(self, stamp_ns: int) -> int | None:
        """The nearest in time within 0.2 s, or None."""
        if not self.stamps_ns:
            return None
        stamps = self.stamps_ns
        k = int(np.searchsorted(stamps, stamp_ns)) if stamp_ns <= stamps[-1] else len(stamps)
        best = min((j for j in (k - 1, k) if 0 <= j < len(stamps)), key=lambda j: abs(stamps[j] - stamp_ns))
        return best if abs(stamps[best] - stamp_ns) <= 200_000_000 else None

    def speed_at(self, stamp_ns: int) -> float:
        """Forward speed at a time; 0 when not known."""
        k = self.index(stamp_ns)
        return 0.0 if k is None else self.speeds_mps[k]

    def fastest_at(self, stamp_ns: int) -> float:
        """How fast it may have been at a time: one standard deviation above what was measured, 0 when not known."""
        k = self.index(stamp_ns)
        return (
            0.0
            if k is None
            else abs(self.speeds_mps[k]) + (self.sigmas_mps[k] if abs(self.speeds_mps[k]) > STILL_MPS else 0.0)
        )


@dataclass
class Observation:
    """All of a log that the judgement rests on; times are stamps, `first_ns` to `last_ns` those judged.

    `countable_ns`: by object the first scan with enough returns; `confirmed_ns`: when a confirmed track there was told.
    """

    sightings: dict[int, list[Sighting]] = field(default_factory=dict)
    asked: list[Asked] = field(default_factory=list)
    seen: dict[int, list[Seen]] = field(default_factory=dict)
    motion: Motion = field(default_factory=Motion)
    scans: list[int] = field(default_factory=list)
    judged_scans: int = 0
    first_ns: int = 0
    last_ns: int = 0
    scenes: dict[tuple[int, str], Scene] = field(default_factory=dict)
    driven_m: float = 0.0
    countable_ns: dict[int, int] = field(default_factory=dict)
    confirmed_ns: dict[int, int] = field(default_factory=dict)

    @property
    def period_s(self) -> float:
        """Usual time from scan to scan."""
        stamps = sorted(set(self.scans))
        return float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.1

    def time_s(self, stamp_ns: int) -> float:
        """Seconds since the first scan."""
        return (stamp_ns - self.first_ns) * 1e-9
