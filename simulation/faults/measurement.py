"""Messages of a faulty device."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from messages.message import Message
from simulation.faults.config import FaultKind, FieldErrors, PlausibleErrors

Array = np.ndarray[Any, np.dtype[Any]]


def with_stamp_of(last: Message, new: Message) -> Message:
    """The content of `last` with the stamp of `new`."""
    return replace(last, stamp_ns=new.stamp_ns)


@dataclass(frozen=True)
class Corruption:
    """Wrong values of one kind."""

    kind: FaultKind
    plausible: PlausibleErrors
    random: np.random.Generator

    def message(self, message: Message, errors: Mapping[str, FieldErrors], since_s: float) -> Message:
        """The message with the configured fields corrupted, `since_s` after the fault began."""
        changes: dict[str, Any] = {}
        for name, error in errors.items():
            value = getattr(message, name)
            if isinstance(value, np.ndarray):
                changes[name] = self.values(value, error, since_s)
            else:
                changes[name] = float(self.values(np.array([value], np.float64), error, since_s)[0])
        return replace(message, **changes)

    def values(self, values: Array, error: FieldErrors, since_s: float) -> Array:
        """Corrupted values of any type; integers stay within their type, and 0 (no return) stays 0."""
        if self.kind is FaultKind.GARBAGE:
            return np.frombuffer(self.random.bytes(values.nbytes), values.dtype).reshape(values.shape).copy()
        if self.kind is FaultKind.NAN:
            return np.zeros_like(values) if values.dtype.kind in "iu" else np.full_like(values, np.nan)
        wrong = self._wrong(values, error, since_s)
        if values.dtype.kind not in "iu":
            return np.asarray(wrong.astype(values.dtype))
        bounds = np.iinfo(values.dtype)
        return np.where(values == 0, 0, np.clip(np.rint(wrong), bounds.min, bounds.max)).astype(values.dtype)

    def _wrong(self, values: Array, error: FieldErrors, since_s: float) -> Array:
        match self.kind:
            case FaultKind.NOISY:
                return np.asarray(values + error.noise * self.random.standard_normal(values.shape))
            case FaultKind.OFFSET:
                return np.asarray(values + error.offset)
            case FaultKind.DRIFT:
                return np.asarray(values + error.offset * since_s / self.plausible.drift_s)
            case FaultKind.SCALE:
                return np.asarray(values * self.plausible.scale)
            case FaultKind.SIGN:
                return np.asarray(-values)
            case _:
                return np.asarray(values * error.factor)
