"""Encoding and decoding of every message of the topic table, bit-exact."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from google.protobuf import text_format
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets import codec, schema
from datasets.arrays import filter_of, pack, unpack
from datasets.codec import classes, codec_for, codec_of
from geometry.arrays import Float64
from messages.errors import LogError
from messages.message import Message, MessagePart
from messages.motion import MapPose, PositionSource
from messages.sensors import CameraImage, ImuSample, LidarScan
from tests.datasets.log_samples import arrays, bits, messages

EXAMPLES = settings(max_examples=25, deadline=None, derandomize=True)


@pytest.mark.parametrize("name", sorted(classes()))
def test_message_round_trip(name: str) -> None:
    kind = classes()[name]

    @EXAMPLES
    @given(messages(kind))
    def check(message: Message) -> None:
        own = codec_of(kind)
        data = own.encode(message)
        assert bits(own.decode(data)) == bits(message)
        assert own.encode(own.decode(data)) == data
        generic = codec.proto_from(own.name, own.schema).FromString(data)
        assert generic.stamp_ns == message.stamp_ns
        assert generic.SerializeToString(deterministic=True) == data

    check()


@EXAMPLES
@given(st.sampled_from(["<f8", "<f4", "<u2", "|u1", "<i4"]).flatmap(lambda d: arrays(np.dtype(d))))
def test_array_round_trip_by_filter(array: np.ndarray) -> None:
    axes = min(array.ndim, 2) if array.itemsize in (2, 4) else 0
    names = ["", "planes", *[f"delta{axis}-planes" for axis in range(axes)]]
    for name in names:
        assert bits(unpack(pack(array, name), array.dtype.str, array.shape, name)) == bits(array)


@pytest.mark.parametrize("dtype", ["<u2", "<f4", "<i4"])
def test_large_array_round_trip(dtype: str) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, 32 * 1024 * np.dtype(dtype).itemsize, np.uint8).view(dtype).reshape(32, 1024)
    name = filter_of(image)
    assert name != ""
    assert bits(unpack(pack(image, name), dtype, image.shape, name)) == bits(image)
    extremes = np.tile(np.array([0, 65535, 1, 32768, 32767, 0], np.uint16), (3, 100))
    assert bits(unpack(pack(extremes, "delta1-planes"), "<u2", extremes.shape, "delta1-planes")) == bits(extremes)


@pytest.mark.parametrize(
    ("dtype", "shape", "data", "name", "says"),
    [
        ("|O8", (1,), b"12345678", "", "type"),
        ("<f8", (2,), b"12345678", "", "fill"),
        ("<f8", (1,), b"12345678", "zip", "filter"),
        ("<f4", (2,), b"12345678", "delta1-planes", "axis 1"),
        ("<f8", (1, 1), b"12345678", "delta0-planes", "axis 0"),
    ],
)
def test_invalid_array_refused(dtype: str, shape: tuple[int, ...], data: bytes, name: str, says: str) -> None:
    with pytest.raises(LogError, match=says):
        unpack(data, dtype, shape, name)


@EXAMPLES
@given(st.binary(max_size=60))
def test_invalid_bytes_raise_log_error(data: bytes) -> None:
    for kind in (ImuSample, LidarScan):
        try:
            codec_of(kind).decode(data)
        except LogError as error:
            said = str(error)
        else:
            continue
        assert kind.__name__ in said


def test_encoding_error_names_class() -> None:
    bad = ImuSample(2**70, np.zeros(3), np.zeros(3))
    with pytest.raises(LogError, match=r"headland\.v1\.ImuSample"):
        codec_of(ImuSample).encode(bad)


@dataclass(frozen=True, eq=False)
class _Part(MessagePart):
    names: tuple[str, ...]
    position: Float64


@dataclass(frozen=True, eq=False)
class _Outer(Message):
    level: float | None
    part: _Part | None
    parts: tuple[_Part, ...]
    rows: tuple[float, float]


@EXAMPLES
@given(messages(_Part), st.none() | st.floats())
def test_optional_value_round_trip(part: _Part, level: float | None) -> None:
    for one in (None, part):
        outer = _Outer(5, level, one, (part,) * 2, (0.0, -0.0))
        assert bits(codec_of(_Outer).decode(codec_of(_Outer).encode(outer))) == bits(outer)


def test_unsupported_field_type_refused() -> None:
    @dataclass(frozen=True, eq=False)
    class Odd(Message):
        table: dict[str, float]

    with pytest.raises(TypeError, match="table"):
        schema.fields_of(Odd)


def test_schema_of_other_version_matched_by_name() -> None:
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    own = codec_of(ImuSample)
    sample = ImuSample(7, np.arange(3.0), np.ones(3))
    files = FileDescriptorSet.FromString(own.schema)
    body = files.file[-1].message_type[0]
    for field in body.field:
        field.number += 10
    moved = files.SerializeToString()
    text = text_format.MessageToString(own.proto.FromString(own.encode(sample)))
    proto = text_format.Parse(text, codec.proto_from(own.name, moved)())
    assert bits(codec_for(own.name, moved).decode(proto.SerializeToString())) == bits(sample)
    body.field[2].name = "turn"
    with pytest.raises(LogError, match="rate_radps"):
        codec_for(own.name, files.SerializeToString())
    with pytest.raises(LogError, match="not a protobuf schema"):
        codec_for(own.name, b"\xff\xff")
    with pytest.raises(LogError, match="no such message"):
        codec_for("headland.v1.Nothing", own.schema)


def test_missing_field_with_default() -> None:
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    pose = MapPose(7, np.eye(4), np.eye(4), np.eye(6), PositionSource.SINGLE, 1.0, 2.0, True)
    own = codec_of(MapPose)
    files = FileDescriptorSet.FromString(own.schema)
    body = next(m for file in files.file for m in file.message_type if m.name == "MapPose")
    body.field.remove(next(f for f in body.field if f.name == "uwb_age_s"))
    old = codec.proto_from(own.name, files.SerializeToString())
    data = old.FromString(own.encode(replace(pose, uwb_age_s=3.0))).SerializeToString()
    assert bits(codec_for(own.name, files.SerializeToString()).decode(data)) == bits(pose)


@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_encoded_image_round_trip(ending: str) -> None:
    rough = np.random.default_rng(1).integers(0, 256, (72, 128, 3), np.uint8)
    sent = cv2.imencode(ending, cv2.GaussianBlur(rough, (9, 9), 3.0))[1].tobytes()
    bgr = cv2.imdecode(np.frombuffer(sent, np.uint8), cv2.IMREAD_COLOR)
    own = codec_of(CameraImage)
    for image in (CameraImage(5, bgr, sent), CameraImage(6, bgr.copy())):
        data = own.encode(image)
        assert bits(own.decode(data)) == bits(image)
        assert own.encode(own.decode(data)) == data
    assert len(own.encode(CameraImage(5, bgr, sent))) < len(sent) + 100
    with pytest.raises(LogError, match="an image of shape"):
        own.decode(own.encode(CameraImage(5, bgr[:-1].copy(), sent)))
    with pytest.raises(LogError, match="no image"):
        own.decode(own.encode(CameraImage(5, bgr, b"sent")))
