"""Configuration of the upload (`configs/page.yaml`, section `upload`)."""

from pathlib import Path

from pydantic import Field

from configs.strict import Config


class UploadConfig(Config):
    """Platform and times; without `url` nothing is queued and nothing is sent."""

    url: str | None = Field(default=None, pattern=r"^https?://[^\s]+$", max_length=500)
    token_file: Path | None = Field(default=None, description="file with the token of the header `Authorization`")
    every_s: float = Field(gt=0.0, le=86400.0, description="between two items with the totals of a drive")
    pause_s: float = Field(gt=0.0, le=3600.0, description="between two requests when the queue is empty")
    max_pause_s: float = Field(gt=0.0, le=86400.0, description="pauses double to this after failures")
    timeout_s: float = Field(gt=0.0, le=300.0, description="of a request")
