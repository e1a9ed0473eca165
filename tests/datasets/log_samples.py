"""Random messages of every class of the topic table, from its annotations."""

from dataclasses import fields
from enum import Enum
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from messages.message import MessagePart
from messages.sensors import CameraImage

INT64 = st.integers(-(2**63), 2**63 - 1)
SHAPES = hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=4)


def arrays(dtype: np.dtype[Any]) -> st.SearchStrategy[np.ndarray]:
    """Arrays of arbitrary bits, including NaN payloads and negative zeros."""
    return SHAPES.flatmap(
        lambda shape: st.binary(
            min_size=int(np.prod(shape)) * dtype.itemsize, max_size=int(np.prod(shape)) * dtype.itemsize
        ).map(lambda data: np.frombuffer(data, dtype).reshape(shape).copy())
    )


def values(hint: Any) -> st.SearchStrategy[Any]:
    """Values of an annotation."""
    if get_origin(hint) is np.ndarray:
        return arrays(np.dtype(get_args(get_args(hint)[1])[0]))
    if get_origin(hint) is tuple:
        return st.lists(values(get_args(hint)[0]), max_size=3).map(tuple)
    if get_origin(hint) is UnionType:
        return st.one_of(*(st.none() if h is NoneType else values(h) for h in get_args(hint)))
    if issubclass(hint, Enum):
        return st.sampled_from(hint)
    if issubclass(hint, MessagePart):
        return messages(hint)
    plain = {bool: st.booleans(), int: INT64, float: st.floats(), bytes: st.binary(max_size=8)}
    return plain.get(hint, st.text(st.characters(exclude_categories=["Cs"]), max_size=8))


def messages(cls: type[MessagePart]) -> st.SearchStrategy[Any]:
    """Instances of a message class or message part."""
    hints = get_type_hints(cls)
    if cls is CameraImage:  # `encoded` cannot be random bytes, see test_log_codec.py
        return st.builds(cls, INT64, arrays(np.dtype(np.uint8)))
    return st.builds(cls, **{f.name: values(hints[f.name]) for f in fields(cls)})


def bits(value: Any) -> Any:
    """A value in a form that is equal only for equal bits."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, MessagePart):
        return type(value), *(bits(getattr(value, f.name)) for f in fields(value))
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    return (type(value), np.float64(value).tobytes()) if isinstance(value, float) else (type(value), value)
