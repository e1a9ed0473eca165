"""Base classes of messages, and the envelope."""

from dataclasses import dataclass, fields
from functools import cache
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np


@cache
def _array_dtypes(cls: type[Any]) -> tuple[tuple[str, np.dtype[Any]], ...]:
    """Name and element type of each array field; cached, used at every construction."""
    hints = get_type_hints(cls)
    named = [(f.name, hints[f.name]) for f in fields(cls)]
    return tuple((name, np.dtype(get_args(get_args(h)[1])[0])) for name, h in named if get_origin(h) is np.ndarray)


@cache
def _field_names(cls: type[Any]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(cls))


@dataclass(frozen=True, eq=False)
class MessagePart:
    """Frozen part of a message; its arrays are made read-only. Raises TypeError for an array of another type."""

    def __post_init__(self) -> None:
        for name, dtype in _array_dtypes(type(self)):  # type: ignore[arg-type]
            array = getattr(self, name)
            if not isinstance(array, np.ndarray) or (array.dtype is not dtype and array.dtype != dtype):
                raise TypeError(f"{type(self).__name__}.{name}: {getattr(array, 'dtype', type(array))}, not {dtype}")
            array.setflags(write=False)

    def __getstate__(self) -> dict[str, Any]:
        """The fields, for another process: without what a `cached_property` has computed from them."""
        return {name: self.__dict__[name] for name in _field_names(type(self))}  # type: ignore[arg-type]


@dataclass(frozen=True)
class Message(MessagePart):
    """Message between nodes; `stamp_ns` is the time of measurement."""

    stamp_ns: int


@dataclass(frozen=True)
class Envelope:
    """A delivered message: `sequence` counts from 0 per topic, `receive_ns` is the time of delivery."""

    topic: str
    sequence: int
    receive_ns: int
    message: Message
