"""Configuration of the operator's page (`configs/page.yaml`)."""

from pydantic import Field

from configs.strict import Config
from hmi.notification.config import NotificationConfig
from hmi.upload.config import UploadConfig

LANGUAGES = ("en", "zh")


class SessionConfig(Config):
    """Log-in and the seat of the operator, of whom there is one at a time."""

    idle_s: float = Field(ge=10.0, le=86400.0, description="a session ends after this time without an action")
    max_s: float = Field(ge=60.0, le=604800.0, description="a session ends after this time in any case")
    attempts: int = Field(ge=1, le=100, description="wrong passwords within attempts_s, then log-in is refused")
    attempts_s: float = Field(ge=1.0, le=3600.0)
    seat_s: float = Field(ge=1.0, le=600.0, description="the seat is free when its holder has had no page for so long")


class PageConfig(Config):
    """Ports on the loopback interface, period of the page, and validity of its orders."""

    port: int = Field(ge=0, le=65535)
    stop_port: int = Field(ge=0, le=65535, description="of the emergency stop, a process of its own")
    foxglove_port: int | None = Field(
        ge=0, le=65535, description="of the Foxglove server on the loopback interface; null: none"
    )
    foxglove_origins: tuple[str, ...] = Field(description="pages that may connect to it, such as that of Lichtblick")
    period_s: float = Field(ge=0.1, le=5.0, description="between two updates of all pages")
    order_valid_s: float = Field(gt=0.0, le=60.0)
    confirmation_valid_s: float = Field(gt=0.0, le=60.0, description="at most modes.max_confirmation_s")
    lost_operator_s: float | None = Field(
        ge=2.0,
        le=3600.0,
        description="without the operator's page the simulated machine stops; null: it drives on",
    )
    cell_m: float = Field(ge=0.05, le=5.0, description="cells in which the worked area is counted")
    plan_limit_s: float = Field(ge=1.0, le=86400.0, description="a planner without result is ended after this time")
    session: SessionConfig
    notification: NotificationConfig
    upload: UploadConfig
