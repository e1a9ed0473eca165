"""Every message of the topic table goes into bytes and comes back to the bit."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
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
from tests.datasets.log_samples import arrays, bits, records

EXAMPLES = settings(max_examples=25, deadline=None, derandomize=True)


@pytest.mark.parametrize("name", sorted(classes()))
def test_every_message_comes_back_to_the_bit(name: str) -> None:
    kind = classes()[name]

    @EXAMPLES
    @given(records(kind))
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
def test_arrays_pass_every_filter_that_takes_them(array: np.ndarray) -> None:
    axes = min(array.ndim, 2) if array.itemsize in (2, 4) else 0
    names = ["", "planes", *[f"delta{axis}-planes" for axis in range(axes)]]
    for name in names:
        assert bits(unpack(pack(array, name), array.dtype.str, array.shape, name)) == bits(array)


@pytest.mark.parametrize("dtype", ["<u2", "<f4", "<i4"])
def test_large_arrays_are_filtered_and_come_back(dtype: str) -> None:
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
def test_a_wrong_array_is_refused(dtype: str, shape: tuple[int, ...], data: bytes, name: str, says: str) -> None:
    with pytest.raises(LogError, match=says):
        unpack(data, dtype, shape, name)


@EXAMPLES
@given(st.binary(max_size=60))
def test_bytes_that_are_no_message_are_an_error_not_a_crash(data: bytes) -> None:
    for kind in (ImuSample, LidarScan):
        try:
            codec_of(kind).decode(data)
        except LogError as error:
            said = str(error)
        else:
            continue
        assert kind.__name__ in said


def test_what_cannot_be_written_is_named() -> None:
    bad = ImuSample(2**70, np.zeros(3), np.zeros(3))
    with pytest.raises(LogError, match=r"headland\.v1\.ImuSample"):
        codec_of(ImuSample).encode(bad)


@dataclass(frozen=True, eq=False)
class _Part(MessagePart):
    names: tuple[str, ...]
    place: Float64


@dataclass(frozen=True, eq=False)
class _Whole(Message):
    level: float | None
    part: _Part | None
    parts: tuple[_Part, ...]
    rows: tuple[float, float]


@EXAMPLES
@given(records(_Part), st.none() | st.floats())
def test_a_value_that_may_be_missing_comes_back_as_it_was(part: _Part, level: float | None) -> None:
    for one in (None, part):
        whole = _Whole(5, level, one, (part,) * 2, (0.0, -0.0))
        assert bits(codec_of(_Whole).decode(codec_of(_Whole).encode(whole))) == bits(whole)


def test_a_type_without_a_place_in_a_log_is_refused() -> None:
    @dataclass(frozen=True, eq=False)
    class Odd(Message):
        table: dict[str, float]

    with pytest.raises(TypeError, match="table"):
        schema.fields_of(Odd)


def test_a_log_of_another_version_is_read_by_name_or_refused_by_name() -> None:
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    own = codec_of(ImuSample)
    sample = ImuSample(7, np.arange(3.0), np.ones(3))
    files = FileDescriptorSet.FromString(own.schema)
    body = files.file[-1].message_type[0]
    for field in body.field:
        field.number += 10
    moved = files.SerializeToString()
    proto = codec.proto_from(own.name, moved)()
    own.fill(proto, sample)
    assert bits(codec_for(own.name, moved).decode(proto.SerializeToString())) == bits(sample)
    body.field[2].name = "turn"
    with pytest.raises(LogError, match="rate_radps"):
        codec_for(own.name, files.SerializeToString())
    with pytest.raises(LogError, match="not a protobuf schema"):
        codec_for(own.name, b"\xff\xff")
    with pytest.raises(LogError, match="no such message"):
        codec_for("headland.v1.Nothing", own.schema)


def test_a_field_with_a_default_may_be_missing_in_an_older_log() -> None:
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
def test_a_picture_comes_back_as_the_camera_sent_it(ending: str) -> None:
    rough = np.random.default_rng(1).integers(0, 256, (72, 128, 3), np.uint8)
    sent = cv2.imencode(ending, cv2.GaussianBlur(rough, (9, 9), 3.0))[1].tobytes()
    bgr = cv2.imdecode(np.frombuffer(sent, np.uint8), cv2.IMREAD_COLOR)
    own = codec_of(CameraImage)
    for image in (CameraImage(5, bgr, sent), CameraImage(6, bgr.copy())):
        data = own.encode(image)
        assert bits(own.decode(data)) == bits(image)
        assert own.encode(own.decode(data)) == data
    assert len(own.encode(CameraImage(5, bgr, sent))) < len(sent) + 100
    with pytest.raises(LogError, match="a picture of shape"):
        own.decode(own.encode(CameraImage(5, bgr[:-1].copy(), sent)))
    with pytest.raises(LogError, match="no picture"):
        own.decode(own.encode(CameraImage(5, bgr, b"sent")))
