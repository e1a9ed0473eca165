"""Messages to bytes and back, exact to the bit, by functions generated once for each class.

Reflection on every message would cost ten times as much as the encoding itself, so each class gets the source text of a
`fill(proto, message)` and a `build(proto)` with its fields spelled out, compiled on first use.
"""

from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields
from enum import Enum
from functools import cache
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

from datasets.arrays import SENT, Array, filter_of, pack, unpack
from datasets.schema import PACKAGE, FieldKind, descriptors_of, fields_of, once, proto_of
from messages.errors import LogError
from messages.message import Message, MessagePart
from messages.sensors import CameraImage
from messages.topics import TOPICS

Fill = Callable[[Any, Any], None]
Build = Callable[[Any], Any]


@dataclass(frozen=True)
class Codec:
    """How one message class is written and read; `schema` is its FileDescriptorSet."""

    name: str
    schema: bytes
    proto: type[Any]
    fill: Fill
    build: Build

    def encode(self, message: Message) -> bytes:
        """The message as protobuf; raises LogError naming what cannot be written."""
        proto = self.proto()
        try:
            self.fill(proto, message)
        except (TypeError, ValueError, AttributeError) as error:
            raise LogError(f"{self.name}: cannot be encoded ({error})") from error
        data: bytes = proto.SerializeToString()
        return data

    def decode(self, data: bytes) -> Message:
        """The message; raises LogError when the bytes are not one."""
        try:
            message: Message = self.build(self.proto.FromString(data))
        except (DecodeError, LogError, TypeError, ValueError) as error:
            raise LogError(f"{self.name}: cannot be decoded ({error})") from error
        return message


@once
def codec_of(cls: type[Message]) -> Codec:
    """The codec of a message class."""
    return Codec(f"{PACKAGE}.{cls.__name__}", descriptors_of(cls), proto_of(cls), *_ways_of(cls, frozenset()))


def _ways_of(cls: type[Message], lacking: frozenset[str]) -> tuple[Fill, Build]:
    return (_fill_image, _build_image) if cls is CameraImage else (_fill_of(cls), _build_of(cls, lacking))


@cache
def classes() -> dict[str, type[Message]]:
    """All message classes of the topic table by schema name."""
    return {f"{PACKAGE}.{row.type.__name__}": row.type for row in TOPICS.values()}


@cache
def codec_for(name: str, schema: bytes) -> Codec:
    """The codec for a schema found in a log, which may be of another version than ours.

    Fields are matched by name and type; one that the log has not gets its default. Raises LogError when the class is
    unknown here, a field has another type, or one without default is missing.
    """
    cls = classes().get(name)
    if cls is None:
        raise LogError(f"schema {name!r}: no such message (known: {', '.join(classes())})")
    own = codec_of(cls)
    if schema == own.schema:
        return own
    proto = proto_from(name, schema)
    try:
        lacking = frozenset(_lacking(cls, own.proto.DESCRIPTOR, proto.DESCRIPTOR))
    except ValueError as error:
        raise LogError(f"schema {name!r} was written by another version: {error}") from error
    return Codec(name, schema, proto, *_ways_of(cls, lacking))


def proto_from(name: str, schema: bytes) -> type[Any]:
    """The protobuf class `name` of an embedded FileDescriptorSet; raises LogError."""
    pool = DescriptorPool()
    try:
        left = {file.name: file for file in FileDescriptorSet.FromString(schema).file}
        while left:
            ready = [f for f in left.values() if not any(d in left for d in f.dependency)]
            if not ready:
                raise LogError(f"schema {name!r}: its files depend on each other: {', '.join(left)}")
            for file in ready:
                pool.Add(left.pop(file.name))
        return GetMessageClass(pool.FindMessageTypeByName(name))
    except (DecodeError, KeyError, TypeError, ValueError) as error:
        raise LogError(f"schema {name!r}: not a protobuf schema ({error})") from error


def _lacking(cls: type[MessagePart] | None, ours: Any, theirs: Any, where: str = "") -> Iterator[str]:
    """Fields of ours (dotted below a record's) that the log has not and that have a default; ValueError for others."""
    kinds = {kind.name: kind for kind in fields_of(cls)} if cls is not None else {}
    optional = _with_default(cls) if cls is not None else frozenset()
    for field in ours.fields:
        other = theirs.fields_by_name.get(field.name)
        if other is None and field.name in optional:
            yield where + field.name
        elif other is None:
            raise ValueError(f"field {where + field.name!r} is not in the log")
        elif (other.type, other.is_repeated) != (field.type, field.is_repeated):
            raise ValueError(f"field {where + field.name!r} has another type")
        elif field.message_type is not None:
            inner = kinds[field.name].type if field.name in kinds else None
            record = inner if inner is not None and issubclass(inner, MessagePart) else None
            yield from _lacking(record, field.message_type, other.message_type, f"{where}{field.name}.")


def _with_default(cls: type[MessagePart]) -> frozenset[str]:
    return frozenset(f.name for f in fields(cls) if f.default is not MISSING or f.default_factory is not MISSING)


def _fill_array(proto: Any, array: Array) -> None:
    proto.dtype = array.dtype.str
    proto.shape.extend(array.shape)
    name = filter_of(array)
    if name:
        proto.filter = name
    proto.data = pack(array, name)


def _build_array(proto: Any) -> Array:
    return unpack(proto.data, proto.dtype, tuple(proto.shape), proto.filter)


def _fill_image(proto: Any, image: CameraImage) -> None:
    """What the camera sent stands for the picture: 30 times smaller, and decoding it gives the same bits."""
    proto.stamp_ns = image.stamp_ns
    if not image.encoded:
        _fill_array(proto.bgr, image.bgr)
        return
    proto.bgr.dtype, proto.bgr.filter, proto.bgr.data = image.bgr.dtype.str, SENT, image.encoded
    proto.bgr.shape.extend(image.bgr.shape)


def _build_image(proto: Any) -> CameraImage:
    return CameraImage(proto.stamp_ns, _build_array(proto.bgr), proto.bgr.data if proto.bgr.filter == SENT else b"")


@once
def _fill_of(cls: type[MessagePart]) -> Fill:
    scope: dict[str, Any] = {"_fill_array": _fill_array}
    lines = ["def fill(p, m):"]
    for kind in fields_of(cls):
        scope[f"_fill_{kind.name}"] = _filler(kind)
        lines += [f"    {line}" for line in _fill_lines(kind)]
    exec(compile("\n".join(lines), f"<fill {cls.__name__}>", "exec"), scope)
    fill: Fill = scope["fill"]
    return fill


def _filler(kind: FieldKind) -> Fill | None:
    if issubclass(kind.type, np.ndarray):
        return _fill_array
    return _fill_of(kind.type) if issubclass(kind.type, MessagePart) else None


def _fill_lines(kind: FieldKind) -> list[str]:
    name, is_message = kind.name, issubclass(kind.type, (np.ndarray, MessagePart))
    if kind.is_repeated and is_message:
        return [f"for x in m.{name}: _fill_{name}(p.{name}.add(), x)"]
    if kind.is_repeated:
        return [f"p.{name}.extend(m.{name})"]
    lines = [f"p.{name}.SetInParent()", f"_fill_{name}(p.{name}, m.{name})"] if is_message else [f"p.{name} = m.{name}"]
    return [f"if m.{name} is not None:", *(f"    {line}" for line in lines)] if kind.is_optional else lines


def _build_of(cls: type[MessagePart], lacking: frozenset[str] = frozenset()) -> Build:
    """`lacking` names the fields, dotted below a record's, that are left to their defaults."""
    scope: dict[str, Any] = {"cls": cls}
    values = []
    for kind in fields_of(cls):
        if kind.name not in lacking:
            below = frozenset(n.removeprefix(f"{kind.name}.") for n in lacking if n.startswith(f"{kind.name}."))
            scope[f"_build_{kind.name}"] = _builder(kind, below)
            values.append(f"{kind.name}={_build_text(kind)}")
    exec(compile(f"def build(p): return cls({', '.join(values)})", f"<build {cls.__name__}>", "exec"), scope)
    build: Build = scope["build"]
    return build


def _builder(kind: FieldKind, lacking: frozenset[str] = frozenset()) -> Build | None:
    if issubclass(kind.type, np.ndarray):
        return _build_array
    if issubclass(kind.type, Enum):
        return kind.type
    return _build_of(kind.type, lacking) if issubclass(kind.type, MessagePart) else None


def _build_text(kind: FieldKind) -> str:
    name, call = kind.name, f"_build_{kind.name}" if _builder(kind) else ""
    if kind.is_repeated:
        return f"tuple(map({call}, p.{name}))" if call else f"tuple(p.{name})"
    text = f"{call}(p.{name})"
    return f"({text} if p.HasField('{name}') else None)" if kind.is_optional else text
