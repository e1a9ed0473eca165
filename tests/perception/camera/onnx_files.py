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


TYPES = {np.dtype(np.float32): 1, np.dtype(np.int64): 7, np.dtype(np.float16): 10, np.dtype(np.float64): 11}


def _value(name: str, shape: tuple[int | str, ...], dtype: np.dtype) -> bytes:
    dims = b"".join(_bytes(1, _bytes(2, d) if isinstance(d, str) else _number(1, d)) for d in shape)
    return _bytes(1, name) + _bytes(2, _bytes(1, _number(1, TYPES[dtype]) + _bytes(2, dims)))


def _tensor(name: str, values: np.ndarray) -> bytes:
    dims = b"".join(_number(1, d) for d in values.shape)
    return dims + _number(2, TYPES[values.dtype]) + _bytes(8, name) + _bytes(9, values.tobytes())


def _node(operator: str, takes: list[str], gives: str, **attributes: int) -> bytes:
    named = b"".join(_bytes(5, _bytes(1, name) + _number(3, n) + _number(20, 2)) for name, n in attributes.items())
    return b"".join(_bytes(1, name) for name in takes) + _bytes(2, gives) + _bytes(4, operator) + named


def write(
    path: Path, takes: tuple[int | str, ...], gives: dict[str, np.ndarray], dtype: type = np.float32, in_size: str = ""
) -> Path:
    """A model with one image input and constant outputs (onnx.proto, IR 8, opset 13).

    With `in_size` it has the second input `orig_target_sizes`, by which the output of this name is multiplied.
    """
    # the input is used, else onnxruntime drops it: 0 times its mean is added to each output
    nodes = [_node("Cast", ["image"], "plain", to=1), _node("ReduceMean", ["plain"], "mean", keepdims=0)]
    nodes.append(_node("Mul", ["mean", "zero"], "zero_mean"))
    tensors = [_bytes(5, _tensor("zero", np.zeros((), np.float32)))]
    inputs = _bytes(11, _value("image", takes, np.dtype(dtype)))
    if in_size:
        inputs += _bytes(11, _value("orig_target_sizes", ("N", 2), np.dtype(np.int64)))
        nodes.append(_node("Cast", ["orig_target_sizes"], "size", to=1))
        nodes.append(_node("Concat", ["size", "size"], "sizes", axis=1))
    for name, values in gives.items():
        tensors.append(_bytes(5, _tensor(f"{name}_values", values)))
        nodes.append(_node("Cast", ["zero_mean"], f"{name}_zero", to=TYPES[values.dtype]))
        last = f"{name}_shares" if name == in_size else name
        nodes.append(_node("Add", [f"{name}_values", f"{name}_zero"], last))
        if name == in_size:
            nodes.append(_node("Mul", [last, "sizes"], name))
    graph = b"".join(_bytes(1, n) for n in nodes) + _bytes(2, "g") + b"".join(tensors) + inputs
    graph += b"".join(_bytes(12, _value(name, values.shape, values.dtype)) for name, values in gives.items())
    path.write_bytes(_number(1, 8) + _bytes(7, graph) + _bytes(8, _bytes(1, "") + _number(2, 13)))
    return path
