"""What the processes of `headland live` are given."""

from typing import Annotated, Any

import can
from pydantic import Field, model_validator

from configs.strict import Config
from messages.errors import HeadlandError

ROLES = ("machine", "perception", "localization", "planning", "safety", "log")
Seconds = Annotated[float, Field(gt=0.0, le=600.0)]


class CanConfig(Config):
    """A bus by python-can's names; `port` counts for udp_multicast alone."""

    interface: str = Field(min_length=1, max_length=40)
    channel: str = Field(min_length=1, max_length=80)
    port: int = Field(ge=1024, le=65535)


class LiveConfig(Config):
    """`configs/live.yaml`."""

    can: CanConfig
    ring_mib: dict[str, Annotated[int, Field(ge=1, le=1024)]]
    silent_s: dict[str, Seconds]
    start_s: Seconds

    @model_validator(mode="after")
    def _has_every_process(self) -> "LiveConfig":
        if set(self.ring_mib) != set(ROLES) or not set(self.silent_s) <= set(ROLES):
            raise ValueError(f"ring_mib must name {', '.join(ROLES)}, and silent_s some of them")
        return self


def open_bus(config: CanConfig) -> can.BusABC:
    """The bus; raises HeadlandError when it cannot be opened."""
    extra: dict[str, Any] = {"port": config.port} if config.interface == "udp_multicast" else {}
    try:
        return can.Bus(interface=config.interface, channel=config.channel, **extra)
    except (can.CanError, OSError, ImportError, ValueError) as error:
        raise HeadlandError(f"CAN bus {config.interface}:{config.channel} cannot be opened ({error})") from error
