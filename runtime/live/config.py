"""Configuration of `headland live`: processes, rings and CAN bus."""

from typing import Annotated, Any

import can
from pydantic import Field, model_validator

from configs.strict import Config
from messages.errors import HeadlandError
from runtime.live.thinned_log_config import ThinnedLogConfig

ROLES = ("machine", "perception", "localization", "planning", "safety", "log")
Seconds = Annotated[float, Field(gt=0.0, le=600.0)]


class CanConfig(Config):
    """CAN bus by python-can names; `port` applies to udp_multicast only."""

    interface: str = Field(min_length=1, max_length=40)
    channel: str = Field(min_length=1, max_length=80)
    port: int = Field(ge=1024, le=65535)


class LiveConfig(Config):
    """File `configs/live.yaml`."""

    can: CanConfig
    ring_mib: dict[str, Annotated[int, Field(ge=1, le=1024)]]
    timeout_s: dict[str, Seconds]
    startup_s: Seconds
    thinned_log: ThinnedLogConfig

    @model_validator(mode="after")
    def _has_every_process(self) -> "LiveConfig":
        if set(self.ring_mib) != set(ROLES) or not set(self.timeout_s) <= set(ROLES):
            raise ValueError(f"ring_mib must name {', '.join(ROLES)}, and timeout_s some of them")
        return self


def open_bus(config: CanConfig) -> can.BusABC:
    """Opens the bus; raises HeadlandError."""
    extra: dict[str, Any] = {"port": config.port} if config.interface == "udp_multicast" else {}
    try:
        return can.Bus(interface=config.interface, channel=config.channel, **extra)
    except (can.CanError, OSError, ImportError, ValueError) as error:
        raise HeadlandError(f"CAN bus {config.interface}:{config.channel} cannot be opened ({error})") from error
