"""Arrays as bytes, with lossless filters that improve the compression of a chunk.

The name of the filter is stored with the data:

- `""`: bytes of the array, row by row, little-endian.
- `planes`: byte planes; the lowest byte of every element first, then the next.
- `delta0-planes`, `delta1-planes`: differences to the previous element along axis 0 or 1 (first: to zero) of the bits
  as unsigned integers, zigzag coded (0, -1, 1, -2, … as 0, 1, 2, 3, …), then byte planes. A range image becomes one
  plane of noise and one of mostly zeros.
- `png`: an image (rows, columns, 3) as PNG, lossless.
- `sent`: an image as JPEG or PNG bytes from the camera; decoding gives the array.
"""

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from geometry.arrays import UInt8
from geometry.jit import kernel
from messages.errors import LogError

Array = npt.NDArray[Any]
# Elements; for smaller arrays a filter costs more time than it saves in size.
MIN_FILTERED = 256
PNG, SENT = "png", "sent"
KINDS = {name: np.dtype(name) for name in ("<f8", "<f4", "<i8", "<i4", "<u2", "|u1", "|i1", "<i2", "<u4", "<u8", "|b1")}


def filter_of(array: Array) -> str:
    """Filter for an array, by type and shape."""
    if array.size < MIN_FILTERED:
        return ""
    if array.dtype == np.uint16 and array.ndim == 2:
        return "delta1-planes"
    if array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] == 3:
        return "png"
    # consecutive points and indices are neighbours in space
    return "delta0-planes" if array.dtype in (np.float32, np.int32) else ""


def pack(array: Array, name: str) -> bytes:
    """Bytes of an array after the filter `name`."""
    if not name:
        return array.tobytes()
    if name == PNG:
        return bytes(cv2.imencode(".png", array, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
    if name.startswith("delta"):
        return _split(_fold(array, int(name[5])))
    return _split(array) if name == "planes" else array.tobytes()


def unpack(data: bytes, dtype: str, shape: tuple[int, ...], name: str) -> Array:
    """Inverse of `pack`, read-only; raises LogError when type, shape, filter and bytes do not agree."""
    kind = KINDS.get(dtype)
    if kind is None:
        raise LogError(f"array of type {dtype!r}: not one of {', '.join(sorted(KINDS))}")
    if name in (PNG, SENT):
        return _image(data, dtype, shape)
    if math.prod(shape) * kind.itemsize != len(data):
        raise LogError(f"array of shape {shape} and type {dtype}: {len(data)} bytes do not fill it")
    if not name:
        return np.frombuffer(data, kind).reshape(shape)
    undo = _UNDO.get(name)
    if undo is None:
        raise LogError(f"array filter {name!r}: not one of {', '.join(map(repr, ('', *_UNDO, PNG, SENT)))}")
    return undo(data, kind, shape)


def _image(data: bytes, dtype: str, shape: tuple[int, ...]) -> Array:
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if bgr is None or bgr.shape != shape or dtype != "|u1":
        found = "no image" if bgr is None else f"an image of shape {bgr.shape}"
        raise LogError(f"array of shape {shape} and type {dtype}: its {len(data)} bytes are {found}")
    return np.asarray(bgr)


def _split(array: Array) -> bytes:
    return np.ascontiguousarray(array.reshape(-1)).view(np.uint8).reshape(-1, array.itemsize).T.tobytes()


def _merge(data: bytes, kind: np.dtype[Any], shape: tuple[int, ...]) -> Array:
    planes: UInt8 = np.frombuffer(data, np.uint8).reshape(kind.itemsize, -1)
    return np.ascontiguousarray(planes.T).reshape(-1).view(kind).reshape(shape)


def _fold(array: Array, axis: int) -> Array:
    bits = np.ascontiguousarray(array).view(_unsigned(array.dtype))
    step = bits.copy()
    if axis == 0:
        step[1:] -= bits[:-1]
    else:
        step[:, 1:] -= bits[:, :-1]
    signed = step.view(f"<i{array.itemsize}")
    return (signed << 1) ^ (signed >> (8 * array.itemsize - 1))


def _unfold(axis: int) -> Callable[[bytes, np.dtype[Any], tuple[int, ...]], Array]:
    def undo(data: bytes, kind: np.dtype[Any], shape: tuple[int, ...]) -> Array:
        if kind.itemsize not in (2, 4) or len(shape) <= axis:
            raise LogError(f"array of shape {shape} and type {kind.str}: has no differences along axis {axis}")
        out = np.empty(math.prod(shape), _unsigned(kind))
        planes: UInt8 = np.frombuffer(data, np.uint8).reshape(kind.itemsize, -1)
        stride, line = math.prod(shape[axis + 1 :]), math.prod(shape[axis:])
        _sum_steps(planes[:2], planes[2:], out, stride, max(line, 1))
        return out.view(kind).reshape(shape)

    return undo


@kernel
def _sum_steps(low: UInt8, high: UInt8, out: Array, stride: int, line: int) -> None:
    """Adds up the folded differences in byte planes (2, N) and (0 or 2, N) to `out` (N,).

    An element follows the one `stride` before; a sum starts again every `line` elements.
    """
    for i in range(len(out)):
        out[i] = np.uint32(low[0, i]) | np.uint32(low[1, i]) << np.uint32(8)
    if len(high):
        for i in range(len(out)):
            out[i] |= np.uint32(high[0, i]) << np.uint32(16) | np.uint32(high[1, i]) << np.uint32(24)
    for i in range(len(out)):
        out[i] = (out[i] >> 1) ^ (0 - (out[i] & 1))
    for begin in range(0, len(out), line):
        for i in range(begin + stride, begin + line):
            out[i] += out[i - stride]


def _unsigned(kind: np.dtype[Any]) -> np.dtype[Any]:
    return np.dtype(f"<u{kind.itemsize}")


_UNDO: dict[str, Callable[[bytes, np.dtype[Any], tuple[int, ...]], Array]] = {
    "planes": _merge,
    "delta0-planes": _unfold(0),
    "delta1-planes": _unfold(1),
}
