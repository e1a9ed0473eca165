"""Writing and reading of complete, truncated, damaged and invalid logs."""

import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from configs.strict import CONFIGS, parse, read_yaml
from datasets.digest import Digest
from datasets.disk import check_room
from datasets.importers.formats import open_recording
from datasets.log import LogConfig, LogWriter
from datasets.reader import LogScan, has_own_messages, read_log, read_metadata
from datasets.summary import FrameTree, render_summary, summarize_log, summary_json
from messages.errors import LogError
from messages.message import Envelope
from messages.perception import Obstacles
from messages.sensors import ImuSample, LidarScan, WheelSample
from tests.datasets.log_samples import bits

CONFIG = LogConfig(chunk_kib=16, flush_s=0.1, sync_s=1.0, min_free_mb=0.0)
METADATA = {"configuration": {"stack": "a: 1"}, "versions": {"commit": "abc", "lock": "def"}}
ROOT = Path(__file__).resolve().parents[2]


def envelopes(count: int = 100) -> Iterator[Envelope]:
    """IMU and wheels at 100 Hz and small scans at 10 Hz; noise, which does not compress."""
    rng = np.random.default_rng(3)
    for k in range(count):
        t = 5_000_000_000 + k * 10_000_000
        yield Envelope("imu", k, t + 1, ImuSample(t, rng.normal(size=3), rng.normal(size=3)))
        yield Envelope("wheel", k, t + 2, WheelSample(t, *rng.normal(size=2).tolist()))
        if k % 10 == 0:
            image = rng.integers(0, 65535, (4, 100)).astype(np.uint16)
            scan = LidarScan(
                t, image, np.zeros(4), np.zeros(100), np.zeros((0, 3), np.float32), np.zeros(0, np.uint8),
                np.zeros(0, np.float32),
            )  # fmt: skip
            yield Envelope("lidar/front", k // 10, t + 3, scan)


def full(envelope: Envelope) -> object:
    """All values of an envelope, bit-exact."""
    return envelope.topic, envelope.sequence, envelope.receive_ns, bits(envelope.message)


def write(path: Path, config: LogConfig = CONFIG) -> str:
    with LogWriter(path, METADATA, config) as log:
        for envelope in envelopes():
            log.write(envelope)
    return log.digest()


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    write(path)
    return path


def test_complete_log_round_trip(complete: Path) -> None:
    back = list(read_log(complete))
    assert [full(e) for e in back] == [full(e) for e in envelopes()]
    assert [e.topic for e in read_log(complete, {"lidar/front"})] == ["lidar/front"] * 10
    assert read_metadata(complete)["versions"] == METADATA["versions"]


def test_log_readable_by_mcap_reader(complete: Path) -> None:
    with complete.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == 210
        assert {m.name for m in reader.iter_metadata()} == {"configuration", "versions", "end"}


def test_summary_of_complete_log(complete: Path) -> None:
    summary = summarize_log(complete)
    assert summary.is_complete
    assert (summary.problems, summary.lost_bytes, summary.messages, summary.undecoded) == ((), 0, 210, 0)
    rows = {t.topic: t for t in summary.topics}
    assert rows["imu"].count == 100
    assert rows["imu"].rate_hz == pytest.approx(100.0)
    assert rows["lidar/front"].longest_gap_s == pytest.approx(0.1)
    assert summary.is_digest_valid is True
    assert summary_json(summary)["topics"][0]["rate_hz"] == pytest.approx(100.0)
    text = render_summary(summary)
    assert "complete" in text
    assert "headland.v1.LidarScan" in text


def test_digest_depends_only_on_messages(tmp_path: Path) -> None:
    first = write(tmp_path / "a.mcap")
    assert first == write(tmp_path / "b.mcap", LogConfig(chunk_kib=64, flush_s=9.0, sync_s=9.0, min_free_mb=0.0))
    with LogWriter(tmp_path / "c.mcap", METADATA, CONFIG) as log:
        for envelope in list(envelopes())[::-1]:
            log.write(envelope)
    assert log.digest() != first


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """(end of chunk, messages up to it) of a complete log."""
    with path.open("rb") as file:
        indexes = make_reader(file).get_summary().chunk_indexes
    out, count = [], 0
    for index in sorted(indexes, key=lambda i: i.chunk_start_offset):
        lengths = [index.message_index_length]
        assert lengths[0] > 0
        count += _messages_in(path, index.chunk_start_offset, index.chunk_length)
        out.append((index.chunk_start_offset + index.chunk_length, count))
    return out


def _messages_in(path: Path, start: int, length: int) -> int:
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk, Message
    from mcap.stream_reader import breakup_chunk

    with path.open("rb") as file:
        file.seek(start + 9)
        return sum(isinstance(r, Message) for r in breakup_chunk(Chunk.read(ReadDataStream(file))))


def test_truncated_log_yields_all_complete_chunks(complete: Path, tmp_path: Path) -> None:
    data, ends = complete.read_bytes(), chunk_ends(complete)
    assert len(ends) >= 9
    truncated = tmp_path / "truncated.mcap"
    borders = {b + d for b, _ in ends for d in (-1, 0, 1)} | {1, 7, 8, 9, 40, len(data) - 1, len(data) - 9}

    @settings(max_examples=60, deadline=None, derandomize=True)
    @given(st.integers(1, len(data) - 1))
    def check(at: int) -> None:
        truncated.write_bytes(data[:at])
        summary = summarize_log(truncated)
        assert not summary.is_complete
        assert summary.messages == max((n for end, n in ends if end <= at), default=0)
        assert summary.problems
        assert [bits(e.message) for e in read_log(truncated)] == [bits(e.message) for e in envelopes()][
            : summary.messages
        ]

    check()
    for at in sorted(borders):
        check.hypothesis.inner_test(at)


def test_damaged_chunk_loses_only_itself(complete: Path, tmp_path: Path) -> None:
    data, ends = complete.read_bytes(), chunk_ends(complete)
    broken = tmp_path / "broken.mcap"
    per_chunk = [b[1] - a[1] for a, b in zip([(0, 0), *ends], ends, strict=False)]
    for k in (3, 5):
        middle = (ends[k - 1][0] + ends[k][0]) // 2
        broken.write_bytes(data[:middle] + bytes([data[middle] ^ 0x5A]) + data[middle + 1 :])
        summary = summarize_log(broken)
        assert not summary.is_complete
        assert summary.messages == 210 - per_chunk[k]
        assert any("chunk" in p for p in summary.problems)


def test_index_tells_whose_log_it_is(complete: Path, tmp_path: Path) -> None:
    assert has_own_messages(complete) is True
    foreign = tmp_path / "foreign.mcap"
    with foreign.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema("headland.v1.ImuSample", "protobuf", b"")
        channels = [writer.register_channel(name, "protobuf", schema) for name in ("/view/imu", "imu")]
        writer.add_message(channels[0], 1, b"", 1)  # the other one has no message
        writer.finish()
    assert has_own_messages(foreign) is False
    data = complete.read_bytes()
    for length in (len(data) - 1, len(data) - 100, len(data) // 2, 200):
        (tmp_path / "cut.mcap").write_bytes(data[:length])
        assert has_own_messages(tmp_path / "cut.mcap") is None


def test_opening_names_the_losses_of_a_damaged_log(complete: Path, tmp_path: Path) -> None:
    data, ends = complete.read_bytes(), chunk_ends(complete)
    whole = [bits(m) for _, _, m in open_recording(complete).read()]
    path = tmp_path / "broken.mcap"
    middle = (ends[2][0] + ends[3][0]) // 2
    path.write_bytes(data[:middle] + bytes([data[middle] ^ 0x5A]) + data[middle + 1 :])
    source = open_recording(path)
    left = [bits(m) for _, _, m in source.read()]
    assert left == whole[: ends[2][1]] + whole[ends[3][1] :]
    (row,) = (row for row in source.table() if row.skipped)
    assert (row.skipped, row.source) == (1, "broken.mcap")
    assert [reason for reason in row.reasons if "chunk" in reason and "bytes lost" in reason]
    path.write_bytes(data[: ends[5][0] + 10])
    source = open_recording(path)
    assert [bits(m) for _, _, m in source.read()] == whole[: ends[5][1]]
    assert any("bytes lost" in note for note in source.description.notes)
    assert not any(row.skipped for row in source.table())


@pytest.mark.parametrize("length", [0, 7, 100, 10**6, 2**63])
def test_wrong_chunk_length_loses_only_its_chunk(complete: Path, tmp_path: Path, length: int) -> None:
    data, ends = complete.read_bytes(), chunk_ends(complete)
    with complete.open("rb") as file:
        start = sorted(i.chunk_start_offset for i in make_reader(file).get_summary().chunk_indexes)[4]
    path = tmp_path / "lost.mcap"
    path.write_bytes(data[: start + 1] + length.to_bytes(8, "little") + data[start + 9 :])
    assert summarize_log(path).messages == 210 - (ends[4][1] - ends[3][1])


def test_digest_covers_topic_time_and_content() -> None:
    seen = set()
    for topic, stamp, payload in [("a", 1, b"x"), ("b", 1, b"x"), ("a", 2, b"x"), ("a", 1, b"y"), ("ax", 1, b"")]:
        digest = Digest()
        digest.add(topic, stamp, payload)
        seen.add(digest.text())
    assert len(seen) == 5


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
def test_changed_bytes_never_yield_wrong_messages(complete: Path, data: st.DataObject) -> None:
    content = bytearray(complete.read_bytes())
    at = data.draw(st.integers(8, len(content) - 9))
    new = data.draw(st.binary(min_size=1, max_size=12))
    content[at : at + len(new)] = new
    path = complete.with_name("changed.mcap")
    path.write_bytes(content)
    assert summarize_log(path).messages <= 210
    originals = {(e.topic, e.sequence): bits(e.message) for e in envelopes()}
    for entry in LogScan(path):
        assert entry.topic in {"imu", "wheel", "lidar/front"} or at < 3000
    if bytes(content) == complete.read_bytes():
        return
    try:
        for envelope in read_log(path):
            assert bits(envelope.message) == originals[envelope.topic, envelope.sequence]
    except LogError:
        pass


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.binary(min_size=0, max_size=200), st.booleans())
def test_random_bytes_are_no_log(tmp_path_factory: pytest.TempPathFactory, data: bytes, has_magic: bool) -> None:
    path = tmp_path_factory.getbasetemp() / "garbage.mcap"
    content = (b"\x89MCAP0\r\n" if has_magic else b"") + data
    path.write_bytes(content)
    if has_magic:
        assert summarize_log(path).messages == 0
        assert not summarize_log(path).is_complete
    elif not b"\x89MCAP0\r\n".startswith(content) or not content:
        with pytest.raises(LogError, match=r"garbage\.mcap"):
            summarize_log(path)


def test_missing_or_empty_log_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"nothing\.mcap"):
        summarize_log(tmp_path / "nothing.mcap")
    (tmp_path / "empty.mcap").touch()
    with pytest.raises(LogError, match="is empty"):
        summarize_log(tmp_path / "empty.mcap")
    with pytest.raises(LogError, match="cannot be read"):
        summarize_log(tmp_path)


def test_log_of_killed_process(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    code = (
        "import os, sys, signal; from pathlib import Path\n"
        "from datasets.log import LogConfig, LogWriter\n"
        "from messages.message import Envelope; from messages.sensors import WheelSample\n"
        "config = LogConfig(chunk_kib=16, flush_s=0.1, sync_s=1.0, min_free_mb=0.0)\n"
        "log = LogWriter(Path(sys.argv[1]), {'versions': {'commit': 'abc'}}, config)\n"
        "for k in range(100): log.write(Envelope('wheel', k, k * 10**7, WheelSample(k, 1.0, 0.0)))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], check=False, cwd=ROOT)
    assert done.returncode == -signal.SIGKILL
    summary = summarize_log(path)
    assert not summary.is_complete
    assert summary.span_s > 0.99 - 3 * CONFIG.flush_s  # one interval collected, one being written
    assert summary.lost_bytes == 0
    assert summary.metadata["versions"] == {"commit": "abc"}


@pytest.mark.parametrize("room", [0, 10, 5000, 20000])
def test_full_disk_error_and_readable_log(tmp_path: Path, room: int) -> None:
    path = tmp_path / "full.mcap"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        with pytest.raises(LogError, match=r"full\.mcap.*MB free"):
            write(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)
    if room >= 5000:
        summary = summarize_log(path)
        assert not summary.is_complete
        assert summary.lost_bytes == 0
        assert summary.messages > 0
    else:
        assert path.stat().st_size <= room


def test_full_device_and_low_space_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="/dev/full"):
        write(Path("/dev/full"))
    free_mb = shutil.disk_usage(tmp_path).free / 1e6
    greedy = CONFIG.model_copy(update={"min_free_mb": free_mb * 2})
    with pytest.raises(LogError, match="are kept free"):
        write(tmp_path / "log.mcap", greedy)
    assert not (tmp_path / "log.mcap").exists()


def test_existing_log_or_missing_folder_refused(tmp_path: Path) -> None:
    write(tmp_path / "log.mcap")
    size = (tmp_path / "log.mcap").stat().st_size
    with pytest.raises(LogError, match="not overwritten"):
        write(tmp_path / "log.mcap")
    assert (tmp_path / "log.mcap").stat().st_size == size
    with pytest.raises(LogError, match="cannot be created"):
        write(tmp_path / "nowhere" / "log.mcap")


def test_obstacles_logged_without_points(tmp_path: Path) -> None:
    k, m = (1, 3), np.ones((4, 3), np.float32)
    obstacles = Obstacles(
        1, "lidar_front", 1, np.ones(k), np.ones(k), np.ones(1), np.ones(k), np.ones((1, 2)), np.ones((1, 8)),
        np.array([0, 4], np.int32), np.arange(4, dtype=np.int32), m,
    )  # fmt: skip
    with LogWriter(tmp_path / "log.mcap", {}, CONFIG) as log:
        log.write(Envelope("obstacles/lidar_front", 0, 1, obstacles))
    (back,) = (e.message for e in read_log(tmp_path / "log.mcap"))
    assert bits(back) == bits(replace(obstacles, points_base_m=np.empty((0, 3), np.float32)))
    assert len(obstacles.points_base_m) == 4


def test_unknown_and_unlogged_topics(tmp_path: Path) -> None:
    from messages.errors import WiringError
    from messages.perception import LidarGround

    wheel = WheelSample(1, 0.0, 0.0)
    with LogWriter(tmp_path / "log.mcap", {}, CONFIG) as log:
        with pytest.raises(WiringError, match="nonsense"):
            log.write(Envelope("nonsense", 0, 1, wheel))
        log.write(Envelope("ground/front", 0, 1, LidarGround(1, 1, np.zeros(1, np.uint8), np.zeros(4))))
        log.write(Envelope("/recorded/wheel", 0, 1, wheel))
    assert [e.topic for e in read_log(tmp_path / "log.mcap")] == ["/recorded/wheel"]


def test_missing_messages_counted(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap", {}, CONFIG) as log:
        for k in (0, 1, 2, 5, 6, 9):
            log.write(Envelope("wheel", k, k + 1, WheelSample(k, 0.0, 0.0)))
    assert summarize_log(tmp_path / "log.mcap").topics[0].missing == 4


def test_frame_trees() -> None:
    tree = FrameTree()
    for parent, child in [("map", "odom"), ("odom", "base"), ("base", "imu"), ("base", "imu")]:
        tree.add(parent, child)
    assert tree.is_one_tree
    tree.add("other", "camera")
    assert not tree.is_one_tree
    for extra in [("imu", "map"), ("map", "base"), ("base", "base")]:
        tree = FrameTree()
        for parent, child in [("map", "odom"), ("odom", "base"), ("base", "imu"), extra]:
            tree.add(parent, child)
        assert not tree.is_one_tree


def test_stack_configuration_is_valid() -> None:
    parse(LogConfig, read_yaml(CONFIGS / "stack/datasets.yaml")["log"], "log")
    assert os.sep


def test_drive_without_room_is_refused_before_it_starts(tmp_path: Path) -> None:
    check_room(tmp_path, 60.0, 0.001, 0.0)
    with pytest.raises(LogError, match=r"a drive of about 1000 min needs 60000000064 MB \(64 MB of it are kept free\)"):
        check_room(tmp_path, 60_000.0, 1e6, 64.0)
