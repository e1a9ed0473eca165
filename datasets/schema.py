"""Protobuf types `headland.v1.<Class>` from the annotations of message dataclasses.

float → double, int → sint64, bool, str and bytes unchanged, StrEnum → string, IntEnum → enum, MessagePart → message,
tuple → repeated, array → `headland.v1.Array`, `X | None` → optional. Field numbers follow the order in the class.
"""

import re
import types
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum, IntEnum, StrEnum
from functools import cache
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from messages.message import MessagePart

PACKAGE = "headland.v1"
ARRAY = f"{PACKAGE}.Array"
_POOL = DescriptorPool()
_SCALARS: dict[type, int] = {
    float: FieldDescriptorProto.TYPE_DOUBLE,
    int: FieldDescriptorProto.TYPE_SINT64,
    bool: FieldDescriptorProto.TYPE_BOOL,
    str: FieldDescriptorProto.TYPE_STRING,
    bytes: FieldDescriptorProto.TYPE_BYTES,
}


K = TypeVar("K")
V = TypeVar("V")


def once(function: Callable[[K], V]) -> Callable[[K], V]:
    """`functools.cache` for one argument, typed for classes as keys."""
    return cache(function)


@dataclass(frozen=True)
class FieldKind:
    """One field: element type (scalar, enum, MessagePart or np.ndarray), repeated, optional."""

    name: str
    type: type
    is_repeated: bool
    is_optional: bool


@once
def fields_of(cls: type[MessagePart]) -> tuple[FieldKind, ...]:
    """Fields of a message class; raises TypeError for a type that cannot be logged."""
    hints = get_type_hints(cls)
    return tuple(_kind(cls, f.name, hints[f.name]) for f in fields(cls))


@once
def proto_of(cls: type[MessagePart]) -> type[Any]:
    """The protobuf class of a message class."""
    _add(cls)
    return GetMessageClass(_POOL.FindMessageTypeByName(f"{PACKAGE}.{cls.__name__}"))


@once
def descriptors_of(cls: type[MessagePart]) -> bytes:
    """Serialized FileDescriptorSet of a class and its dependencies, for the MCAP schema record."""
    return descriptor_set(proto_of(cls).DESCRIPTOR.file)


def descriptor_set(file: Any) -> bytes:
    """A file and its imports, each once, dependencies first."""
    out, seen = FileDescriptorSet(), set()

    def append(one: Any) -> None:
        if one.name not in seen:
            seen.add(one.name)
            for dependency in one.dependencies:
                append(dependency)
            one.CopyToProto(out.file.add())

    append(file)
    return out.SerializeToString(deterministic=True)


def _kind(cls: type, name: str, hint: Any) -> FieldKind:
    is_optional = get_origin(hint) in (Union, types.UnionType)
    if is_optional:
        (hint,) = (h for h in get_args(hint) if h is not type(None))
    is_repeated = get_origin(hint) is tuple
    if is_repeated:
        (hint,) = set(get_args(hint)) - {...}
    if get_origin(hint) is np.ndarray:
        hint = np.ndarray
    if not isinstance(hint, type) or not issubclass(hint, (*_SCALARS, Enum, MessagePart, np.ndarray)):
        raise TypeError(f"{cls.__name__}.{name}: {hint} cannot be logged")
    if is_optional and is_repeated:
        raise TypeError(f"{cls.__name__}.{name}: an optional tuple cannot be logged")
    return FieldKind(name, hint, is_repeated, is_optional)


@once
def _add(cls: type[MessagePart]) -> str:
    """Adds the file of the class to the pool, after its dependencies; returns its name."""
    file = FileDescriptorProto(name=f"headland/v1/{cls.__name__}.proto", package=PACKAGE, syntax="proto3")
    body = file.message_type.add(name=cls.__name__)
    for number, kind in enumerate(fields_of(cls), start=1):
        needed = _add_field(body, number, kind)
        if needed is not None and needed not in file.dependency:
            file.dependency.append(needed)
    _POOL.Add(file)
    return file.name


def _add_field(body: DescriptorProto, number: int, kind: FieldKind) -> str | None:
    repeated = FieldDescriptorProto.LABEL_REPEATED if kind.is_repeated else FieldDescriptorProto.LABEL_OPTIONAL
    field = body.field.add(name=kind.name, number=number, label=repeated)
    if kind.is_optional:
        field.proto3_optional, field.oneof_index = True, len(body.oneof_decl)
        body.oneof_decl.add(name=f"_{kind.name}")
    if issubclass(kind.type, StrEnum):
        field.type = FieldDescriptorProto.TYPE_STRING
        return None
    if kind.type in _SCALARS:
        field.type = _SCALARS[kind.type]  # type: ignore[assignment]
        return None
    is_enum = issubclass(kind.type, IntEnum)
    field.type = FieldDescriptorProto.TYPE_ENUM if is_enum else FieldDescriptorProto.TYPE_MESSAGE
    name, needed = _add_type(kind.type)
    field.type_name = f".{name}"
    return needed


def _add_type(cls: type[Any]) -> tuple[str, str]:
    if issubclass(cls, np.ndarray):
        return ARRAY, _add_array()
    return f"{PACKAGE}.{cls.__name__}", _add_enum(cls) if issubclass(cls, IntEnum) else _add(cls)


@once
def _add_enum(cls: type[IntEnum]) -> str:
    """Value names have the enum name as prefix (one protobuf scope per package); the first value must be 0."""
    file = FileDescriptorProto(name=f"headland/v1/{cls.__name__}.proto", package=PACKAGE, syntax="proto3")
    body = file.enum_type.add(name=cls.__name__)
    prefix = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).upper()
    for member in sorted(cls, key=lambda m: (m != 0, m)):
        body.value.add(name=f"{prefix}_{member.name}", number=int(member))
    if body.value[0].number != 0:
        raise TypeError(f"{cls.__name__}: has no value 0, which protobuf requires")
    _POOL.Add(file)
    return file.name


@cache
def _add_array() -> str:
    file = FileDescriptorProto(name="headland/v1/Array.proto", package=PACKAGE, syntax="proto3")
    body = file.message_type.add(name="Array")
    for number, (name, kind) in enumerate(
        [
            ("dtype", FieldDescriptorProto.TYPE_STRING),
            ("shape", FieldDescriptorProto.TYPE_UINT32),
            ("data", FieldDescriptorProto.TYPE_BYTES),
            ("filter", FieldDescriptorProto.TYPE_STRING),
        ],
        start=1,
    ):
        many = FieldDescriptorProto.LABEL_REPEATED if name == "shape" else FieldDescriptorProto.LABEL_OPTIONAL
        body.field.add(name=name, number=number, type=kind, label=many)
    _POOL.Add(file)
    return file.name
