"""Faults: what is wrong, how bad it is and what the machine does about it."""

from dataclasses import dataclass
from enum import IntEnum

from messages.message import Message


class Severity(IntEnum):
    """How the operator is told."""

    NOTICE = 0
    WARNING = 1
    ALARM = 2


class Response(IntEnum):
    """What the machine does, from least to most restrictive."""

    NONE = 0
    LIMIT = 1
    CONTROLLED_STOP = 2
    EMERGENCY_STOP = 3


@dataclass(frozen=True)
class Fault(Message):
    """Something wrong in `source` (a node or sensor), or right again (`is_active` false).

    `code` is dotted, such as "lidar.silent"; `text_en` and `text_zh` are for the operator.
    """

    code: str
    source: str
    severity: Severity
    is_latched: bool
    response: Response
    is_active: bool
    text_en: str
    text_zh: str
