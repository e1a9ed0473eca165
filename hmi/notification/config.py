"""Configuration of the notifications (`configs/page.yaml`, section `notification`)."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from configs.strict import Config

Address = Annotated[str, Field(pattern=r"^[^@\s<>,;]+@[^@\s<>,;]+$", max_length=200)]


class EmailConfig(Config):
    """Mail server (SMTP) and addresses; the password is in a file that only this user can read."""

    host: str = Field(min_length=1, max_length=200)
    port: int = Field(ge=1, le=65535)
    security: Literal["tls", "starttls", "none"]
    user: str | None = None
    password_file: Path | None = None
    sender: Address
    recipients: tuple[Address, ...] = Field(min_length=1, max_length=20)

    @model_validator(mode="after")
    def _password_is_encrypted(self) -> "EmailConfig":
        if (self.user is None) != (self.password_file is None):
            raise ValueError("user and password_file: both or neither")
        if self.user is not None and self.security == "none":
            raise ValueError(f"security 'none': the password of {self.user!r} would be sent in clear text")
        return self


class NotificationConfig(Config):
    """When and how somebody is called; without `email` and `webhook` nobody is."""

    after_s: float = Field(ge=0.0, le=3600.0, description="the machine has to need somebody for so long")
    language: Literal["en", "zh"]
    email: EmailConfig | None = None
    webhook: str | None = Field(
        default=None, pattern=r"^https?://[^\s]+$", max_length=500, description="gets each notification as JSON by POST"
    )
