"""Faults with severity and response."""

from dataclasses import dataclass
from enum import IntEnum

from messages.message import Message


class Severity(IntEnum):
    """Level of the operator alarm."""

    NOTICE = 0
    WARNING = 1
    ALARM = 2


class Response(IntEnum):
    """Response of the machine, from least to most restrictive."""

    NONE = 0
    LIMIT = 1
    CONTROLLED_STOP = 2
    EMERGENCY_STOP = 3


@dataclass(frozen=True)
class Fault(Message):
    """A fault of `source` (a node or sensor), or its end (`is_active` false).

    `code` is dotted, such as "lidar.silent"; `text_en` and `text_zh` are shown to the operator.
    """

    code: str
    source: str
    severity: Severity
    is_latched: bool
    response: Response
    is_active: bool
    text_en: str
    text_zh: str
