"""Raw images in all encodings, cut JPEG and PNG, video with lost packets."""

from fractions import Fraction
from typing import Any

import cv2
import numpy as np
import pytest

from datasets.importers.images import VideoDecoder, codec_of_video, decode_image, decode_raw
from messages.errors import LogError

av = pytest.importorskip("av")
HEIGHT, WIDTH = 32, 48
# Uniform in blocks of 8 pixels, so that neither Bayer patterns nor shared chroma change colours inside a block.
BLOCKS: Any = np.random.default_rng(1).integers(30, 220, (HEIGHT // 8, WIDTH // 8, 3))
BGR: Any = np.kron(BLOCKS, np.ones((8, 8, 1))).astype(np.uint8)
INSIDE = (slice(3, None, 8), slice(3, None, 8))
BAYER_COLORS = {"r": 2, "g": 1, "b": 0}


def raw(encoding: str) -> Any:
    """The image in an encoding, (height, bytes)."""
    gray = cv2.cvtColor(BGR, cv2.COLOR_BGR2GRAY)[..., None]
    bits16 = encoding.endswith("16")
    name = encoding.removesuffix("16").removesuffix("8")
    if name.startswith("bayer_"):
        out = np.zeros((HEIGHT, WIDTH, 1), np.uint8)
        for k, color in enumerate(name[-4:]):
            out[k // 2 :: 2, k % 2 :: 2, 0] = BGR[k // 2 :: 2, k % 2 :: 2, BAYER_COLORS[color]]
    elif name in ("yuv422", "yuv422_yuy2"):
        yuv = cv2.cvtColor(BGR, cv2.COLOR_BGR2YUV_UYVY if name == "yuv422" else cv2.COLOR_BGR2YUV_YUY2)
        out = yuv.reshape(HEIGHT, WIDTH, 2)
    else:
        alpha = np.full((HEIGHT, WIDTH, 1), 9, np.uint8)
        out = {
            "bgr": BGR, "rgb": BGR[..., ::-1], "bgra": np.dstack([BGR, alpha]), "mono": gray,
            "rgba": np.dstack([BGR[..., ::-1], alpha]), "8UC1": gray, "8UC3": BGR,
        }[name if name != "8UC" else encoding]  # fmt: skip
    return (out.astype("<u2") << 8 | 7).view(np.uint8).reshape(HEIGHT, -1) if bits16 else out.reshape(HEIGHT, -1)


ENCODINGS = ["bgr8", "rgb8", "bgra8", "rgba8", "8UC3", "rgb16", "bgr16", "yuv422", "yuv422_yuy2"]
ENCODINGS += [f"bayer_{p}{bits}" for p in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)]


@pytest.mark.parametrize("encoding", [*ENCODINGS, "mono8", "mono16", "8UC1"])
def test_raw_image(encoding: str) -> None:
    rows = np.pad(raw(encoding), ((0, 0), (0, 5)))
    bgr = decode_raw(encoding, WIDTH, HEIGHT, rows.shape[1], rows.tobytes())
    expected: Any = BGR
    if encoding.startswith(("mono", "8UC1")):
        expected = cv2.cvtColor(cv2.cvtColor(BGR, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    tolerance = 12 if encoding.startswith("yuv") else 0  # studio range
    difference = np.abs(bgr[INSIDE].astype(int) - expected[INSIDE])
    assert bgr.shape == BGR.shape
    assert difference.max() <= tolerance, encoding


def test_raw_image_with_bytes_swapped() -> None:
    rows = raw("rgb16").view("<u2").astype(">u2").view(np.uint8)
    np.testing.assert_array_equal(decode_raw("rgb16", WIDTH, HEIGHT, rows.shape[1], rows.tobytes(), True), BGR)


@pytest.mark.parametrize(
    ("encoding", "width", "height", "step", "length", "text"),
    [
        ("16UC1", 4, 4, 8, 32, "depth image"), ("32FC1", 4, 4, 16, 64, "depth image"),
        ("x", 4, 4, 4, 16, "is not one of"),
        ("rgb8", 4, 4, 11, 48, "11 bytes per row"), ("rgb8", 4, 4, 12, 47, "47 bytes only"),
        ("rgb8", 0, 0, 0, 0, "0 x 0"), ("mono8", 2**31, 2**31, 2**31, 16, "16 bytes only"),
    ],
)  # fmt: skip
def test_contradictory_image_refused(encoding: str, width: int, height: int, step: int, length: int, text: str) -> None:
    with pytest.raises(LogError, match=text):
        decode_raw(encoding, width, height, step, bytes(length))


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_cut_file_refused(suffix: str) -> None:
    data = cv2.imencode(suffix, BGR)[1].tobytes()
    assert decode_image(data).shape == decode_image(data + b"\0" * 9).shape == BGR.shape
    for share in (0.0, 0.1, 0.5, 0.9, 0.99):
        with pytest.raises(LogError, match=r"is cut|neither JPEG nor PNG"):
            decode_image(data[: int(share * len(data))])


def test_video_formats() -> None:
    names = {"h264": "h264", "libx264;yuv420p;bgr24": "hevc", "h265": "hevc", "jpeg": None, "": None}
    names["libx264;yuv420p;bgr24"] = "h264"
    assert {text: codec_of_video(text) for text in names} == names


def packets(codec: str) -> list[bytes]:
    """30 pictures of a bright square that moves by 4 pixels, a key frame every 10."""
    encoder = av.CodecContext.create(codec, "w")
    encoder.width, encoder.height, encoder.pix_fmt, encoder.time_base = 320, 160, "yuv420p", Fraction(1, 10)
    options = "keyint=10:min-keyint=10:scenecut=0:bframes=0"
    encoder.options = {"tune": "zerolatency", f"{codec.removeprefix('lib')}-params": options}
    out = []
    for k in range(30):
        frame = av.VideoFrame.from_ndarray(picture(k), format="bgr24").reformat(format="yuv420p")
        frame.pts = k
        out += [bytes(p) for p in encoder.encode(frame)]
    return out + [bytes(p) for p in encoder.encode(None)]


def picture(k: int) -> np.ndarray:
    out = np.full((160, 320, 3), 40, np.uint8)
    out[40:100, 8 * k : 8 * k + 60] = 220
    return out


@pytest.mark.parametrize(("codec", "name"), [("libx264", "h264"), ("libx265", "hevc")])
def test_video_from_key_frame_on(codec: str, name: str) -> None:
    stream = packets(codec)
    assert len(stream) == 30
    decoder, read, failed = VideoDecoder(), [], []
    for k, packet in enumerate(stream):
        if k in (15, 16):  # broken: noise after the start of the packet
            packet = packet[:8] + np.random.default_rng(k).bytes(40)
        try:
            image = decoder.decode(name, packet, k)
        except LogError:
            failed.append(k)
            continue
        read.append(k)
        if k < 15 or k >= 20:
            assert np.abs(image.bgr.astype(int) - picture(k)).mean() < 6.0, k
            np.testing.assert_array_equal(decode_image(image.encoded), image.bgr)
    assert set(range(15)) | set(range(20, 30)) <= set(read)
    assert failed
    assert set(failed) <= set(range(15, 20))


def test_video_without_key_frame_has_no_picture() -> None:
    decoder, stream = VideoDecoder(), packets("libx264")
    for packet in stream[3:10]:
        with pytest.raises(LogError, match=r"no picture|packet of"):
            decoder.decode("h264", packet, 0)
    assert decoder.decode("h264", stream[10], 7).stamp_ns == 7
