"""ESRI Shapefile: polygons and lines, transformed from the coordinate system of its .prj file."""

import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from messages.errors import FieldError
from planning.field.formats.contents import Feature, FieldFile, RecordedLine, Rings, ignored_note, line_of, name_in
from planning.field.formats.coordinates import CoordinateError, CoordinateSystem
from planning.field.formats.source import Source

NAME = "Shapefile"
MAGIC = struct.pack(">i", 9994)
COMPANIONS = (".shx", ".dbf", ".prj", ".cpg")
PARTS = (".shx", ".dbf", ".prj", ".cpg", ".sbn", ".sbx", ".qpj", ".qix")


def sniff(source: Source) -> Callable[[], FieldFile] | None:
    """Reads a file that begins as a .shp does, and the .shp files of an archive or folder."""
    if source.names:
        found = source.named(".shp")
        return (lambda: _joined([_from_names(source, name) for name in found])) if found else None
    if not source.head.startswith(MAGIC):
        return _companion(source)
    if source.path.suffix.lower() == ".shx":
        return _companion(source)
    return lambda: _from_file(source)


def _companion(source: Source) -> Callable[[], FieldFile] | None:
    """Refuses another part of a Shapefile than its .shp."""
    path = source.path
    shape = [p for p in path.parent.iterdir() if p.stem == path.stem and p.suffix.lower() == ".shp"]
    if path.suffix.lower() not in PARTS or not shape:
        return None

    def refuse() -> FieldFile:
        raise FieldError(f"{path}: is a part of the Shapefile {shape[0].name}; name that file")

    return refuse


def _from_file(source: Source) -> FieldFile:
    stem = source.path.stem
    return _read(source.read(), {end: source.beside(stem + end) for end in COMPANIONS}, str(source.path))


def _from_names(source: Source, name: str) -> FieldFile:
    stem = name[: -len(".shp")].lower()
    beside = {n.lower()[len(stem) :]: n for n in source.names if n.lower().startswith(f"{stem}.")}
    parts = {end: source.read(beside[end]) if end in beside else None for end in COMPANIONS}
    return _read(source.read(name), parts, f"{source.path}: {name}")


def _joined(files: list[FieldFile]) -> FieldFile:
    features = tuple(f for file in files for f in file.features)
    lines = tuple(line for file in files for line in file.lines)
    return FieldFile(features, lines, tuple(n for file in files for n in file.notes))


def _read(shape: bytes, parts: dict[str, bytes | None], where: str) -> FieldFile:
    """Contents of a Shapefile; raises FieldError that begins with `where`."""
    if not shape.startswith(MAGIC) or len(shape) < 100:
        raise FieldError(f"{where}: no Shapefile, or cut off in its header; export it again")
    for end, why in ((".shx", "it cannot be read"), (".prj", "its coordinate system is unknown")):
        if not (parts[end] or b"").strip():
            raise FieldError(f"{where}: has no {end} file, {why}; copy .shp, .shx, .dbf and .prj together")
    try:
        return _contents(*_layer(shape, parts), (parts[".prj"] or b"").decode("utf-8", "replace").strip())
    except CoordinateError as error:
        raise FieldError(f"{where}: {error}") from error


def _layer(shape: bytes, parts: dict[str, bytes | None]) -> tuple[list[Any], list[dict[str, Any]]]:
    """Geometries and attributes, read from a copy without .prj: GDAL takes what lies beside the file."""
    # only now: the import takes 0.5 s
    import shapely
    from pyogrio.errors import DataLayerError, DataSourceError
    from pyogrio.errors import FieldError as AttributeFieldError
    from pyogrio.raw import read

    with TemporaryDirectory(prefix="headland-") as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # damage that matters shows as missing geometry
        for end, content in {".shp": shape, **parts}.items():
            if content is not None and end != ".prj":
                (Path(folder) / f"field{end}").write_bytes(content)
        try:
            meta, _, geometries, columns = read(Path(folder) / "field.shp", force_2d=True)
            found = list(shapely.from_wkb(geometries, on_invalid="ignore"))
        except (DataSourceError, DataLayerError, AttributeFieldError, ValueError, OSError, UnicodeError) as error:
            reason = " ".join(str(error).replace(folder, "").split())[:100]
            raise CoordinateError(f"damaged Shapefile ({reason}); export it again") from error
    rows: list[dict[str, Any]] = [dict(zip(meta["fields"], v, strict=True)) for v in zip(*columns, strict=True)]
    return found, rows or [{}] * len(found)


def _contents(geometries: list[Any], rows: list[dict[str, Any]], crs: str) -> FieldFile:
    import shapely

    system = CoordinateSystem(crs, "x, y")
    system.check()
    features: list[Feature] = []
    lines: list[RecordedLine] = []
    points = empty = 0
    for geometry, row in zip(geometries, rows, strict=True):
        if geometry is None or geometry.is_empty:
            empty += 1
            continue
        pieces, name = list(shapely.get_parts(geometry)), name_in(row)
        if geometry.geom_type.endswith("Polygon"):
            features.append(_feature(name, pieces, system))
        elif geometry.geom_type.endswith("LineString"):
            lines += [line_of(name, system.to_degrees(list(piece.coords))) for piece in pieces]
        else:
            points += len(pieces)
    notes = ignored_note(points, [f"{empty} without geometry"] if empty else [])
    return FieldFile(tuple(features), tuple(lines), (*notes, *system.notes))


def _feature(name: str, polygons: list[Any], system: CoordinateSystem) -> Feature:
    try:
        parts: list[Rings] = [
            tuple(system.to_degrees(list(ring.coords)) for ring in (p.exterior, *p.interiors)) for p in polygons
        ]
    except CoordinateError as error:
        return Feature(name, (), str(error))
    return Feature(name, tuple(parts))
