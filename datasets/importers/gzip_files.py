"""Files of any other format that are packed with gzip: unpacked to a temporary folder until the recording is closed."""

import gzip
import shutil
import tempfile
import weakref
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from datasets.importers.formats import open_recording
from datasets.importers.mcap_logs import OWN
from datasets.importers.recording import Open, Received, Recording, Skipped
from messages.errors import LogError

NAME = "gzip"
MAGIC = b"\x1f\x8b"


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a gzip file."""
    return open_gzip if head.startswith(MAGIC) else None


def open_gzip(path: Path, _: Path | None = None) -> Recording:
    """The recording in a gzip file, which keeps the path of the packed file; raises LogError."""
    unpacked = _Unpacked(path)
    return unpacked.recording()


class _Unpacked:
    """The content of a gzip file as a file of its own, which is removed with this object."""

    def __init__(self, path: Path) -> None:
        folder = Path(tempfile.mkdtemp(prefix="headland_"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self._path, self._file = path, folder / (path.stem if path.suffix == ".gz" else path.name)
        try:
            with gzip.open(path) as packed, self._file.open("wb") as file:
                shutil.copyfileobj(packed, file)
        except (OSError, EOFError, zlib.error) as error:  # OSError: also a wrong checksum, or a full disk
            raise LogError(f"{path}: the gzip file cannot be unpacked ({error})") from error

    def recording(self) -> Recording:
        """The recording, named like the gzip file; raises LogError."""
        try:
            found = open_recording(self._file)
        except LogError as error:
            raise LogError(self._named(str(error))) from error
        about = found.description
        if about.format == OWN:
            raise LogError(f"{self._path}: a Headland log is not read packed; unpack it first")
        sensors = tuple(replace(s, source=self._named(s.source)) for s in about.sensors)
        ignored = tuple(replace(i, source=self._named(i.source), reason=self._named(i.reason)) for i in about.ignored)
        about = replace(about, sensors=sensors, ignored=ignored, notes=tuple(map(self._named, about.notes)))

        def messages() -> Iterator[Received | Skipped]:
            try:
                for item in found.messages():
                    if isinstance(item, Skipped):
                        yield item._replace(source=self._named(item.source), reason=self._named(item.reason))
                    else:
                        yield item
            except LogError as error:
                raise LogError(self._named(str(error))) from error

        return Recording(self._path, about, messages)

    def _named(self, text: str) -> str:
        return text.replace(str(self._file), str(self._path))
