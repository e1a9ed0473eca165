"""The message and the envelope in which it travels."""

from dataclasses import dataclass, fields
from functools import cache
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from geometry.arrays import Float32 as Float32
from geometry.arrays import Float64 as Float64
from geometry.arrays import Int32 as Int32
from geometry.arrays import Int64 as Int64
from geometry.arrays import UInt8 as UInt8
from geometry.arrays import UInt16 as UInt16


@cache
def _array_dtypes(cls: type[Any]) -> tuple[tuple[str, np.dtype[Any]], ...]:
    """Name and type of each array field; cached, since every construction asks."""
    hints = get_type_hints(cls)
    named = [(f.name, hints[f.name]) for f in fields(cls)]
    return tuple((name, np.dtype(get_args(get_args(h)[1])[0])) for name, h in named if get_origin(h) is np.ndarray)


@dataclass(frozen=True, eq=False)
class MessagePart:
    """A frozen part of a message; its arrays are made read-only and belong to it from then on.

    Raises TypeError when an array has not the declared type.
    """

    def __post_init__(self) -> None:
        for name, dtype in _array_dtypes(type(self)):  # type: ignore[arg-type]
            array = getattr(self, name)
            if not isinstance(array, np.ndarray) or array.dtype != dtype:
                raise TypeError(f"{type(self).__name__}.{name}: {getattr(array, 'dtype', type(array))}, not {dtype}")
            array.flags.writeable = False


@dataclass(frozen=True)
class Message(MessagePart):
    """What a node reads or writes; `stamp_ns` is the time of measurement."""

    stamp_ns: int


@dataclass(frozen=True)
class Envelope:
    """A message on its way: `sequence` counts from 0 on its topic, `receive_ns` is when it was delivered."""

    topic: str
    sequence: int
    receive_ns: int
    message: Message
