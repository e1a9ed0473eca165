"""The file under a log: whole writes only, and an error that says where and how much room there is."""

import os
from pathlib import Path

from messages.errors import LogError

MB = 1_000_000


class LogFile:
    """A new file to which records are appended; what stands in it is always a sequence of whole writes.

    When a write fails, the part of it that reached the file is cut off again, and all later writes are refused.
    Raises LogError, also when the path is taken or less than `min_free_bytes` are free on its disk.
    """

    def __init__(self, path: Path, min_free_bytes: int) -> None:
        self.path = path
        self._min_free = min_free_bytes
        self._size = 0
        self._failure: LogError | None = None
        try:
            self._file = path.open("wb" if path.is_char_device() else "xb", buffering=0)
        except FileExistsError as error:
            raise LogError(f"{path}: is there already and is not overwritten; name another place") from error
        except OSError as error:
            raise LogError(f"{path}: the log cannot be made ({error.strerror})") from error
        try:
            self.check_space()
        except LogError:
            self._file.close()
            path.unlink()
            raise

    def write(self, data: bytes) -> int:
        """Append all of `data`."""
        if self._failure is not None:
            raise self._failure
        try:
            self._write_all(memoryview(data))
        except OSError as error:
            self._fail(error)
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Bytes written."""
        return self._size

    def flush(self) -> None:
        """Nothing is held back here: what was written has left this process."""

    def sync(self) -> None:
        """Make what was written outlast a power cut."""
        try:
            os.fdatasync(self._file.fileno())
        except OSError as error:
            self._fail(error)

    def check_space(self) -> None:
        """Raise LogError when the disk has less room than is kept free, so that a report can still be written."""
        free = _free_bytes(self.path)
        if free < self._min_free:
            raise LogError(
                f"{self.path}: {free / MB:.0f} MB are free on its disk and {self._min_free / MB:.0f} MB are kept free; "
                "make room or name another place"
            )

    def close(self) -> None:
        """Close the file as it stands."""
        self._file.close()

    def _write_all(self, data: memoryview) -> None:
        while data:
            data = data[self._file.write(data) :]

    def _fail(self, error: OSError) -> None:
        """Cut the file back to its last whole write; a disk that is full still lets a file shrink."""
        if not self.path.is_char_device():
            os.ftruncate(self._file.fileno(), self._size)
        free = _free_bytes(self.path) / MB
        self._failure = LogError(
            f"{self.path}: the log cannot be written ({error.strerror}, {free:.0f} MB free on its disk); it is "
            f"readable up to byte {self._size}, but not whole. Make room or name another place"
        )
        raise self._failure from error


def _free_bytes(path: Path) -> int:
    stat = os.statvfs(path.parent)
    return stat.f_bavail * stat.f_frsize
