"""Camera images: raw encodings of ROS and Foxglove, JPEG, PNG, and video packets, to BGR."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from geometry.arrays import UInt8
from messages.errors import LogError
from messages.sensors import CameraImage


@dataclass(frozen=True)
class Encoding:
    """A raw encoding: channels of a pixel, bytes of a channel, and OpenCV's conversion to BGR (None = BGR)."""

    channels: int
    bytes: int
    conversion: int | None


BAYER = {
    "rggb": cv2.COLOR_BayerRGGB2BGR,
    "bggr": cv2.COLOR_BayerBGGR2BGR,
    "gbrg": cv2.COLOR_BayerGBRG2BGR,
    "grbg": cv2.COLOR_BayerGRBG2BGR,
}
COLORS = {
    "bgr": (3, None),
    "rgb": (3, cv2.COLOR_RGB2BGR),
    "bgra": (4, cv2.COLOR_BGRA2BGR),
    "rgba": (4, cv2.COLOR_RGBA2BGR),
    "mono": (1, cv2.COLOR_GRAY2BGR),
} | {f"bayer_{name}": (1, conversion) for name, conversion in BAYER.items()}
PACKED = {  # two pixels in four bytes
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    "yuyv": cv2.COLOR_YUV2BGR_YUY2,
}
# sensor_msgs/image_encodings; of 16 bits the upper 8 are used.
ENCODINGS: dict[str, Encoding] = {
    **{f"{name}{bits}": Encoding(n, bits // 8, how) for name, (n, how) in COLORS.items() for bits in (8, 16)},
    **{name: Encoding(2, 1, how) for name, how in PACKED.items()},
    "8UC1": Encoding(1, 1, cv2.COLOR_GRAY2BGR),
    "8UC3": Encoding(3, 1, None),
    "8UC4": Encoding(4, 1, cv2.COLOR_BGRA2BGR),
}
DEPTH = ("16UC1", "32FC1", "compressedDepth")
JPEG_START, JPEG_SCAN, JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
PNG_START, PNG_END = b"\x89PNG", b"IEND"
VIDEO_CODECS = {"h264": "h264", "avc": "h264", "libx264": "h264", "h265": "hevc", "hevc": "hevc", "libx265": "hevc"}
# Quality of the JPEG that a frame of a video is stored as.
VIDEO_QUALITY = 95
# A larger image is none.
MAX_PIXELS = 1 << 28


def refusal(encoding: str) -> str:
    """The reason why images of this encoding are not read as pictures, or ""."""
    if any(name in encoding for name in DEPTH):
        return f"depth image ({encoding}), not a picture"
    return ""


def decode_raw(encoding: str, width: int, height: int, step: int, data: bytes, is_bigendian: bool = False) -> UInt8:
    """A raw image to BGR (height, width, 3); raises LogError for another encoding or too few bytes."""
    about = ENCODINGS.get(encoding)
    if about is None:
        raise LogError(refusal(encoding) or f"image encoding {encoding!r} is not one of {', '.join(ENCODINGS)}")
    row_bytes = width * about.channels * about.bytes
    if not (0 < width * height <= MAX_PIXELS and row_bytes <= step) or len(data) < height * step:
        raise LogError(f"image of {width} x {height} with {step} bytes per row holds {len(data)} bytes only")
    rows = np.frombuffer(data, np.uint8, height * step).reshape(height, step)[:, :row_bytes]
    if about.bytes == 2:
        rows = rows.reshape(height, -1, 2)[:, :, 0 if is_bigendian else 1]
    pixels = np.ascontiguousarray(rows, np.uint8).reshape(height, width, about.channels)
    return pixels if about.conversion is None else np.asarray(cv2.cvtColor(pixels, about.conversion), np.uint8)


def decode_image(data: bytes) -> UInt8:
    """JPEG or PNG to BGR; raises LogError, also for a cut file, of which OpenCV would return a part."""
    is_jpeg, is_png = data.startswith(JPEG_START), data.startswith(PNG_START)
    if (is_jpeg and data.rfind(JPEG_END) < data.rfind(JPEG_SCAN)) or (is_png and PNG_END not in data):
        raise LogError(f"image of {len(data)} bytes is cut")
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if is_jpeg or is_png else None
    if bgr is None:
        raise LogError(f"image of {len(data)} bytes is neither JPEG nor PNG (it begins with {data[:8]!r})")
    return np.asarray(bgr, np.uint8)


def codec_of_video(text: str) -> str | None:
    """Name of the video codec that a format field names ("h264", "hevc;yuv420p;…"), or None."""
    words = text.lower().replace(";", " ").replace("/", " ").split()
    return next((VIDEO_CODECS[word] for word in words if word in VIDEO_CODECS), None)


class VideoDecoder:
    """Decodes the packets of one stream in order, from the first key frame."""

    def __init__(self) -> None:
        self._decoder: Any = None

    def decode(self, codec: str, data: bytes, stamp_ns: int) -> CameraImage:
        """The picture of a packet, stored as JPEG; raises LogError for a packet without one."""
        import av

        if self._decoder is None:
            self._decoder = av.CodecContext.create(codec, "r")
            self._decoder.thread_type = "NONE"  # else pictures come packets later
            self._decoder.flags |= av.codec.context.Flags.low_delay
        try:
            frames = [f for f in self._decoder.decode(av.Packet(data)) if not f.is_corrupt]
        except av.error.FFmpegError as error:
            raise LogError(f"packet of {len(data)} bytes: {error}") from error
        if not frames:
            raise LogError("no picture: no key frame before this packet, or it is damaged")
        bgr = frames[-1].to_ndarray(format="bgr24")
        encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, VIDEO_QUALITY])[1].tobytes()
        return CameraImage(stamp_ns, decode_image(encoded), encoded)


def video_frames(packet_of: Callable[[Any, int], tuple[str, bytes, int]]) -> Callable[[Any, int], CameraImage]:
    """Translation of one stream of video packets; `packet_of` gives format, data and stamp of a message."""
    decoder = VideoDecoder()

    def frame(message: Any, receive_ns: int) -> CameraImage:
        text, data, stamp_ns = packet_of(message, receive_ns)
        codec = codec_of_video(text)
        if codec is None:
            raise LogError(f"{text!r} is no known video format")
        return decoder.decode(codec, data, stamp_ns)

    return frame
