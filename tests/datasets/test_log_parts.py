"""A rotated log is read as one log; a missing, foreign or cut part is named."""

import shutil
import tracemalloc
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from threading import Event

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log

from datasets.importers.formats import open_recording
from datasets.log import LogConfig, LogWriter
from datasets.parts import CONTINUED, files_of
from datasets.reader import LogScan, read_log, read_metadata
from datasets.summary import summarize_log
from messages.errors import LogError
from messages.message import Envelope
from messages.sensors import WheelSample

S = 1_000_000_000
BY_TIME = LogConfig(chunk_kib=16, flush_s=0.1, sync_s=100.0, min_free_mb=0.0, part_s=10.0)
BY_SIZE = LogConfig(chunk_kib=16, flush_s=0.1, sync_s=100.0, min_free_mb=0.0, part_mb=0.1)


def write(path: Path, config: LogConfig, seconds: float, rotates: bool = True, offset: float = 0.0) -> str:
    """Writes samples at 100 Hz; returns the digest."""
    with LogWriter(path, {"config": {"yaml": "x: 1"}}, config, rotates=rotates) as log:
        for k in range(round(100 * seconds)):
            stamp_ns = k * S // 100
            log.write(Envelope("wheel", k, stamp_ns, WheelSample(stamp_ns, 0.1 * k + offset, -0.01 * k)))
        log.add_metadata("late", {"key": "value"})
        return log.digest()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """35 s in four parts."""
    path = tmp_path / "log.mcap"
    write(path, BY_TIME, 35.0)
    return path


def test_all_parts_are_read_as_one_log(log: Path, tmp_path: Path) -> None:
    whole = tmp_path / "whole.mcap"
    digest = write(whole, BY_TIME, 35.0, rotates=False)
    assert [p.name for p in files_of(log)] == ["log.mcap", "log.2.mcap", "log.3.mcap", "log.4.mcap"]
    assert [p.name for p in files_of(whole)] == ["whole.mcap"]
    assert [e.receive_ns for e in read_log(log)] == [e.receive_ns for e in read_log(whole)]
    summary = summarize_log(log)
    assert summary.is_complete
    assert summary.problems == ()
    assert (summary.messages, summary.digest, summary.is_digest_valid) == (3500, digest, True)
    assert summary.size_bytes == sum(p.stat().st_size for p in files_of(log))
    assert set(summary.metadata) == {"config", "late", "end"}


def test_recording_and_folder_of_a_rotated_log(log: Path) -> None:
    for path in (log, log.parent):
        recording = open_recording(path)
        assert sum(1 for _ in recording.read()) == 3500
        assert recording.description.notes == ()


def test_rotation_by_size(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(path, BY_SIZE, 300.0)
    parts = files_of(path)
    assert len(parts) > 2
    assert all(p.stat().st_size < 150_000 for p in parts)
    assert summarize_log(path).messages == 30_000


def test_each_part_is_a_log_of_its_own(log: Path) -> None:
    part = log.with_name("log.4.mcap")
    scan = LogScan(part)
    stamps = [entry.stamp_ns for entry in scan]
    assert scan.is_complete
    assert stamps[-1] == 3499 * S // 100
    assert all(a < b for a, b in pairwise(stamps))
    assert read_metadata(part)["config"] == {"yaml": "x: 1"}


def test_missing_part_is_named(log: Path) -> None:
    log.with_name("log.3.mcap").unlink()
    summary = summarize_log(log)
    assert not summary.is_complete
    assert "log.3.mcap is missing" in summary.problems[0]
    assert 2000 <= summary.messages < 2100


def test_part_of_another_log_is_not_read(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    write(other, BY_TIME, 35.0, offset=1.0)
    shutil.copy(tmp_path / "other.2.mcap", tmp_path / "log.2.mcap")
    summary = summarize_log(log)
    assert "log.2.mcap does not continue log.mcap" in summary.problems[0]
    assert summary.messages < 1100


def test_file_with_the_name_of_a_part_beside_a_complete_log_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(path, BY_TIME, 5.0)
    (tmp_path / "log.2.mcap").write_text("mine")
    assert summarize_log(path).is_complete


def test_cut_part_is_skipped_over(log: Path) -> None:
    part = log.with_name("log.2.mcap")
    part.write_bytes(part.read_bytes()[: part.stat().st_size // 2])
    summary = summarize_log(log)
    assert not summary.is_complete
    assert 2500 < summary.messages < 3500
    assert summary.end_ns == 3499 * S // 100


def test_log_of_a_killed_writer_is_readable_in_its_last_part(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    writer = LogWriter(path, {}, BY_TIME, rotates=True)
    for k in range(2500):
        writer.write(Envelope("wheel", k, k * S // 100, WheelSample(k * S // 100, 0.0, 0.0)))
    writer.abandon()
    summary = summarize_log(path)
    assert not summary.is_complete
    assert summary.messages > 2450


def test_existing_file_is_not_overwritten_by_a_part(tmp_path: Path) -> None:
    (tmp_path / "log.2.mcap").write_text("mine")
    with pytest.raises(LogError, match=r"log.2.mcap: exists"):
        write(tmp_path / "log.mcap", BY_TIME, 25.0)
    assert (tmp_path / "log.2.mcap").read_text() == "mine"
    scan = LogScan(tmp_path / "log.mcap")
    assert sum(1 for _ in scan) > 950
    assert not scan.is_complete


def test_messages_do_not_wait_for_a_new_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, may_end, end = tmp_path / "log.mcap", Event(), LogWriter._finish_part

    def held(self: LogWriter, name: str, values: Mapping[str, str]) -> None:
        assert name != CONTINUED or may_end.wait(60.0)
        end(self, name, values)

    monkeypatch.setattr(LogWriter, "_finish_part", held)
    config = BY_TIME.model_copy(update={"flush_s": 1.0})
    with LogWriter(path, {}, config, rotates=True) as writer:
        for k in range(1300):
            writer.write(Envelope("wheel", k, k * S // 100, WheelSample(k * S // 100, 0.0, 0.0)))
        may_end.set()
    summary = summarize_log(path)
    assert (summary.is_complete, summary.messages) == (True, 1300)
    assert (tmp_path / "log.2.mcap").is_file()


def test_writer_keeps_little_of_each_chunk(tmp_path: Path) -> None:
    path, channels, chunks = tmp_path / "log.mcap", 50, 200
    with LogWriter(path, {}, BY_TIME) as writer:
        for chunk in range(3 * chunks):
            for k in range(channels):
                stamp_ns = (chunk * channels + k) * S // (10 * channels)
                writer.write_view(stamp_ns, stamp_ns, f"/view/{k}", Log(message="x"))
            writer.show(Envelope("wheel", 0, (chunk + 1) * S // 10, WheelSample(0, 0.0, 0.0)))
            if chunk + 1 == chunks:
                writer.digest()  # everything is written
                tracemalloc.start()
        kept, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert summarize_log(path).is_complete
    assert kept / (2 * chunks) < 2500
