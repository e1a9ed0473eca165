"""Truth of a drive as plain numbers: motion of the machine, shapes of its parts, objects over time."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from geometry.arrays import Bool, Float64
from geometry.pose2 import Pose2
from geometry.prism import Nearest, Solids, nearest

STANDING_MPS, STANDING_PTO_RADPS = 0.02, 0.5
STANDING_HITCH_PER_S, STANDING_FOLD_PER_S = 0.01, 0.005
REACH_M = 8.0  # around base, for static solids


def last_index(times_s: Float64, t_s: float) -> int:
    """Index of the last of sorted times at or before a time; the first one where there is none."""
    return max(0, int(np.searchsorted(times_s, t_s + 1e-9, side="right")) - 1)


@dataclass(frozen=True, eq=False)
class Shapes:
    """Parts of the machine in `base`, and of the lowered implement about its origin at `origin_m` on x of base.

    `lift_m` is the stroke of the hitch; `width_m` the implement's width unfolded and folded; what of it lies beyond
    `machine_width_m` is a wing.
    """

    machine: Solids
    implement: Solids
    machine_width_m: float
    origin_m: float = 0.0
    lift_m: float = 0.6
    width_m: tuple[float, float] = (6.0, 6.0)


@dataclass(frozen=True)
class MachineState:
    """Machine at one instant: pose of base, tilt (slopes of its x and y axes), implement."""

    t_s: float
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float
    slope: tuple[float, float]
    implement_yaw_rad: float
    hitch: float
    fold: float

    @property
    def pose(self) -> Pose2:
        """Level pose of base in `map`."""
        return Pose2(self.x_m, self.y_m, self.yaw_rad)


@dataclass(frozen=True, eq=False)
class MachineTrack:
    """Motion over K moments: `pose` (K, 4) x, y, z, unwrapped yaw of base; signed speed; slopes (K, 2); implement."""

    t_s: Float64
    pose: Float64
    speed_mps: Float64
    slope: Float64
    implement_yaw_rad: Float64
    hitch: Float64
    fold: Float64
    pto_radps: Float64

    @cached_property
    def is_moving(self) -> Bool:
        """Mask (K,): wheels, hitch, wings or PTO move."""
        gap = np.gradient(self.t_s) if len(self.t_s) > 1 else np.ones(1)
        change = [
            np.abs(np.gradient(one)) / gap if len(self.t_s) > 1 else np.zeros(1) for one in (self.hitch, self.fold)
        ]
        return np.asarray(self.is_driving | self.is_running | (change[0] > STANDING_HITCH_PER_S)
                          | (change[1] > STANDING_FOLD_PER_S))  # fmt: skip

    @cached_property
    def is_driving(self) -> Bool:
        """Mask (K,): the wheels turn."""
        return np.asarray(np.abs(self.speed_mps) > STANDING_MPS)

    @cached_property
    def is_running(self) -> Bool:
        """Mask (K,): the PTO turns."""
        return np.asarray(np.abs(self.pto_radps) > STANDING_PTO_RADPS)

    @cached_property
    def path_m(self) -> Float64:
        """Distance driven (K,), always increasing."""
        steps = np.hypot(*np.diff(self.pose[:, :2], axis=0).T) if len(self.t_s) > 1 else np.zeros(0)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def index(self, t_s: float) -> int:
        """Index of the last moment at or before a time."""
        return last_index(self.t_s, t_s)

    def at(self, t_s: float) -> MachineState:
        """State at a time, interpolated."""
        k = self.index(t_s)
        n = min(k + 1, len(self.t_s) - 1)
        gap = self.t_s[n] - self.t_s[k]
        rate = float(self.pose[n, 3] - self.pose[k, 3]) / gap if gap > 0.0 else 0.0

        def value(column: Float64) -> float:
            return float(np.interp(t_s, self.t_s[[k, n]], column[[k, n]])) if n > k else float(column[k])

        x, y, z, yaw = (value(self.pose[:, c]) for c in range(4))
        return MachineState(
            t_s, x, y, z, yaw, value(self.speed_mps), rate, (value(self.slope[:, 0]), value(self.slope[:, 1])),
            value(self.implement_yaw_rad), value(self.hitch), value(self.fold),
        )  # fmt: skip

    def set_off_s(self, t_s: float) -> float:
        """Time at which the drive that is under way at `t_s` began: the last time that the wheels stood before.

        While they stand, the last time that no part moved.
        """
        k = self.index(t_s)
        moves = self.is_driving if self.is_driving[k] else self.is_moving
        stood = np.flatnonzero(~moves[: k + 1])
        return float(self.t_s[stood[-1]]) if len(stood) else float(self.t_s[0])


@dataclass(frozen=True, eq=False)
class ObjectTrack:
    """One object over N moments: place (N, 2), velocity (N, 2) and shape in `map` (N solids); N is 1 for static ones.

    `is_static`: part of the site. Outside of the moments it is absent, unless static.
    """

    name: str
    kind: str
    t_s: Float64
    place_m: Float64
    velocity_mps: Float64
    shapes: tuple[Solids, ...]
    must_avoid: bool = True
    is_static: bool = False

    @property
    def moves(self) -> bool:
        """Whether it ever moves."""
        return bool((np.hypot(*self.velocity_mps.T) > 0.1).any())

    def is_present(self, t_s: float) -> bool:
        """Whether it exists at a time."""
        return self.is_static or self.t_s[0] - 1e-6 <= t_s <= self.t_s[-1] + 0.11

    def index(self, t_s: float) -> int:
        """Index of the last moment at or before a time."""
        return last_index(self.t_s, t_s)

    def velocity_at(self, t_s: float) -> Float64:
        """Velocity (2,)."""
        return np.asarray(self.velocity_mps[self.index(t_s)])

    def shape_at(self, t_s: float, ahead_s: float = 0.0) -> Solids:
        """Solids in `map` at a time, or `ahead_s` later at the velocity that it has then."""
        k = self.index(t_s)
        since = (0.0 if self.is_static else max(0.0, t_s - float(self.t_s[k]))) + ahead_s
        dx, dy = (self.velocity_mps[k] * since).tolist()
        return self.shapes[k] if dx == dy == 0.0 else self.shapes[k].moved(dx, dy, 0.0)

    def top_and_width_m(self, ground_m: float) -> tuple[float, float]:
        """Height of the top above the ground, and the middle one of its three extents, over its first shape."""
        one = self.shapes[0]
        corners = shapely.get_coordinates(shapely.union_all(list(one.polygons)).minimum_rotated_rectangle)
        sides = [float(np.hypot(*(corners[k + 1] - corners[k]))) for k in (0, 1)]
        low, high = float(one.z_m[:, 0].min()), float(one.z_m[:, 1].max())
        return high - ground_m, sorted([*sides, high - low])[1]


@dataclass(frozen=True, eq=False)
class Drive:
    """Truth of one drive."""

    machine: MachineTrack
    shapes: Shapes
    objects: tuple[ObjectTrack, ...]

    def body_at(self, state: MachineState) -> Solids:
        """Machine and implement in `base`, heights in `map`."""
        s = self.shapes
        own = _tilted(s.machine, state)
        width = ((1.0 - state.fold) * s.width_m[0] + state.fold * s.width_m[1]) / s.width_m[0]
        tool = s.implement if width == 1.0 else s.implement.scaled(width)
        turn = state.implement_yaw_rad - state.yaw_rad
        if s.origin_m or abs(turn) > 1e-6:
            tool = tool.moved(s.origin_m, 0.0, turn)
        lift = np.array([s.lift_m * state.hitch * (name == "implement") for name in tool.names])
        tool = _tilted(Solids(tool.polygons, tool.z_m + lift[:, None], tool.names), state)
        return Solids(np.concatenate([own.polygons, tool.polygons]), np.vstack([own.z_m, tool.z_m]),
                      own.names + tool.names)  # fmt: skip

    def gap(self, state: MachineState, shape: Solids, only_implement: bool = False) -> Nearest:
        """Distance of solids in `map` from the machine, its part, and the place in `base` (heights in `map`)."""
        body = self.body_at(state)
        if only_implement:
            mine = [k for k, name in enumerate(body.names) if name in ("implement", "linkage")]
            body = Solids(body.polygons[mine], body.z_m[mine], tuple(body.names[k] for k in mine))
        found = nearest(body, shape.moved(*state.pose.inverse()))
        if found.part == "implement" and abs(found.point_m[1]) > 0.5 * self.shapes.machine_width_m:
            side = "left" if found.point_m[1] > 0.0 else "right"
            return Nearest(found.distance_m, f"wing_{side}", found.point_m)
        return found

    def velocity_of_point(self, state: MachineState, point_base_m: tuple[float, float, float]) -> Float64:
        """Velocity (2,) in `map` of a point of the machine."""
        x, y, _ = point_base_m
        c, s = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
        ahead, aside = state.speed_mps - state.yaw_rate_radps * y, state.yaw_rate_radps * x
        return np.array([c * ahead - s * aside, s * ahead + c * aside])


def _tilted(solids: Solids, state: MachineState) -> Solids:
    """Solids in `base` raised to the height of `map`, each by the slope at its middle."""
    middle = shapely.get_coordinates(shapely.centroid(solids.polygons))
    return Solids(solids.polygons, solids.z_m + (state.z_m + middle @ np.array(state.slope))[:, None], solids.names)


def to_map(state: MachineState, point_base_m: tuple[float, float, float]) -> tuple[float, float, float]:
    """A point with coordinates of `base` and height of `map`, in `map`."""
    x, y, _ = state.pose @ Pose2(point_base_m[0], point_base_m[1], 0.0)
    return x, y, point_base_m[2]
