"""Configuration of `headland live`: processes and rings."""

from typing import Annotated

from pydantic import Field, model_validator

from configs.strict import Config
from runtime.live.thinned_log_config import ThinnedLogConfig

ROLES = ("machine", "perception", "localization", "planning", "safety", "log")
Seconds = Annotated[float, Field(gt=0.0, le=600.0)]


class LiveConfig(Config):
    """File `configs/live.yaml`."""

    ring_mib: dict[str, Annotated[int, Field(ge=1, le=1024)]]
    timeout_s: dict[str, Seconds]
    startup_s: Seconds
    settle_s: Seconds
    realtime: dict[str, Annotated[int, Field(ge=1, le=90)]] = Field(
        description="priorities of processes that other programs may not delay (SCHED_FIFO); needs root or CAP_SYS_NICE"
    )
    nice: dict[str, Annotated[int, Field(ge=-20, le=19)]] = Field(
        description="nice values of other processes, added to that of the start; those below 0 need the same"
    )
    thinned_log: ThinnedLogConfig
    order_folder: str = Field(min_length=1, description="sequence numbers of the orders, in the project's folder")

    @model_validator(mode="after")
    def _has_every_process(self) -> "LiveConfig":
        some = set(self.timeout_s) | set(self.realtime) | set(self.nice)
        if set(self.ring_mib) != set(ROLES) or not some <= set(ROLES):
            raise ValueError(f"ring_mib must name {', '.join(ROLES)}; timeout_s, realtime and nice some of them")
        return self
