"""PCD files (Point Cloud Library, version 0.7): ASCII, binary and compressed."""

import re
import struct
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from datasets.importers.point_clouds import read_points
from datasets.importers.point_files import PointFormat, Points, points_of_text
from messages.errors import LogError

NAME = "PCD"
HEADER = re.compile(rb"\A(?:#[^\n]*\n)*(?:VERSION\s+\.?\d|FIELDS\b)")
ELEMENT_TYPES = {"F": "f", "U": "u", "I": "i"}


@dataclass(frozen=True)
class _Header:
    """Header; `widths` are the bytes of each field, including unread ones."""

    fields: dict[str, tuple[int, str]]
    widths: tuple[int, ...]
    stride: int
    count: int
    storage: str
    size: int


def read_pcd(data: bytes) -> Points:
    """Points with the names and types of the header; raises one of `DAMAGED`."""
    header = _read_header(data)
    body = data[header.size :]
    if header.storage == "ascii":
        body = _from_text(header, body)
    elif header.storage == "binary_compressed":
        body = _from_columns(header, body)
    elif header.storage != "binary":
        raise LogError(f"DATA {header.storage} is not one of ascii, binary, binary_compressed")
    return read_points(header.fields, header.stride, header.count, body)


def _read_header(data: bytes) -> _Header:
    found = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", data, re.MULTILINE)
    if found is None:
        raise LogError("it has no DATA line")
    lines = data[: found.start()].decode("ascii").splitlines()
    rows = {w[0]: w[1:] for w in (line.split() for line in lines) if w and not w[0].startswith("#")}
    counts = [int(c) for c in rows.get("COUNT", ["1"] * len(rows["FIELDS"]))]
    widths = [int(size) * count for size, count in zip(rows["SIZE"], counts, strict=True)]
    fields: dict[str, tuple[int, str]] = {}
    for k, (name, kind) in enumerate(zip(rows["FIELDS"], rows["TYPE"], strict=True)):
        if counts[k] == 1 and name != "_":
            fields[name] = (sum(widths[:k]), f"<{ELEMENT_TYPES[kind]}{widths[k]}")
    count = int(rows["POINTS"][0])
    if count < 0 or min(widths) <= 0:
        raise LogError(f"{count} points with fields of {widths} bytes")
    return _Header(fields, tuple(widths), sum(widths), count, found.group(1).decode(), found.end())


def _from_text(header: _Header, body: bytes) -> bytes:
    fields = [(name, kind) for name, (_, kind) in header.fields.items()]
    if np.dtype(fields).itemsize != header.stride:
        raise LogError("text with fields of more than one value is not read")
    lines = [line for line in body.decode("ascii").splitlines() if line.strip()]
    return points_of_text(lines[: header.count], fields).tobytes()


def _from_columns(header: _Header, body: bytes) -> bytes:
    """Compressed data, stored field by field, as consecutive points."""
    packed, size = struct.unpack_from("<II", body)
    if size != header.stride * header.count:
        raise LogError(f"{size} bytes for {header.count} points of {header.stride}")
    flat = np.frombuffer(unpack_lzf(body[8 : 8 + packed], size), np.uint8)
    bounds = np.cumsum((0, *header.widths)).tolist()
    out = np.empty((header.count, header.stride), np.uint8)
    for start, end in pairwise(bounds):
        out[:, start:end] = flat[start * header.count : end * header.count].reshape(header.count, end - start)
    return out.tobytes()


def unpack_lzf(data: bytes, size: int) -> bytes:
    """Decompresses LZF: literal runs and back references; raises LogError."""
    out, at = bytearray(), 0
    while at < len(data):
        control, at = data[at], at + 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length, at = length + data[at], at + 1
        back = ((control & 31) << 8) + data[at] + 1
        at += 1
        _repeat(out, back, length + 2)
    if len(out) != size:
        raise LogError(f"unpacks to {len(out)} bytes instead of {size}")
    return bytes(out)


def _repeat(out: bytearray, back: int, length: int) -> None:
    """Appends `length` bytes from `back` bytes before the end; source and destination may overlap."""
    start = len(out) - back
    if start < 0:
        raise LogError("refers to bytes before its start")
    piece = out[start : start + length]
    out += (piece * (length // len(piece) + 1))[:length]


FORMAT = PointFormat("pcd", (".pcd",), lambda head: HEADER.match(head) is not None, read_pcd)
sniff = FORMAT.sniff
