"""Configuration of the thinned log of `live`."""

from typing import Annotated

from pydantic import Field

from configs.strict import Config


class ThinnedLogConfig(Config):
    """What the log of `live` leaves out: kinds of topics, or all but one message in `period_s`.

    Around an event, from `before_s` to `after_s`, a log of at most `event_mb` has every message.
    """

    left_out: tuple[str, ...]
    period_s: dict[str, Annotated[float, Field(gt=0.0, le=60.0)]]
    mb_per_s: float = Field(gt=0.0, le=1000.0)
    image_s: float = Field(gt=0.0, le=60.0)
    cloud_s: float = Field(gt=0.0, le=60.0)
    before_s: float = Field(ge=0.0, le=60.0)
    after_s: float = Field(ge=0.0, le=60.0)
    event_mb: float = Field(ge=1.0, le=1000.0)
