"""Evaluation of the reaction to one fault in one situation."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from messages.command import Mode
from safety.rules import RULES
from safety.rules.rule import Effect
from simulation.faults.config import CampaignConfig, Demand, Demanded, FaultKind

OBSTACLE_REASONS = (
    *(name for name, rule in RULES.items() if rule.effect & Effect.OBSTACLE_STOP), str(Mode.OBSTACLE_STOP),
)  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """Cell of the campaign: one fault in one situation."""

    situation: str
    topic: str
    kind: FaultKind

    @property
    def name(self) -> str:
        """Name for files and `--only`, such as swath-imu-off."""
        return f"{self.situation}-{self.topic.replace('/', '_')}-{self.kind.value}"

    def identifiers(self, config: CampaignConfig, writes: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
        """Texts by which reasons and alarms identify the device; `writes` are the topics of each node."""
        if self.topic.startswith("node/"):
            node = self.topic.removeprefix("node/")
            own = [w if "/" in w else f"{w}." for w in writes.get(node, ())]
            return (f"({node})", f"{node}.", *own, *config.reported_as.get(self.topic, ()))
        kind = self.topic.partition("/")[0]
        return (self.topic, *config.reported_as.get(self.topic, ()), *config.reported_as.get(kind, ()))


@dataclass(frozen=True)
class Outcome:
    """Result of a cell; `travel_m` and `stopped_s` are None if the machine did not stop, `named_s` if nothing named it.

    `allowed_m` is the S of the judge at the speed of the fault, None without a demanded stop.
    """

    situation: str
    topic: str
    fault: str
    demand: str
    why: str
    speed_mps: float
    travel_m: float | None
    allowed_m: float | None
    stopped_s: float | None
    named_s: float | None
    is_naming_demanded: bool
    path_error_m: float
    contacts: int
    zone_exits: int
    reason: str
    alarms: str
    is_misattributed: bool
    passed: bool
    failure: str

    def as_dict(self) -> dict[str, Any]:
        """Row of table and file, numbers rounded to 3 decimals."""
        return {k: (round(v, 3) if isinstance(v, float) else v) for k, v in asdict(self).items()}


@dataclass(frozen=True)
class MeasuredReaction:
    """Measured values of one cell.

    `stopping_distance_m` is that of the judge; `end_speed_mps` the greatest speed of the last second; `alarms` are
    texts of faults, rules and reasons with the time (s) at which each was first given.
    """

    speed_mps: float
    stopping_distance_m: float
    travel_m: float
    stopped_s: float | None
    end_speed_mps: float
    path_error_m: float
    contacts: int
    zone_exits: int
    reason: str
    alarms: Mapping[str, float]


def named_after_s(alarms: Mapping[str, float], identifiers: tuple[str, ...]) -> float | None:
    """Time (s) of the first alarm that names the device, None without one."""
    return min((at_s for text, at_s in alarms.items() if any(name in text for name in identifiers)), default=None)


def evaluate(
    cell: Cell, measured: MeasuredReaction, config: CampaignConfig, demanded: Demanded, identifiers: tuple[str, ...],
    others: dict[str, tuple[str, ...]],
) -> Outcome:  # fmt: skip
    """Outcome of a cell; `others` are the identifiers of all other devices."""
    must_stop, has_stopped = demanded.demand is Demand.STOP, measured.stopped_s is not None
    allowed_m = measured.stopping_distance_m if must_stop else None
    named_s = named_after_s(measured.alarms, identifiers)
    accused = [topic for topic, texts in others.items() if any(name in measured.reason for name in texts)]
    is_misattributed = bool(accused) and named_s is None
    is_obstacle_stop = measured.reason.startswith(OBSTACLE_REASONS)
    is_bridged = measured.stopped_s is None or measured.stopped_s >= demanded.bridged_s or is_obstacle_stop
    limit_mps = math.inf if demanded.limit_kmh is None else demanded.limit_kmh / 3.6
    failures = {
        "contact": measured.contacts > 0,
        "zone exit": measured.zone_exits > 0,
        "did not stop": must_stop and not has_stopped,
        "stopped late": allowed_m is not None and has_stopped and measured.travel_m > allowed_m,
        "not limited": measured.end_speed_mps > limit_mps,
        "stopped too early": not is_bridged,
        f"left the path by {measured.path_error_m:.2f} m": measured.path_error_m > config.max_path_error_m,
        "attributed to " + ", ".join(accused): is_misattributed,
        "not named": demanded.is_named and named_s is None,
    }
    failure = "; ".join(text for text, holds in failures.items() if holds)
    return Outcome(
        cell.situation, cell.topic, cell.kind.value, demanded.demand.value, demanded.why, measured.speed_mps,
        measured.travel_m if has_stopped else None, allowed_m, measured.stopped_s, named_s, demanded.is_named,
        measured.path_error_m, measured.contacts, measured.zone_exits, measured.reason, ", ".join(measured.alarms),
        is_misattributed, not failure, failure,
    )  # fmt: skip
