"""Implement control: commands are given ahead by the learned latency, so that work starts and ends where planned."""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import MountedImplement, TrailedImplement
from control.longitudinal_controller import SpeedPlan
from control.scalars import clamp
from messages.plan import Path

HALF_PERIOD_S = 0.01  # half the control period: mean quantisation error


class ImplementControlConfig(Config):
    """Working position of the hitch and learning of its latency."""

    in_work_below: float = Field(gt=0.0, lt=1.0, description="hitch, 0 lowest to 1 highest")
    pipeline_s: float = Field(ge=0.0, le=0.5, description="from command to first motion of the hitch")
    learning: float = Field(ge=0.0, le=1.0, description="share of an observed error taken over")
    learned_max_s: float = Field(ge=0.0, le=2.0, description="limit of the learned latency")
    pto_lead_s: float = Field(ge=0.0, le=30.0, description="run-up before work")
    pto_keep_s: float = Field(ge=0.0, le=300.0, description="kept running if the next work begins within")


@dataclass(frozen=True)
class Edge:
    """Arc length where work begins (`is_lowering`) or ends."""

    s_m: float
    is_lowering: bool


def edges_of(path: Path) -> tuple[Edge, ...]:
    """Beginnings and ends of work along the path."""
    work = path.is_working.astype(bool)
    edges = [Edge(-math.inf, True)] if work[0] else []
    for k in np.flatnonzero(work[1:] != work[:-1]).tolist():
        # is_working is set from the last point before work to the first after it: the edge is half a step inside
        inner = (k + 1, min(k + 2, len(work) - 1)) if work[k + 1] else (max(k - 1, 0), k)
        edges.append(Edge(0.5 * float(path.s_m[inner[0]] + path.s_m[inner[1]]), bool(work[k + 1])))
    return (*edges, Edge(float(path.s_m[-1]), False)) if work[-1] else tuple(edges)


class HitchLatency:
    """Latency of a hitch beyond its travel time, learned from the measured crossing of the working position."""

    def __init__(self, config: ImplementControlConfig) -> None:
        self._config = config
        self.extra_s = 0.0
        self._commanded_ns: int | None = None
        self._expected_s = 0.0
        self._last: tuple[int, float] | None = None

    def command(self, now_ns: int, expected_s: float) -> None:
        """Registers a commanded motion, expected to cross the working position after `expected_s`."""
        self._commanded_ns, self._expected_s = now_ns, expected_s

    def observe(self, stamp_ns: int, hitch: float) -> None:
        """Takes a measured height (0 lowest, 1 highest); learns from a crossing since the command."""
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
    """Hitch and PTO commands along the path."""

    def __init__(self, implement: MountedImplement | TrailedImplement, config: ImplementControlConfig) -> None:
        self._implement, self._config = implement, config
        self._edges: tuple[Edge, ...] = ()
        self._next = 0
        self._lowering, self._lifting = HitchLatency(config), HitchLatency(config)
        self.is_lowered = self.is_pto_on = False

    def start(self, path: Path) -> None:
        """Starts a path."""
        self._edges, self._next = edges_of(path), 0
        self.is_lowered = bool(path.is_working[0])

    def observe(self, stamp_ns: int, hitch: float) -> None:
        """Takes the measured height of the hitch."""
        self._lowering.observe(stamp_ns, hitch)
        self._lifting.observe(stamp_ns, hitch)

    def step(self, now_ns: int, plan: SpeedPlan, s_m: float, speed_mps: float, hitch: float) -> None:
        """Updates the commands at `s_m`; at standstill nothing ahead is executed."""
        while self._next < len(self._edges) and self._is_due(self._edges[self._next], plan, s_m, speed_mps, hitch):
            self._execute(now_ns, self._edges[self._next], hitch)
            self._next += 1
        self._control_pto(plan, s_m, speed_mps)

    def lift(self) -> None:
        """Commands lifted and PTO off."""
        self.is_lowered = self.is_pto_on = False

    def _is_due(self, edge: Edge, plan: SpeedPlan, s_m: float, speed_mps: float, hitch: float) -> bool:
        if edge.s_m <= s_m:
            return True
        return plan.time_s(s_m, edge.s_m, speed_mps) <= self._lead_s(edge.is_lowering, hitch) + HALF_PERIOD_S

    def _lead_s(self, is_lowering: bool, hitch: float) -> float:
        extra_s = (self._lowering if is_lowering else self._lifting).extra_s
        return self._config.pipeline_s + self._travel_s(is_lowering, hitch) + extra_s

    def _travel_s(self, is_lowering: bool, hitch: float) -> float:
        if is_lowering:
            return max(hitch - self._config.in_work_below, 0.0) * self._implement.lower_s
        return max(self._config.in_work_below - hitch, 0.0) * self._implement.lift_s

    def _execute(self, now_ns: int, edge: Edge, hitch: float) -> None:
        is_new = edge.is_lowering != self.is_lowered
        self.is_lowered = edge.is_lowering
        if is_new:
            latency = self._lowering if edge.is_lowering else self._lifting
            latency.command(now_ns, self._lead_s(edge.is_lowering, hitch))

    def _control_pto(self, plan: SpeedPlan, s_m: float, speed_mps: float) -> None:
        """PTO on before work, and kept on between two sections of work close in time."""
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
