"""Phases of a drive, derived from what the tractor's bus and the plan say; several can hold at once.

The position on the plan is the nearest point ahead of or shortly behind the last one, so that paths which cross or lie
beside each other are not confused.
"""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from geometry.arrays import Float64
from messages.plan import Path, PathSectionType

PhaseName = Literal["start_warning", "start", "straight", "turn", "headland", "lane", "yard", "reverse", "docking",
                    "resume", "lowering"]  # fmt: skip
PHASES: tuple[PhaseName, ...] = get_args(PhaseName)
SECTION_PHASES: dict[PathSectionType, PhaseName] = {
    PathSectionType.HEADLAND: "headland", PathSectionType.LANE: "lane", PathSectionType.DOCK: "docking",
}  # fmt: skip
MOVING_MPS, STEADY_MPS = 0.05, 0.5  # moving at all; fast enough for straight and turn
STANDSTILL_S = 1.0  # shorter ones are part of a change of direction
STRAIGHT_RAD, TURN_RAD = math.radians(3.0), math.radians(10.0)  # angle of the front wheels
BACK_POINTS, AHEAD_POINTS = 50, 400  # search around the last position; points are about 0.1 m apart


@dataclass(frozen=True)
class Situation:
    """What the world knows of machine and plan at one instant; `path_m` is NaN without a plan."""

    elapsed_s: float
    base: tuple[float, float, float]
    speed_mps: float
    steering_rad: float
    is_lowering: bool
    is_horn_on: bool
    is_in_yard: bool
    path_m: float = math.nan
    section: PathSectionType | None = None


@dataclass
class PlanPosition:
    """Position of the machine along all paths of a plan, one after the other."""

    paths: tuple[Path, ...]
    _at: int = 0
    p_map_m: Float64 = field(init=False)
    heading_rad: Float64 = field(init=False)
    path_m: Float64 = field(init=False)
    direction: Float64 = field(init=False)

    def __post_init__(self) -> None:
        lengths = np.cumsum([0.0, *(float(p.s_m[-1]) for p in self.paths)])
        empty = np.zeros(0)
        self.p_map_m = np.concatenate([np.zeros((0, 2)), *(p.p_map_m for p in self.paths)])
        self.heading_rad = np.concatenate([empty, *(p.heading_rad for p in self.paths)])
        self.path_m = np.concatenate([empty, *(p.s_m + s for p, s in zip(self.paths, lengths, strict=False))])
        self.direction = np.concatenate([empty, *(np.full(len(p.s_m), float(p.direction)) for p in self.paths)])
        self._sections = [p.sections[int(k)].section_type for p in self.paths for k in p.section_index]

    def update(self, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, PathSectionType | None]:
        """Distance along the plan and type of the section there; NaN and None without a plan."""
        if len(self.path_m) == 0:
            return math.nan, None
        low, high = max(0, self._at - BACK_POINTS), self._at + AHEAD_POINTS
        away = np.hypot(*(self.p_map_m[low:high] - [x_m, y_m]).T)
        away = away + 2.0 * (np.cos(self.heading_rad[low:high] - yaw_rad) < 0.0)
        self._at = low + int(np.argmin(away))
        return float(self.path_m[self._at]), self._sections[self._at]

    def pose_at(self, path_m: float) -> tuple[float, float, float]:
        """Position and direction of travel (not of the machine, in reverse) at a distance along the plan."""
        k = int(np.clip(np.searchsorted(self.path_m, path_m), 0, len(self.path_m) - 1))
        x, y = self.p_map_m[k]
        turn = 0.0 if self.direction[k] > 0.0 else math.pi
        heading = float(self.heading_rad[k]) + turn
        over = path_m - float(self.path_m[k])
        return float(x) + over * math.cos(heading), float(y) + over * math.sin(heading), heading

    def path_m_of_leading_end(self, front_m: float, rear_m: float) -> float:
        """Distance along the plan of the end that leads there: front, or in reverse rear (its x in `base`)."""
        return float(self.path_m[self._at]) + (front_m if self.direction[self._at] > 0.0 else -rear_m)


class PhaseTracker:
    """Phases that hold now; `start` and `resume` hold from setting off to `STANDSTILL_S` later."""

    def __init__(self) -> None:
        self._has_driven = False
        self._stood_since_s: float | None = 0.0
        self._set_off: tuple[PhaseName, float] | None = None

    def update(self, now: Situation) -> frozenset[PhaseName]:
        """Phases at this instant."""
        self._update_setting_off(now)
        speed, angle = abs(now.speed_mps), abs(now.steering_rad)
        held: dict[PhaseName, bool] = {
            "start_warning": now.is_horn_on,
            "straight": now.speed_mps > STEADY_MPS and angle < STRAIGHT_RAD and now.section is not PathSectionType.DOCK,
            "turn": speed > STEADY_MPS and angle > TURN_RAD,
            "yard": now.is_in_yard and speed > MOVING_MPS,
            "reverse": now.speed_mps < -MOVING_MPS,
            "lowering": now.is_lowering,
        }
        found = {name for name, is_held in held.items() if is_held}
        if self._set_off is not None and now.elapsed_s - self._set_off[1] < STANDSTILL_S:
            found.add(self._set_off[0])
        if now.section in SECTION_PHASES and speed > MOVING_MPS:
            found.add(SECTION_PHASES[now.section])
        return frozenset(found)

    def _update_setting_off(self, now: Situation) -> None:
        if abs(now.speed_mps) <= MOVING_MPS:
            self._stood_since_s = now.elapsed_s if self._stood_since_s is None else self._stood_since_s
        elif self._stood_since_s is not None:
            if not self._has_driven or now.elapsed_s - self._stood_since_s >= STANDSTILL_S:
                self._set_off = ("resume" if self._has_driven else "start", now.elapsed_s)
            self._has_driven, self._stood_since_s = True, None
