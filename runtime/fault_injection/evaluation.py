"""Evaluation of the reaction to one fault in one situation."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from messages.command import Mode
from messages.topics import TOPICS, spec_of
from safety.rules import RULES
from safety.rules.rule import Effect
from simulation.faults.config import CampaignConfig, FaultKind
from simulation.faults.frames import MAX_AGE_NS

OBSTACLE_REASONS = (
    *(name for name, rule in RULES.items() if rule.effect & Effect.OBSTACLE_STOP), str(Mode.OBSTACLE_STOP),
)  # fmt: skip
SYSTEM_MAX_AGE_S = 0.4  # of clock and log, which have no topic


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

    def requires_stop(self, config: CampaignConfig, unused: Iterable[str]) -> bool:
        """Whether the machine must stop; `unused` are sensors and nodes that this situation does not need."""
        family = self.topic if self.topic.startswith("can/") else self.topic.partition("/")[0]
        is_spare = self.topic.startswith(config.redundant_nodes) or self._is_of(config.report_required)
        is_required = family in config.stop_required and self.topic not in unused and not is_spare
        is_undetectable = self.kind is FaultKind.REPEATED and self.topic in config.without_counter
        return is_required and self.kind in config.detectable_kinds and not is_undetectable

    def requires_alarm(self, config: CampaignConfig, unused: Iterable[str]) -> bool:
        """Whether the loss must be reported; invalid values may be equal to an empty measurement."""
        is_silent = self.kind in config.detectable_kinds - {FaultKind.NAN, FaultKind.GARBAGE}
        return is_silent and self._is_of(config.report_required) and self.topic not in unused

    def _is_of(self, kinds: tuple[str, ...]) -> bool:
        """Whether the topic is a sensor of these kinds or a node of one."""
        return self.topic.removeprefix("node/").removeprefix("health_").startswith(kinds)

    def max_age_s(self, writes: Mapping[str, tuple[str, ...]]) -> float:
        """Maximum age of the last good message in s; for a node the smallest of its topics."""
        if self.topic.startswith("can/"):
            return MAX_AGE_NS * 1e-9
        if self.topic.startswith("node/"):
            return min(spec_of(topic).max_age_s for topic in writes[self.topic.removeprefix("node/")])
        return spec_of(self.topic).max_age_s if self.topic.partition("/")[0] in TOPICS else SYSTEM_MAX_AGE_S

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
    """Result of a cell; `travel_m` and `stopped_s` are None if the machine did not stop."""

    situation: str
    topic: str
    fault: str
    speed_mps: float
    travel_m: float | None
    allowed_m: float | None
    stopping_distance_m: float
    stopped_s: float | None
    path_error_m: float
    contacts: int
    zone_exits: int
    reason: str
    alarms: str
    is_fault_identified: bool
    is_misattributed: bool
    passed: bool
    failure: str

    def as_dict(self) -> dict[str, Any]:
        """Row of table and file, numbers rounded to 3 decimals."""
        return {k: (round(v, 3) if isinstance(v, float) else v) for k, v in asdict(self).items()}


@dataclass(frozen=True)
class MeasuredReaction:
    """Measured values of one cell."""

    speed_mps: float
    stopping_distance_m: float
    travel_m: float
    stopped_s: float | None
    path_error_m: float
    contacts: int
    zone_exits: int
    reason: str
    alarms: tuple[str, ...]


def evaluate(
    cell: Cell, measured: MeasuredReaction, config: CampaignConfig, identifiers: tuple[str, ...],
    others: dict[str, tuple[str, ...]], max_age_s: float | None, requires_alarm: bool,
) -> Outcome:  # fmt: skip
    """Outcome of a cell; `others` are the identifiers of all other devices, `max_age_s` None means no stop required."""
    requires_stop, has_stopped = max_age_s is not None, measured.stopped_s is not None
    allowed_m = None if max_age_s is None else measured.speed_mps * max_age_s + measured.stopping_distance_m
    is_identified = any(name in text for name in identifiers for text in (measured.reason, *measured.alarms))
    accused = [topic for topic, texts in others.items() if any(name in measured.reason for name in texts)]
    is_misattributed = bool(accused) and not is_identified
    is_obstacle_stop = cell.situation == "obstacle" and measured.reason.startswith(OBSTACLE_REASONS)
    bridged_s = config.min_bridging_s.get(cell.topic.partition("/")[0], 0.0)
    is_bridged = measured.stopped_s is None or measured.stopped_s >= bridged_s or is_obstacle_stop
    failures = {
        "contact": measured.contacts > 0,
        "zone exit": measured.zone_exits > 0,
        "did not stop": requires_stop and not has_stopped,
        "stopped late": allowed_m is not None and has_stopped and measured.travel_m > allowed_m,
        "stopped too early": not is_bridged,
        f"left the path by {measured.path_error_m:.2f} m": measured.path_error_m > config.max_path_error_m,
        "attributed to " + ", ".join(accused): is_misattributed,
        "not identified": requires_stop and has_stopped and not is_identified and not is_obstacle_stop,
        "loss not reported": requires_alarm and not is_identified and not is_obstacle_stop,
    }
    failure = "; ".join(text for text, holds in failures.items() if holds)
    return Outcome(
        cell.situation, cell.topic, cell.kind.value, measured.speed_mps, measured.travel_m if has_stopped else None,
        allowed_m, measured.stopping_distance_m, measured.stopped_s, measured.path_error_m, measured.contacts,
        measured.zone_exits, measured.reason, ", ".join(measured.alarms), is_identified, is_misattributed,
        not failure, failure,
    )  # fmt: skip
