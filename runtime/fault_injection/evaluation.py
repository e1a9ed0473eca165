"""Whether one fault in one situation was met as it must be."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from messages.topics import TOPICS, spec_of
from simulation.faults.config import CampaignConfig, FaultKind
from simulation.faults.frames import MAX_AGE_NS

WHOLE_AGE_S = 0.4  # of the clock and the log, which are no topics


@dataclass(frozen=True)
class Cell:
    """One fault in one situation."""

    situation: str
    topic: str
    kind: FaultKind

    @property
    def name(self) -> str:
        """For files and for `--only`."""
        return f"{self.situation}-{self.topic.replace('/', '_')}-{self.kind.value}"

    def is_needed(self, config: CampaignConfig, idle: Iterable[str]) -> bool:
        """Whether the machine must stop; `idle` are sensors that this situation does without."""
        family = self.topic if self.topic.startswith("can/") else self.topic.partition("/")[0]
        is_spare = self.topic.startswith(config.redundant_nodes) or self._is_of(config.report_required)
        is_known = family in config.stop_required and self.topic not in idle and not is_spare
        cannot_tell = self.kind is FaultKind.REPEATED and self.topic in config.without_counter
        return is_known and self.kind in config.detectable_kinds and not cannot_tell

    def is_missed(self, config: CampaignConfig, idle: Iterable[str]) -> bool:
        """Whether the machine must say that it does without it; nonsense may look like nothing seen."""
        is_silent = self.kind in config.detectable_kinds - {FaultKind.NAN, FaultKind.GARBAGE}
        return is_silent and self._is_of(config.report_required) and self.topic not in idle

    def _is_of(self, families: tuple[str, ...]) -> bool:
        """Whether it is a sensor of these families, or makes obstacles or health of one."""
        return self.topic.removeprefix("node/").removeprefix("health_").startswith(families)

    def max_age_s(self, writes: Mapping[str, tuple[str, ...]]) -> float:
        """How old the last good message may become before it counts as missing: of a node, the first that does."""
        if self.topic.startswith("can/"):
            return MAX_AGE_NS * 1e-9
        if self.topic.startswith("node/"):
            return min(spec_of(topic).max_age_s for topic in writes[self.topic.removeprefix("node/")])
        return spec_of(self.topic).max_age_s if self.topic.partition("/")[0] in TOPICS else WHOLE_AGE_S

    def names(self, config: CampaignConfig, writes: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
        """By what the stack may call it; `writes` are the topics of each node."""
        if self.topic.startswith("node/"):
            node = self.topic.removeprefix("node/")
            own = [w if "/" in w else f"{w}." for w in writes.get(node, ())]
            return (f"({node})", f"{node}.", *own, *config.reported_as.get(self.topic, ()))
        kind = self.topic.partition("/")[0]
        return (self.topic, *config.reported_as.get(self.topic, ()), *config.reported_as.get(kind, ()))


@dataclass(frozen=True)
class Outcome:
    """What became of a cell; `travel_m` and `stopped_s` are None when the machine went on."""

    situation: str
    topic: str
    fault: str
    speed_mps: float
    travel_m: float | None
    allowed_m: float | None
    stopping_distance_m: float
    stopped_s: float | None
    error_m: float
    contacts: int
    zone_exits: int
    reason: str
    told: str
    is_named: bool
    blames_other: bool
    is_right: bool
    wrong: str

    def as_dict(self) -> dict[str, Any]:
        """For table and file."""
        return {k: (round(v, 3) if isinstance(v, float) else v) for k, v in asdict(self).items()}


@dataclass(frozen=True)
class Seen:
    """The figures of one cell."""

    speed_mps: float
    stopping_distance_m: float
    travel_m: float
    stopped_s: float | None
    error_m: float
    contacts: int
    zone_exits: int
    reason: str
    told: tuple[str, ...]


def judge(
    cell: Cell, seen: Seen, config: CampaignConfig, names: tuple[str, ...], others: dict[str, tuple[str, ...]],
    max_age_s: float | None, is_missed: bool,
) -> Outcome:  # fmt: skip
    """The outcome; `others` are the names of all other devices, `max_age_s` None means that it need not stop."""
    is_needed = max_age_s is not None
    allowed_m = None if max_age_s is None else seen.speed_mps * max_age_s + seen.stopping_distance_m
    is_named = any(name in text for name in names for text in (seen.reason, *seen.told))
    blamed = [topic for topic, called in others.items() if any(name in seen.reason for name in called)]
    blames_other = bool(blamed) and not is_named
    is_obstacle = (
        seen.reason.startswith(("protective_field", "tracked_obstacle", "detection_range", "obstacle_stop"))
        and cell.situation == "obstacle"
    )
    bridged_s = config.min_bridging_s.get(cell.topic.partition("/")[0], 0.0)
    is_bridged = seen.stopped_s is None or seen.stopped_s >= bridged_s or is_obstacle
    complaints = {
        "contact": seen.contacts > 0,
        "exit": seen.zone_exits > 0,
        "went on": is_needed and seen.stopped_s is None,
        "stopped late": allowed_m is not None and seen.stopped_s is not None and seen.travel_m > allowed_m,
        "stopped too early": not is_bridged,
        f"left the path by {seen.error_m:.2f} m": seen.error_m > config.max_path_error_m,
        "blames " + ", ".join(blamed): blames_other,
        "not named": is_needed and seen.stopped_s is not None and not is_named and not is_obstacle,
        "not missed": is_missed and not is_named and not is_obstacle,
    }
    wrong = "; ".join(text for text, holds in complaints.items() if holds)
    has_stopped = seen.stopped_s is not None
    return Outcome(
        cell.situation, cell.topic, cell.kind.value, seen.speed_mps, seen.travel_m if has_stopped else None, allowed_m,
        seen.stopping_distance_m, seen.stopped_s, seen.error_m, seen.contacts, seen.zone_exits, seen.reason,
        ", ".join(seen.told),
        is_named, blames_other, not wrong, wrong,
    )  # fmt: skip
