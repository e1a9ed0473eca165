"""PLY files (Stanford): the vertices of ASCII, little-endian and big-endian files."""

import re
from dataclasses import dataclass

import numpy as np

from datasets.importers.point_clouds import read_points
from datasets.importers.point_files import PointFormat, Points, name_of_field, points_of_text
from messages.errors import LogError

NAME = "PLY"
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
HEADER_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)


@dataclass
class _Element:
    """Element of a file, with (name, type) of each property; a list has no type."""

    name: str
    count: int
    properties: list[tuple[str, str]]


def read_ply(data: bytes) -> Points:
    """Vertices with the names and types of their properties; raises one of `DAMAGED`."""
    end = HEADER_END.search(data)
    if end is None:
        raise LogError("its header has no end_header")
    storage, elements = _read_header(data[: end.start()].decode("ascii"))
    before = [e.name for e in elements].index("vertex")
    vertex = elements[before]
    if any(not kind for e in elements[: before + 1] for _, kind in e.properties):
        raise LogError("lists in or before its vertices are not read")
    body = data[end.end() :]
    if storage == "ascii":
        skipped = sum(e.count for e in elements[:before])
        lines = [line for line in body.decode("ascii").splitlines() if line.strip()][skipped : skipped + vertex.count]
        if len(lines) < vertex.count:
            raise LogError(f"{vertex.count} vertices, but {len(lines)} lines only")
        return points_of_text(lines, vertex.properties)
    begin = sum(e.count * _stride(e) for e in elements[:before])
    fields, offset = {}, 0
    for name, kind in vertex.properties:
        fields[name] = (offset, ORDERS[storage] + kind)
        offset += np.dtype(kind).itemsize
    return read_points(fields, offset, vertex.count, body[begin:])


def _stride(element: _Element) -> int:
    return sum(np.dtype(kind).itemsize for _, kind in element.properties)


def _read_header(text: str) -> tuple[str, list[_Element]]:
    storage = ""
    elements: list[_Element] = []
    for words in (line.split() for line in text.splitlines()):
        match words:
            case ["format", name, _] if name in ORDERS:
                storage = name
            case ["element", name, count] if int(count) >= 0:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", _, _, name]:
                elements[-1].properties.append((name, ""))
            case ["property", kind, name] if kind in TYPES:
                elements[-1].properties.append((name_of_field(name), TYPES[kind]))
            case ["ply"] | ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise LogError(f"its header has the line {' '.join(words)[:60]!r}")
    if not storage or "vertex" not in [e.name for e in elements]:
        raise LogError("its header has no format or no vertices")
    return storage, elements


FORMAT = PointFormat("ply", (".ply",), lambda head: re.match(rb"ply\r?\n", head) is not None, read_ply)
sniff = FORMAT.sniff
