"""Small ONNX files written byte by byte (protobuf wire format), for cases that no published network covers."""

from pathlib import Path

import numpy as np


def _varint(n: int) -> bytes:
    out = bytearray()
    while True:
        out.append((n & 0x7F) | (0x80 if n > 0x7F else 0))
        n >>= 7
        if not n:
            return bytes(out)


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, value: bytes | str) -> bytes:
    raw = value.encode() if isinstance(value, str) else value
    return _varint(field << 3 | 2) + _varint(len(raw)) + raw


def _value(name: str, shape: tuple[int | str, ...]) -> bytes:
    dims = b"".join(_bytes(1, _bytes(2, d) if isinstance(d, str) else _number(1, d)) for d in shape)
    return _bytes(1, name) + _bytes(2, _bytes(1, _number(1, 1) + _bytes(2, dims)))


def _tensor(name: str, values: np.ndarray) -> bytes:
    dims = b"".join(_number(1, d) for d in values.shape)
    return dims + _number(2, 1) + _bytes(8, name) + _bytes(9, values.astype("<f4").tobytes())


def write(path: Path, takes: tuple[int | str, ...], gives: dict[str, np.ndarray]) -> Path:
    """A model with one input and constant outputs (onnx.proto, IR 8, opset 13)."""
    # the input is used, else onnxruntime drops it: 0 times its mean is added to each output
    nodes = [_bytes(1, "image") + _bytes(2, "mean") + _bytes(4, "ReduceMean") + _bytes(5, _attribute("keepdims", 0))]
    nodes.append(_bytes(1, "mean") + _bytes(1, "zero") + _bytes(2, "zero_mean") + _bytes(4, "Mul"))
    tensors = [_bytes(5, _tensor("zero", np.zeros((), np.float32)))]
    for name, values in gives.items():
        tensors.append(_bytes(5, _tensor(f"{name}_values", values)))
        nodes.append(_bytes(1, f"{name}_values") + _bytes(1, "zero_mean") + _bytes(2, name) + _bytes(4, "Add"))
    graph = b"".join(_bytes(1, n) for n in nodes) + _bytes(2, "g") + b"".join(tensors)
    graph += _bytes(11, _value("image", takes))
    graph += b"".join(_bytes(12, _value(name, values.shape)) for name, values in gives.items())
    path.write_bytes(_number(1, 8) + _bytes(7, graph) + _bytes(8, _bytes(1, "") + _number(2, 13)))
    return path


def _attribute(name: str, value: int) -> bytes:
    return _bytes(1, name) + _number(3, value) + _number(20, 2)
