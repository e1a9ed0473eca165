"""Messages of a faulty device."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from messages.message import Message
from simulation.faults.config import FaultKind, FieldErrors

Array = np.ndarray[Any, np.dtype[Any]]


def with_stamp_of(last: Message, new: Message) -> Message:
    """The content of `last` with the stamp of `new`."""
    return replace(last, stamp_ns=new.stamp_ns)


def corrupt(
    kind: FaultKind, message: Message, errors: Mapping[str, FieldErrors], random: np.random.Generator
) -> Message:
    """The message with the configured fields corrupted."""
    changes: dict[str, Any] = {}
    for name, error in errors.items():
        value = getattr(message, name)
        if isinstance(value, np.ndarray):
            changes[name] = corrupt_values(kind, value, error, random)
        else:
            changes[name] = float(corrupt_values(kind, np.array([value], np.float64), error, random)[0])
    return replace(message, **changes)


def corrupt_values(kind: FaultKind, values: Array, error: FieldErrors, random: np.random.Generator) -> Array:
    """Corrupted values of any type; integers stay within their type, and 0 (no return) stays 0."""
    if kind is FaultKind.GARBAGE:
        return np.frombuffer(random.bytes(values.nbytes), values.dtype).reshape(values.shape).copy()
    if kind is FaultKind.NAN:
        return np.zeros_like(values) if values.dtype.kind in "iu" else np.full_like(values, np.nan)
    if kind is FaultKind.NOISY:
        wrong = values + error.noise * random.standard_normal(values.shape)
    elif kind is FaultKind.OFFSET:
        wrong = values + error.offset
    else:
        wrong = values * error.factor
    if values.dtype.kind not in "iu":
        return np.asarray(wrong.astype(values.dtype))
    bounds = np.iinfo(values.dtype)
    return np.where(values == 0, 0, np.clip(np.rint(wrong), bounds.min, bounds.max)).astype(values.dtype)
