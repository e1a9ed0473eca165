"""Kinds of faults and their configuration; magnitudes are those of `configs/faults.yaml`."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field, model_validator

from configs.strict import Config


class FaultKind(StrEnum):
    """Fault of a device, a node, the clock or the log."""

    OFF = "off"
    FROZEN = "frozen"  # last value, with new stamps and counters
    REPEATED = "repeated"  # last message, with its old stamp
    OUT_OF_ORDER = "out_of_order"  # pairs of messages swapped
    DELAYED = "delayed"  # by twice the maximum age
    SLOW = "slow"  # one message in three times the maximum age
    NOISY = "noisy"
    OFFSET = "offset"
    NAN = "nan"  # "not available" where the format has no NaN
    GARBAGE = "garbage"
    WRONG_UNIT = "wrong_unit"
    RAISES = "raises"
    HANGS = "hangs"
    AHEAD = "ahead"  # one hour
    BEHIND = "behind"
    FULL = "full"  # disk full


SENSOR_FAULTS = tuple(FaultKind)[:11]
NODE_FAULTS = (FaultKind.RAISES, FaultKind.HANGS)
SYSTEM_FAULTS = {"clock": (FaultKind.AHEAD, FaultKind.BEHIND), "log": (FaultKind.FULL,)}


def fault_kinds_of(topic: str) -> tuple[FaultKind, ...]:
    """Fault kinds that a topic can have."""
    if topic in SYSTEM_FAULTS:
        return SYSTEM_FAULTS[topic]
    return NODE_FAULTS if topic.startswith("node/") else SENSOR_FAULTS


class InjectedFault(Config):
    """One injected fault; times count from the start of the run."""

    topic: str = Field(min_length=1, max_length=60)
    kind: FaultKind
    from_s: float = Field(ge=0.0, le=1e6)
    for_s: float = Field(gt=0.0, le=1e6)

    @model_validator(mode="after")
    def _fits(self) -> "InjectedFault":
        if self.kind not in (known := fault_kinds_of(self.topic)):
            raise ValueError(f"{self.topic!r} cannot be {self.kind.value!r}; it can be {', '.join(known)}")
        return self

    def is_on(self, elapsed_ns: int) -> bool:
        """True while the fault is active, `elapsed_ns` after the start."""
        return round(self.from_s * 1e9) <= elapsed_ns < round((self.from_s + self.for_s) * 1e9)


Amount = Annotated[float, Field(ge=-1e9, le=1e9)]


class FieldErrors(Config):
    """Error magnitudes of one field: sigma of the noise, offset, and factor of a wrong unit."""

    noise: float = Field(gt=0.0, le=1e9)
    offset: Amount
    factor: Amount


class CampaignConfig(Config):
    """Observation times and expected reactions of the fault campaign."""

    observation_s: float = Field(gt=0.0, le=120.0)
    standstill_s: float = Field(gt=0.0, le=10.0)
    max_path_error_m: float = Field(gt=0.0, le=5.0)
    stop_required: tuple[str, ...]
    detectable_kinds: frozenset[FaultKind]
    redundant_nodes: tuple[str, ...]
    report_required: tuple[str, ...]
    without_counter: frozenset[str]
    min_bridging_s: dict[str, Annotated[float, Field(gt=0.0, le=120.0)]]
    reported_as: dict[str, tuple[str, ...]]


class FaultsConfig(Config):
    """`configs/faults.yaml`: fields by kind of topic, signals by message of the DBC, and the campaign."""

    messages: dict[str, dict[str, FieldErrors]]
    frames: dict[str, dict[str, FieldErrors]]
    campaign: CampaignConfig
