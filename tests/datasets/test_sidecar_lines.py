"""Truth sidecars: decisions, coverage, hostile lines, and stamps that are not of the log."""

import json
from pathlib import Path
from typing import Any

import pytest

from datasets.importers.sidecar_lines import Status, read_sidecar
from datasets.importers.truth_sidecar import open_with_truth
from messages.errors import LogError
from messages.truth import Occlusion, TrueObjects
from tests.replay.recorded_drive import START_NS, drive

FILE = {"log": "a", "frame": "", "first_ns": 0, "last_ns": 10**9, "period_s": 0.1, "ground_m": -1.5}
HEAD = {"id": 1, "status": "accepted", "class": "person"}


def box(stamp_s: float, i: int = 1, **more: Any) -> dict[str, Any]:
    return {"stamp_s": stamp_s, "id": i, "class": "person", "center_m": [9, 0, 0], "size_m": [1, 1, 2]} | more


def write(folder: Path, *lines: dict[str, Any] | str) -> Path:
    path = folder / "t.truth.jsonl"
    path.write_text("\n".join(line if isinstance(line, str) else json.dumps(line) for line in lines) + "\n")
    return path


def there(folder: Path, *lines: dict[str, Any]) -> dict[float, list[int]]:
    return {m.stamp_ns * 1e-9: [o.id for o in m.objects] for m in read_sidecar(write(folder, *lines)).messages}


def test_boxes_alone_are_complete_truth(tmp_path: Path) -> None:
    sidecar = read_sidecar(write(tmp_path, box(0.5), {"stamp_s": 0.7}, box(0.5, 2, frame="top", note="hat")))
    assert [[o.id for o in m.objects] for m in sidecar.messages] == [[1, 2], []]
    assert (sidecar.frame, sidecar.is_complete) == ("top", True)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([HEAD | {"status": "proposed"}, box(0.5)], {}),
        ([HEAD | {"status": "rejected"}, box(0.5)], {0.5: []}),
        ([box(0.5, status="proposed")], {}),
        ([box(0.5, status="proposed"), box(0.6), box(0.7, 2), box(0.9, 2)], {0.9: [2]}),
        ([HEAD, box(0.5, status="proposed")], {0.5: [1]}),
        ([HEAD | {"status": "proposed"}, box(0.5, status="accepted")], {}),
    ],
)
def test_only_accepted_objects_are_truth(
    tmp_path: Path, lines: list[dict[str, Any]], expected: dict[float, list[int]]
) -> None:
    found = there(tmp_path, *lines)
    assert {round(t, 3): ids for t, ids in found.items()} == expected
    assert not read_sidecar(tmp_path / "t.truth.jsonl").is_complete


def test_line_of_the_file_covers_the_log(tmp_path: Path) -> None:
    found = there(tmp_path, FILE, HEAD, box(0.4), box(0.6, center_m=[7, 0, 0]))
    assert {round(t, 2) for t, ids in found.items() if ids} == {0.4, 0.45, 0.5, 0.55, 0.6}
    assert (min(found), max(found)) == (0.0, 1.0)
    (middle,) = [m for m in read_sidecar(tmp_path / "t.truth.jsonl").messages if m.stamp_ns == 500_000_000]
    assert middle.objects[0].center_map_m[0] == pytest.approx(8.0)


def test_no_truth_at_all_around_an_undecided_object(tmp_path: Path) -> None:
    found = there(tmp_path, FILE, HEAD, box(0.1), box(0.9), HEAD | {"id": 2, "status": "proposed"}, box(0.5, 2))
    assert {round(t, 2) for t in found} == {0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0}
    (undecided,) = [o for o in read_sidecar(tmp_path / "t.truth.jsonl").objects if o.status is Status.PROPOSED]
    assert (undecided.id, undecided.first_ns) == (2, 500_000_000)


def test_class_and_size_of_the_object_hold_and_its_foot_stays(tmp_path: Path) -> None:
    head = HEAD | {"class": "vehicle", "size_m": [4, 2, 3]}
    (message,) = read_sidecar(write(tmp_path, head, box(0.5, role=""))).messages
    (one,) = message.objects
    assert (one.label.value, one.size_m.tolist(), one.center_map_m.tolist()) == ("vehicle", [4, 2, 3], [9, 0, 0.5])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([box(0.5) | {"yaw_rad": 1.0}], r"t.truth.jsonl:1: yaw_rad = 1.0"),
        ([HEAD | {"staus": "accepted"}, box(0.5)], "staus"),
        ([HEAD | {"status": "maybe"}, box(0.5)], "maybe"),
        ([HEAD, HEAD, box(0.5)], "object 1 is there twice"),
        ([box(0.5), box(0.5)], "object 1 at 500000000 ns is there twice"),
        ([HEAD], "object 1 has no box"),
        ([FILE, FILE, HEAD, box(0.5)], "log is there twice"),
        ([FILE | {"last_ns": -5}, HEAD, box(0.5)], "first_ns to last_ns"),
        ([FILE | {"last_ns": 10**18}, HEAD, box(0.5)], "first_ns to last_ns"),
        ([FILE | {"period_s": 0.0}], "period_s"),
        ([box(0.5, size_m=[1, 1, 0])], "size_m"),
        ([box(0.5, center_m=[1, 1])], "center_m"),
        ([{"id": 3, "class": "person", "center_m": [1, 1, 1]}], "t.truth.jsonl:1"),
        ([{"class": "person"}], "t.truth.jsonl:1"),
        (["{"], "t.truth.jsonl:1: not JSON"),
        (["[1]"], "not a JSON object"),
        (['{"stamp_s": NaN, "id": 1}'], "t.truth.jsonl:1"),
    ],
)
def test_wrong_lines_are_named(tmp_path: Path, lines: list[Any], message: str) -> None:
    with pytest.raises(LogError, match=message):
        read_sidecar(write(tmp_path, *lines))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("sidecar") / "log.mcap", None, seconds=1.0, has_truth=False)


def stamped(*offsets_s: float) -> list[dict[str, Any]]:
    return [
        {k: v for k, v in box(0.0).items() if k != "stamp_s"} | {"stamp_ns": START_NS + round(t * 1e9)}
        for t in offsets_s
    ]


def test_stamps_outside_of_the_log_are_skipped_and_counted(log: Path, tmp_path: Path) -> None:
    recording = open_with_truth(log, write(tmp_path, *stamped(-7200.0, -0.5, 0.2, 0.25, 1.1, 9e5)), "any")
    rows = [m for _, _, m in recording.read() if isinstance(m, TrueObjects)]
    assert [round((m.stamp_ns - START_NS) * 1e-9, 2) for m in rows] == [-0.5, 0.2, 0.25, 1.1]
    (row,) = [row for row in recording.table() if row.source_type == "sidecar"]
    assert (row.read, row.skipped, dict(row.reasons)) == (4, 2, {"stamp outside of the log": 2})


def test_sidecar_of_another_time_or_frame_is_refused(log: Path, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no stamp is within the log"):
        list(open_with_truth(log, write(tmp_path, *stamped(-100.0, 500.0)), "any").read())
    with pytest.raises(LogError, match="frame 'nose' is none of the log's lidars"):
        open_with_truth(log, write(tmp_path, *[line | {"frame": "nose"} for line in stamped(0.5)]), "any")


@pytest.mark.parametrize(("values", "expected"), [({}, Occlusion.UNKNOWN), ({"occlusion": "partly"}, Occlusion.PARTLY)])
def test_occlusion_of_a_box(tmp_path: Path, values: dict[str, str], expected: Occlusion) -> None:
    (message,) = read_sidecar(write(tmp_path, box(1.5, **values))).messages
    assert (message.stamp_ns, message.objects[0].occlusion) == (1_500_000_000, expected)


def test_unknown_word_for_occlusion_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r":1: .*half"):
        read_sidecar(write(tmp_path, box(1.5, occlusion="half")))
