"""Table of an import: every stream with its read and skipped messages and the reasons."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Writer as Bag1

from configs.strict import CONFIGS, parse, read_yaml
from datasets.importers.excerpt import excerpt
from datasets.importers.formats import open_recording
from datasets.importers.recording import SOURCE, TopicCount
from datasets.importers.ros_types import ros_types
from datasets.importers.selection import bind, select
from datasets.importers.write_recording import write_recording
from datasets.log import LogConfig
from datasets.reader import read_metadata
from datasets.viewer import ViewerConfig
from messages.errors import LogError
from messages.sensors import ImuSample
from runtime.__main__ import main
from tests.datasets.test_log_importers import ros_messages

LOG = LogConfig(chunk_kib=256, flush_s=1.0, sync_s=9.0, min_free_mb=0.0)
VIEW = parse(ViewerConfig, read_yaml(CONFIGS / "stack/datasets.yaml")["viewer"], "viewer")
ROS1 = ros_types("ROS1_NOETIC")


def write_bag(path: Path, damaged: dict[str, int], topics: set[str] | None = None) -> Path:
    """The messages of a moving robot; of each topic in `damaged` the message of this number is cut by half."""
    counts: Counter[str] = Counter()
    with Bag1(path) as bag:
        connections: dict[str, Any] = {}
        for topic, kind, t, message in ros_messages(ROS1, True):
            if topics is not None and topic not in topics:
                continue
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=ROS1)
            raw = bytes(ROS1.serialize_ros1(message, kind))
            cut = damaged.get(topic) == counts[topic]
            bag.write(connections[topic], t, raw[: len(raw) // 2] if cut else raw)
            counts[topic] += 1
    return path


def by_source(rows: tuple[TopicCount, ...]) -> dict[str, tuple[int, int | None]]:
    return {row.source: (row.read, row.skipped) for row in rows}


def test_bad_messages_are_skipped_and_counted(tmp_path: Path) -> None:
    damaged = {"/imu/data": 0, "/points": 1, "/tf": 2, "/fix": 1}
    source = open_recording(write_bag(tmp_path / "x.bag", damaged))
    received = list(source.read())
    expected = {"/imu/data": (2, 1), "/fix": (2, 1), "/odom": (3, 0), "/points": (2, 1),
                "/tf_static": (0, 1), "/tf": (0, 3), "/chatter": (0, 3)}  # fmt: skip
    assert by_source(source.table()) == expected
    assert len(received) == sum(read for read, _ in expected.values())
    reasons = {row.source: row.reasons for row in source.table()}
    assert list(reasons["/chatter"]) == ["the type std_msgs/msg/String is not read"]
    assert sorted(reasons["/tf"].values()) == [1, 2]
    assert all(reason for counts in reasons.values() for reason in counts)
    list(source.read())
    assert by_source(source.table()) == expected, "counts of one pass, not of all"


def test_imported_log_keeps_the_table(tmp_path: Path) -> None:
    source = open_recording(write_bag(tmp_path / "x.bag", {"/imu/data": 1}))
    write_recording(source, tmp_path / "x.mcap", LOG, VIEW)
    copy = open_recording(tmp_path / "x.mcap")
    list(copy.read())
    assert by_source(copy.table()) == by_source(source.table())
    about = json.loads(read_metadata(tmp_path / "x.mcap")[SOURCE]["description"])
    assert [(i["source"], i["count"]) for i in about["ignored"] if i["source"] == "/imu/data"] == [("/imu/data", 1)]


def test_excerpt_has_a_table_of_its_own(tmp_path: Path) -> None:
    part = excerpt(open_recording(write_bag(tmp_path / "x.bag", {"/imu/data": 1})), 0.0, 0.15)
    assert sum(isinstance(m, ImuSample) for _, _, m in part.read()) == 1
    assert by_source(part.table())["/imu/data"] == (1, 1)


def test_nothing_readable_is_an_error(tmp_path: Path) -> None:
    for topics in ({"/chatter"}, {"/tf", "/chatter"}):
        source = open_recording(write_bag(tmp_path / f"{len(topics)}.bag", {}, topics))
        with pytest.raises(LogError, match=r"no readable message; .*/chatter .*std_msgs/msg/String is not read"):
            list(source.read())
        with pytest.raises(LogError, match="no readable message"):
            write_recording(source, tmp_path / "x.mcap", LOG, VIEW)
        assert not (tmp_path / "x.mcap").exists()


def test_selected_topics_by_source_or_topic(tmp_path: Path) -> None:
    whole = open_recording(write_bag(tmp_path / "x.bag", {"/imu/data": 1, "/odom": 1}))
    part = select(whole, ["/imu/data", "gnss/fix"])
    assert {topic for _, topic, _ in part.read()} == {"imu/imu_data", "gnss/fix"}
    rows = by_source(part.table())
    assert (rows["/imu/data"], rows["/odom"], rows["/points"]) == ((2, 1), (0, 3), (0, 3))
    reasons = {row.source: row.reasons for row in part.table()}
    assert reasons["/points"] == {"not selected": 3}
    assert reasons["/odom"]["not selected"] == 2
    with pytest.raises(LogError, match=r"no topic '/chatter'; the recording has .*; /chatter: the type std_msgs"):
        select(whole, ["/chatter"])


def run(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    """Exit code of a command line."""
    monkeypatch.setattr("sys.argv", ["headland", *map(str, words)])
    return main()


def test_import_command_prints_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, out = write_bag(tmp_path / "x.bag", {"/imu/data": 1}), tmp_path / "x.mcap"
    assert run(monkeypatch, "import", bag, "--out", out, "--json", "--topics", "/imu/data,/fix") == 0
    rows = json.loads(capsys.readouterr().out)["streams"]
    assert {(r["source"], r["read"], r["skipped"]) for r in rows} >= {("/imu/data", 2, 1), ("/odom", 0, 3)}
    assert run(monkeypatch, "inspect-log", out, "--json") == 0
    assert json.loads(capsys.readouterr().out)["streams"] == rows
    assert run(monkeypatch, "inspect-log", out) == 0
    assert "3 × not selected" in capsys.readouterr().out


def test_import_command_refuses_a_recording_of_which_nothing_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_bag(tmp_path / "x.bag", {}, {"/chatter"})
    assert run(monkeypatch, "import", bag, "--out", tmp_path / "x.mcap") == 2
    assert "no readable message; streams: /chatter" in capsys.readouterr().err
    assert not (tmp_path / "x.mcap").exists()


def test_inspect_log_of_a_folder_says_what_to_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "inspect-log", tmp_path) == 2
    assert f"{tmp_path}: is a folder; import it first" in capsys.readouterr().err
    (tmp_path / "a.mcap").touch()
    assert run(monkeypatch, "inspect-log", tmp_path) == 2
    assert f"{tmp_path}: is a folder; give one of its logs (a.mcap)" in capsys.readouterr().err


def test_bound_topics(tmp_path: Path) -> None:
    whole = open_recording(write_bag(tmp_path / "x.bag", {}))
    bound = bind(whole, {"lidar/roof": ("/points", "a"), "gnss/odd": ("gnss/fix", "b"), "imu": ("imu/data", "c")})
    assert {topic for _, topic, _ in bound.read()} == {"lidar/roof", "gnss/odd", "imu", "odom/odom"}
    assert by_source(bound.table())["/points"] == (3, 0)
    with pytest.raises(LogError, match="b: '/points' is bound to 'lidar/a' already"):
        bind(whole, {"lidar/a": ("/points", "a"), "lidar/b": ("/points", "b")})
