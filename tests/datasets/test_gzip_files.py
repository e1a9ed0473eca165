"""Recordings packed with gzip: read as the file in them, and named like the packed one."""

import gc
import gzip
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from datasets.importers.formats import open_recording
from datasets.log import LogConfig, LogWriter
from messages.errors import LogError
from messages.message import Envelope
from messages.sensors import WheelSample
from tests.datasets.imported import reasons, scans_of

LINES = b"(1.0) can0 1#00\nodd\n(2.0) can0 1#01\n"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of the unpacked files."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    return tmp_path / "temporary"


def test_packed_file_is_read_like_the_file_in_it(tmp_path: Path, folder: Path) -> None:
    packed = tmp_path / "can.log.gz"
    packed.write_bytes(gzip.compress(LINES[:20]) + gzip.compress(LINES[20:]))  # two members
    source = open_recording(packed)
    assert [m.stamp_ns for _, _, m in source.read()] == [1_000_000_000, 2_000_000_000]
    assert list(reasons(source).values()) == [1]
    assert (source.path, source.description.format) == (packed, "candump")
    assert list(folder.iterdir())
    del source
    gc.collect()
    assert not list(folder.iterdir())


def test_names_are_those_of_the_packed_file(tmp_path: Path, folder: Path) -> None:
    packed = tmp_path / "points.gz"
    packed.write_bytes(gzip.compress(b"1 2 3\n4 5 6\n"))
    source = open_recording(packed)
    assert len(scans_of(source)) == 1
    assert source.description.sensors[0].source == str(packed)
    packed.write_bytes(gzip.compress(b"1 2 3\n4 5 x\n" * 1000))
    for content in (b"1 2 3\n" * 1000 + b"4 5 x\n", b"nothing known"):
        packed.write_bytes(gzip.compress(content))
        with pytest.raises(LogError, match=r"points\.gz: no") as caught:
            open_recording(packed)
        assert str(folder) not in str(caught.value)


@pytest.mark.parametrize("change", [lambda b: b[:-9], lambda b: b[:-8] + b"\0" * 8, lambda b: b[:12] + b"\xff" * 20])
def test_damaged_gzip_file_is_refused(tmp_path: Path, change: Callable[[bytes], bytes]) -> None:
    (tmp_path / "a.gz").write_bytes(change(gzip.compress(LINES * 50)))
    with pytest.raises(LogError, match=r"a\.gz: the gzip file cannot be unpacked"):
        open_recording(tmp_path / "a.gz")


def test_headland_log_is_not_read_packed(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "log.mcap", {}, LogConfig(chunk_kib=256, flush_s=1.0, sync_s=9.0, min_free_mb=0.0))
    writer.write(Envelope("wheel/a", 0, 5, WheelSample(5, 1.0, 0.0)))
    writer.close()
    (tmp_path / "log.mcap.gz").write_bytes(gzip.compress((tmp_path / "log.mcap").read_bytes()))
    with pytest.raises(LogError, match=r"log\.mcap\.gz: a Headland log is not read packed"):
        open_recording(tmp_path / "log.mcap.gz")
