"""Content of replay.mcap and of a drive's log for viewers, read with the mcap library alone."""

import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from benchmarks.long_drive import VEHICLE, motion, write_drive
from configs.strict import CONFIGS
from datasets.reader import LogScan
from runtime.__main__ import main
from runtime.replay import progress
from runtime.replay import replay_log as module
from tests.replay.recorded_drive import drive, vehicle_file

LAYOUT = json.loads((CONFIGS / "viewer" / "foxglove.json").read_text())


def read(log: Path) -> dict[str, list[tuple[int, Any]]]:
    """Times and messages of all topics, decoded by the schemas in the log."""
    out: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, proto in reader.iter_decoded_messages():
            out[channel.topic].append((message.publish_time, proto))
    return out


def raw(log: Path, topic: str) -> list[bytes]:
    return [entry.data for entry in LogScan(log, {topic})]


def validate(monkeypatch: pytest.MonkeyPatch, log: Path, folder: Path, *words: str) -> tuple[int, Path]:
    """Exit code of `headland validate`, and its replay.mcap."""
    folder.mkdir(exist_ok=True)
    vehicle = folder / "vehicle.yaml"
    vehicle.exists() or vehicle.write_text(VEHICLE)
    out = folder / f"out{len(words)}"
    command = ["headland", "validate", str(log), "--vehicle", str(vehicle), "--out", str(out), "--jobs", "1", *words]
    monkeypatch.setattr("sys.argv", command)
    return main(), out / "logs" / log.name / "replay.mcap"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("long") / "drive.mcap"
    write_drive(path, 6.0)
    return path


def test_replay_has_sensor_data_and_viewer_topics(
    monkeypatch: pytest.MonkeyPatch, recorded: Path, tmp_path: Path
) -> None:
    _, replayed = validate(monkeypatch, recorded, tmp_path)
    for topic in ("lidar/top", "camera/front"):
        assert raw(replayed, topic) == raw(recorded, topic) != [], topic
    seen = read(replayed)
    assert {"/view/lidar/top", "/view/camera/front", "/view/odom", "/view/map_pose", "/view/state"} <= seen.keys()
    assert seen["/view/truth_objects/top"][0][1].entities[0].frame_id == "lidar/top"
    start_ns = seen["/view/odom"][0][0]
    for stamp_ns, pose in seen["/view/odom"]:
        x, y, yaw, speed, _ = motion((stamp_ns - start_ns) * 1e-9)
        assert np.allclose([pose.x_m, pose.y_m, pose.yaw_rad, pose.speed_mps], [x, y, yaw, speed], atol=0.15)
    one = seen["/view/camera/front/calibration"][0][1]
    assert (one.width, one.height, list(one.K)) == (640, 480, [500, 0, 319.5, 0, 500, 239.5, 0, 0, 1])
    frames = {t.child_frame_id: t for t in seen["/view/mounts"][0][1].transforms}
    assert seen["/view/camera/front"][0][1].frame_id == one.frame_id == "camera/front/optical"
    assert frames["camera/front/optical"].parent_frame_id == "camera/front"


def test_replay_without_sensor_data(monkeypatch: pytest.MonkeyPatch, recorded: Path, tmp_path: Path) -> None:
    _, replayed = validate(monkeypatch, recorded, tmp_path, "--without-sensor-data")
    seen = {entry.topic for entry in LogScan(replayed)}
    assert not {"lidar/top", "camera/front"} & seen
    assert {"tracks", "supervisor", "imu", "gnss/main"} <= seen


def test_disk_without_space_for_the_sensor_data(
    monkeypatch: pytest.MonkeyPatch, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "PACKED_SHARE", 1e9)
    code, replayed = validate(monkeypatch, recorded, tmp_path)
    assert code == 2
    assert "--without-sensor-data" in capsys.readouterr().err
    assert not replayed.exists()


def test_interrupted_replay_leaves_no_result(
    monkeypatch: pytest.MonkeyPatch, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "EVERY_S", 0.0)
    _, whole = validate(monkeypatch, recorded, tmp_path / "whole")
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith(f"{recorded.name}: replayed")]
    assert lines[-1].startswith(f"{recorded.name}: replayed 6 of 6 s, about 0 min left")

    def interrupt(self: progress.PassProgress, log_ns: int) -> None:
        if self._span_ns is not None and log_ns - self._span_ns[0] > 3e9:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(progress.PassProgress, "at", interrupt)
        code, replayed = validate(patch, recorded, tmp_path)
    assert code == 130
    assert {path.parts[0] for path in relative_files(tmp_path / "out0")} == {".incomplete", "manifest.json"}
    code, replayed = validate(monkeypatch, recorded, tmp_path)
    assert code == 3
    assert not (tmp_path / "out0" / ".incomplete").exists()
    results = [json.loads((log.parent / "result.json").read_text()) for log in (whole, replayed)]
    assert results[0]["digest"] == results[1]["digest"]


def relative_files(folder: Path) -> list[Path]:
    return [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]


def test_encounters_and_stops_are_events(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    log = drive(tmp_path / "person.mcap", (40.0, 0.0), seconds=6.0)
    vehicle_file(tmp_path).rename(tmp_path / "vehicle.yaml")
    _, replayed = validate(monkeypatch, log, tmp_path)
    seen = read(replayed)
    events = [(e.kind, e.id, e.outcome) for _, e in seen["/view/events"]]
    result = json.loads((replayed.parent / "result.json").read_text())
    encounters = [("encounter", e["id"], e["outcome"]) for e in result["encounters"]]
    assert encounters
    assert set(encounters) <= set(events)
    assert ("stop", -1, "requested") in events
    assert [e.text for _, e in seen["/view/events"]] == [line.message for _, line in seen["/view/log"]]


def named_in_layout() -> tuple[set[str], set[str]]:
    """Topics, and `topic.field` paths, of the layout."""
    topics, paths = set[str](), set[str]()
    for name, panel in LAYOUT["configById"].items():
        kind = name.partition("!")[0]
        topics |= set(panel.get("topics", {})) | set(panel.get("imageMode", {}).values())
        topics |= {panel["topicToRender"]} if kind == "RosOut" else set()
        paths |= {path["value"] for path in panel.get("paths", [])}
    return topics, paths


def test_layout_names_topics_and_fields_of_a_drive(log: Path) -> None:
    seen = read(log)
    topics, paths = named_in_layout()
    assert len(topics) > 10
    assert len(paths) > 8
    assert not topics - seen.keys()
    for path in paths:
        topic, _, name = path.partition(".")
        assert hasattr(seen[topic][0][1], name), path
    numbers = [getattr(m, "clearance_m", math.nan) for _, m in seen["/view/state"]]
    assert any(math.isfinite(number) for number in numbers)


def test_layout_places_every_panel() -> None:
    def panels(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    assert sorted(panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])
