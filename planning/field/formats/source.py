"""Access to a field file, to the files beside it, or to those in a folder or ZIP archive, with limits on size."""

import io
import zipfile
import zlib
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import TypeVar
from xml.etree.ElementTree import Element

from messages.errors import FieldError
from planning.field.formats.xml_tree import is_xml, parse_xml

MAX_BYTES = 20_000_000
MAX_FILES = 10_000
HEAD = 4096
T = TypeVar("T")
ZIP = (b"PK\x03\x04", b"PK\x05\x06")


class Source:
    """A file, a folder or a ZIP archive; raises FieldError when it cannot be read.

    `names` are the files of a folder or an archive, without folders of operating systems; empty for a single file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.names: tuple[str, ...] = ()
        self._archive: zipfile.ZipFile | None = None
        if path.is_dir():
            self.names = self._guarded(lambda: _sorted(str(p.relative_to(path)) for p in _files(path)))
        elif self.head.startswith(ZIP):
            self._archive = self._guarded(lambda: zipfile.ZipFile(io.BytesIO(self.read())))
            self.names = _sorted(n for n in self._archive.namelist() if n and not n.endswith("/"))
            if not self.names:
                raise FieldError(f"{path}: the archive is empty")

    @cached_property
    def head(self) -> bytes:
        """First bytes of a single file."""
        if self.path.is_dir():
            return b""
        return self._guarded(lambda: _first(self.path, HEAD))

    def read(self, name: str | None = None) -> bytes:
        """Content of the file, or of one of `names`; raises FieldError above 20 MB."""
        if name is None:
            return self._limited(self._guarded(lambda: _first(self.path, MAX_BYTES + 1)), self.path.name)
        return self._limited(self._guarded(lambda: self._member(name)), name)

    def beside(self, name: str) -> bytes | None:
        """Content of a file in the folder of a single file, by its name in any case; None if there is none."""
        found = [p for p in self.path.parent.iterdir() if p.name.lower() == name.lower() and p.is_file()]
        return self._limited(self._guarded(lambda: _first(found[0], MAX_BYTES + 1)), name) if found else None

    def named(self, *endings: str) -> list[str]:
        """Those of `names` that end so, in any case."""
        return [name for name in self.names if name.lower().endswith(endings)]

    @cached_property
    def xml(self) -> Element | None:
        """Root of a single XML file, None for another file; raises FieldError."""
        return parse_xml(self.read(), str(self.path)) if is_xml(self.head) else None

    def _member(self, name: str) -> bytes:
        if self._archive is None:
            return _first(self.path / name, MAX_BYTES + 1)
        with self._archive.open(name) as file:
            return file.read(MAX_BYTES + 1)

    def _limited(self, data: bytes, name: str) -> bytes:
        if len(data) > MAX_BYTES:
            where = f"{self.path}: " if name == self.path.name else f"{self.path}: {name} is "
            raise FieldError(f"{where}larger than {MAX_BYTES // 10**6} MB; export the outline of one field alone")
        return data

    def _guarded(self, read: Callable[[], T]) -> T:
        try:
            return read()
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
            raise FieldError(f"{self.path}: damaged or unreadable archive ({error}); export it again") from error
        except OSError as error:
            raise FieldError(f"{self.path}: cannot be read ({error.strerror or error})") from error


def _first(path: Path, size: int) -> bytes:
    if not path.is_file():  # a pipe or a device would block
        raise OSError("not a regular file")
    with path.open("rb") as file:
        return file.read(size)


def _files(folder: Path) -> list[Path]:
    """Files of a folder and of the folders in it, not deeper."""
    found = [p for p in (*folder.glob("*"), *folder.glob("*/*")) if p.is_file()]
    if len(found) > MAX_FILES:
        raise FieldError(f"{folder}: holds more than {MAX_FILES} files; name the file of the field")
    return found


def _sorted(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(n for n in sorted(names) if "__MACOSX" not in n and not n.rpartition("/")[2].startswith("."))
