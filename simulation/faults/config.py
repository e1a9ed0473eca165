"""Kinds of faults and their configuration; magnitudes are those of `configs/faults.yaml`."""

from enum import StrEnum
from fnmatch import fnmatch
from typing import Annotated

from pydantic import Field, model_validator

from configs.strict import Config
from messages.errors import ConfigError


class FaultKind(StrEnum):
    """Fault of a device, a node, the clock or the log."""

    OFF = "off"
    FROZEN = "frozen"  # last value, with new stamps and counters
    REPEATED = "repeated"  # last message, with its old stamp
    OUT_OF_ORDER = "out_of_order"  # pairs of messages swapped
    DELAYED = "delayed"  # by twice the maximum age
    SLOW = "slow"  # one message in three times the maximum age
    REPLAY = "replay"  # the first messages of the fault over and over, with new stamps and counters
    NOISY = "noisy"
    OFFSET = "offset"
    DRIFT = "drift"  # an offset that grows evenly
    SCALE = "scale"
    SIGN = "sign"
    NAN = "nan"  # "not available" where the format has no NaN
    GARBAGE = "garbage"
    WRONG_UNIT = "wrong_unit"
    SWAPPED = "swapped"  # two sensors of a kind exchanged
    RAISES = "raises"
    HANGS = "hangs"
    AHEAD = "ahead"  # one hour
    BEHIND = "behind"
    FULL = "full"  # disk full


STREAM_FAULTS = (
    FaultKind.OFF, FaultKind.FROZEN, FaultKind.REPEATED, FaultKind.OUT_OF_ORDER, FaultKind.DELAYED, FaultKind.SLOW,
    FaultKind.REPLAY,
)  # fmt: skip
VALUE_FAULTS = (
    FaultKind.NOISY, FaultKind.OFFSET, FaultKind.DRIFT, FaultKind.SCALE, FaultKind.NAN, FaultKind.GARBAGE,
    FaultKind.WRONG_UNIT,
)  # fmt: skip
SENSOR_FAULTS = STREAM_FAULTS + VALUE_FAULTS
NODE_FAULTS = (FaultKind.RAISES, FaultKind.HANGS)
SYSTEM_FAULTS = {"clock": (FaultKind.AHEAD, FaultKind.BEHIND), "log": (FaultKind.FULL,)}
SIGNED = ("radar/", "imu", "wheel", "can/GuidanceMachineStatus")
EXCHANGEABLE = ("lidar/", "ultrasonic/")


def fault_kinds_of(topic: str) -> tuple[FaultKind, ...]:
    """Fault kinds that a topic can have."""
    if topic in SYSTEM_FAULTS:
        return SYSTEM_FAULTS[topic]
    if topic.startswith("node/"):
        return NODE_FAULTS
    signed = (FaultKind.SIGN,) if topic.startswith(SIGNED) else ()
    return SENSOR_FAULTS + signed + ((FaultKind.SWAPPED,) if topic.startswith(EXCHANGEABLE) else ())


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


class PlausibleErrors(Config):
    """Wrong values that a device could give: factor, time in which a drift reaches the offset, length of a replay."""

    scale: float = Field(gt=0.0, le=10.0)
    drift_s: float = Field(gt=0.0, le=1000.0)
    replay_s: float = Field(gt=0.0, le=60.0)


class Demand(StrEnum):
    """What a fault demands of the machine: a stop within S, a speed limit, or nothing but that no harm is done."""

    STOP = "stop"
    LIMIT = "limit"
    CONTINUE = "continue"


class Demanded(Config):
    """Demand on faults of targets (patterns of `fnmatch`), with the reason for it.

    `is_used`: whether the target covers the direction of travel (None: either). `situations` and `faults` None: all.
    `bridged_s`: a stop may not come earlier.
    """

    targets: tuple[str, ...] = Field(min_length=1)
    faults: frozenset[FaultKind] | None = None
    situations: frozenset[str] | None = None
    is_used: bool | None = None
    demand: Demand
    limit_kmh: float | None = Field(default=None, gt=0.0, le=30.0)
    is_named: bool
    bridged_s: float = Field(default=0.0, ge=0.0, le=120.0)
    why: str = Field(min_length=20)

    @model_validator(mode="after")
    def _has_limit(self) -> "Demanded":
        if (self.demand is Demand.LIMIT) != (self.limit_kmh is not None):
            raise ValueError("limit_kmh belongs to demand: limit, and only to it")
        return self

    def applies(self, situation: str, target: str, kind: FaultKind, is_used: bool) -> bool:
        """Whether the demand is on this fault."""
        return (
            any(fnmatch(target, one) for one in self.targets)
            and (self.faults is None or kind in self.faults)
            and (self.situations is None or situation in self.situations)
            and (self.is_used is None or self.is_used == is_used)
        )


class CampaignConfig(Config):
    """Observation times and demands of the fault campaign; the first demand that applies counts."""

    observation_s: float = Field(gt=0.0, le=120.0)
    standstill_s: float = Field(gt=0.0, le=10.0)
    max_path_error_m: float = Field(gt=0.0, le=5.0)
    demands: tuple[Demanded, ...]
    reported_as: dict[str, tuple[str, ...]]

    def demanded(self, situation: str, target: str, kind: FaultKind, is_used: bool) -> Demanded:
        """The demand on a fault; raises ConfigError without one."""
        found = next((one for one in self.demands if one.applies(situation, target, kind, is_used)), None)
        if found is None:
            raise ConfigError(f"faults.yaml: no demand on {kind.value!r} of {target!r} in situation {situation!r}")
        return found


class FaultsConfig(Config):
    """`configs/faults.yaml`: fields by kind of topic, signals by message of the DBC, and the campaign."""

    plausible: PlausibleErrors
    messages: dict[str, dict[str, FieldErrors]]
    frames: dict[str, dict[str, FieldErrors]]
    campaign: CampaignConfig
