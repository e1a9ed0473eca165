"""The implement is told early, so that it is in work and out of work where the path says."""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import MountedImplement, TrailedImplement
from control.longitudinal_controller import SpeedPlan
from control.scalars import clamp
from messages.plan import Path

HALF_PERIOD_S = 0.01  # decided once a period: half of it too early or too late


class ImplementControlConfig(Config):
    """When the implement counts as in work, and how its answers are learned."""

    in_work_below: float = Field(gt=0.0, lt=1.0, description="hitch, 0 lowest to 1 highest")
    pipeline_s: float = Field(ge=0.0, le=0.5, description="from wish to the hitch's first motion")
    learning: float = Field(ge=0.0, le=1.0, description="share of an observed error")
    learned_max_s: float = Field(ge=0.0, le=2.0)
    pto_lead_s: float = Field(ge=0.0, le=30.0)
    pto_keep_s: float = Field(ge=0.0, le=300.0, description="left running when the next work comes within")


@dataclass(frozen=True)
class Edge:
    """Where the implement goes into work (`is_lowering`) or out of it."""

    s_m: float
    is_lowering: bool


def edges_of(path: Path) -> tuple[Edge, ...]:
    """The places along the path, each between the last point before and the first after it."""
    work = path.is_working.astype(bool)
    edges = [Edge(-math.inf, True)] if work[0] else []
    for k in np.flatnonzero(work[1:] != work[:-1]).tolist():
        # work is marked from the last point before it to the first after it: the true edge is one gap further in
        inner = (k + 1, min(k + 2, len(work) - 1)) if work[k + 1] else (max(k - 1, 0), k)
        edges.append(Edge(0.5 * float(path.s_m[inner[0]] + path.s_m[inner[1]]), bool(work[k + 1])))
    return (*edges, Edge(float(path.s_m[-1]), False)) if work[-1] else tuple(edges)


class Latency:
    """What a hitch takes longer than its way needs: learned from when it really crossed."""

    def __init__(self, config: ImplementControlConfig) -> None:
        self._config = config
        self.extra_s = 0.0
        self._commanded_ns: int | None = None
        self._expected_s = 0.0
        self._last: tuple[int, float] | None = None

    def command(self, now_ns: int, expected_s: float) -> None:
        """A motion was commanded that should cross into or out of work after `expected_s`."""
        self._commanded_ns, self._expected_s = now_ns, expected_s

    def observe(self, stamp_ns: int, hitch: float) -> None:
        """Take a measured height; a crossing since the command teaches."""
        before, self._last = self._last, (stamp_ns, hitch)
        if self._commanded_ns is None or before is None or stamp_ns <= before[0]:
            return
        low, high = sorted((before[1], hitch))
        if low < self._config.in_work_below <= high and before[0] >= self._commanded_ns:
            share = (self._config.in_work_below - before[1]) / (hitch - before[1])
            crossed_ns = before[0] + share * (stamp_ns - before[0])
            late_s = (crossed_ns - self._commanded_ns) * 1e-9 - self._expected_s
            change = self._config.learning * clamp(late_s, 0.3)
            self.extra_s = clamp(self.extra_s + change, self._config.learned_max_s)
            self._commanded_ns = None


class ImplementControl:
    """Lowered or lifted, shaft on or off, as the path wants it."""

    def __init__(self, implement: MountedImplement | TrailedImplement, config: ImplementControlConfig) -> None:
        self._implement, self._config = implement, config
        self._edges: tuple[Edge, ...] = ()
        self._next = 0
        self._down, self._up = Latency(config), Latency(config)
        self.is_lowered = self.is_pto_on = False

    def start(self, path: Path) -> None:
        """A new path begins."""
        self._edges, self._next = edges_of(path), 0
        self.is_lowered = bool(path.is_working[0])

    def observe(self, stamp_ns: int, hitch: float) -> None:
        """Take the hitch's measured height."""
        self._down.observe(stamp_ns, hitch)
        self._up.observe(stamp_ns, hitch)

    def step(self, now_ns: int, plan: SpeedPlan, s_m: float, speed_mps: float, hitch: float) -> None:
        """Decide for the place reached; a machine that stands changes nothing ahead."""
        while self._next < len(self._edges) and self._is_due(self._edges[self._next], plan, s_m, speed_mps, hitch):
            self._pass(now_ns, self._edges[self._next], hitch)
            self._next += 1
        self._turn_shaft(plan, s_m, speed_mps)

    def rest(self) -> None:
        """Lifted and off: nothing more to do."""
        self.is_lowered = self.is_pto_on = False

    def _is_due(self, edge: Edge, plan: SpeedPlan, s_m: float, speed_mps: float, hitch: float) -> bool:
        if edge.s_m <= s_m:
            return True
        return plan.time_s(s_m, edge.s_m, speed_mps) <= self._lead_s(edge.is_lowering, hitch) + HALF_PERIOD_S

    def _lead_s(self, is_lowering: bool, hitch: float) -> float:
        extra_s = (self._down if is_lowering else self._up).extra_s
        return self._config.pipeline_s + self._way_s(is_lowering, hitch) + extra_s

    def _way_s(self, is_lowering: bool, hitch: float) -> float:
        if is_lowering:
            return max(hitch - self._config.in_work_below, 0.0) * self._implement.lower_s
        return max(self._config.in_work_below - hitch, 0.0) * self._implement.lift_s

    def _pass(self, now_ns: int, edge: Edge, hitch: float) -> None:
        is_new = edge.is_lowering != self.is_lowered
        self.is_lowered = edge.is_lowering
        if is_new:
            latency = self._down if edge.is_lowering else self._up
            latency.command(now_ns, self._lead_s(edge.is_lowering, hitch))

    def _turn_shaft(self, plan: SpeedPlan, s_m: float, speed_mps: float) -> None:
        """On before work, and left on between two pieces of work that follow each other soon."""
        config, implement = self._config, self._implement
        if not implement.uses_pto or self._next == len(self._edges):
            self.is_pto_on = implement.uses_pto and self.is_lowered
            return
        edge = self._edges[self._next]
        if self.is_lowered or not edge.is_lowering:
            self.is_pto_on = True
            return
        wait_s = plan.time_s(s_m, edge.s_m, max(speed_mps, plan.limit_mps(s_m)))
        lead_s = config.pto_lead_s + self._lead_s(True, 1.0)
        self.is_pto_on = wait_s <= (max(config.pto_keep_s, lead_s) if self.is_pto_on else lead_s)
