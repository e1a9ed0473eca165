"""Labelling of a log without truth: proposed objects, decisions of a person, and what `validate` then says."""

import json
from pathlib import Path
from typing import Any

import pytest

from datasets.importers.sidecar_lines import read_sidecar
from messages.errors import HeadlandError
from runtime.commands import label, validate
from runtime.commands.options import make_parser
from tests.replay.recorded_drive import START_NS, drive, vehicle_file

PERSON_M = (22.0, 0.3)


def run(*words: object) -> int:
    arguments = make_parser().parse_args([str(word) for word in words])
    return label.main(arguments) if words[0] == "label" else validate.main(arguments)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive towards a person without truth, validated once: log, vehicle and the results in `first`."""
    top = tmp_path_factory.mktemp("Hof mit Öhr")
    log = drive(top / "drive 1.mcap", PERSON_M, seconds=2.5, has_truth=False)
    run("validate", log, "--vehicle", vehicle_file(top), "--out", top / "first", "--jobs", "1")
    return top


@pytest.fixture
def log(recorded: Path, tmp_path: Path) -> Path:
    """The log and its proposal beside it, in a folder of their own."""
    path = tmp_path / "drive 1.mcap"
    path.symlink_to(recorded / path.name)
    proposal = recorded / "first" / "drive 1.mcap.proposed.jsonl"
    (tmp_path / proposal.name).write_bytes(proposal.read_bytes())
    return path


def listed(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    capsys.readouterr()
    assert run("label", *words, "--json") == 0
    return json.loads(capsys.readouterr().out)


def judged(capsys: pytest.CaptureFixture[str], recorded: Path, log: Path) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    words = ("--vehicle", recorded / "car.yaml", "--out", log.parent / "out", "--json", "--jobs", "1")
    code = run("validate", log, *words)
    return code, json.loads(capsys.readouterr().out)


def test_person_in_the_path_is_proposed_and_no_truth(recorded: Path) -> None:
    file = recorded / "first" / "drive 1.mcap.proposed.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    (head,) = [line for line in lines if "picture" in line]
    boxes = [line for line in lines if "stamp_ns" in line]
    assert (head["status"], head["is_stop_requested"], len(boxes)) == ("proposed", True, 25)
    assert (recorded / "first" / head["picture"]).read_bytes().startswith(b"\x89PNG")
    for box in boxes:  # the lidar is 1 m ahead of the origin, the machine drives at 6 m/s
        ahead_m = PERSON_M[0] - 1.0 - 6.0 * (box["stamp_ns"] - START_NS) * 1e-9
        assert box["center_m"][:2] == pytest.approx([ahead_m, PERSON_M[1]], abs=0.4)
    assert head["range_m"] == pytest.approx([18.2, 3.8], abs=0.5)
    sidecar = read_sidecar(file)
    assert not any(message.objects for message in sidecar.messages)
    assert not sidecar.is_complete


def test_accepted_person_is_judged(recorded: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (one,) = listed(capsys, log)["objects"]
    after = listed(capsys, log, "--accept", one["id"], "--class", "person", "--size", "0.5,0.5,1.75")
    assert (after["undecided"], after["objects"][0]["status"]) == ([], "accepted")
    code, result = judged(capsys, recorded, log)
    assert [(e["class"], e["outcome"]) for e in result["encounters"]] == [("person", "in time")]
    assert (code, result["state"], result["false_stops"]) == (3, "not_shown", 0)
    assert "missed objects are not shown" in result["not_shown"][0]["reason"]
    assert (result["missed_share"], "missed encounters: not shown" in result["headline"]) == (None, True)
    assert listed(capsys, log, "--complete")["is_complete"]
    code, result = judged(capsys, recorded, log)
    assert (code, result["missed_share"]["of"]) == (0, 1)


def test_rejected_object_makes_the_stop_false(recorded: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (one,) = listed(capsys, log)["objects"]
    listed(capsys, log, "--reject", one["id"])
    code, result = judged(capsys, recorded, log)
    assert (code, result["state"], result["false_stops"], result["encounters"]) == (1, "failed", 1, [])


def test_undecided_object_leaves_its_moments_open(
    recorded: Path, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    listed(capsys, log, "--add", "1.0:25,6", "2.0:19,6", "--class", "pole", "--size", "0.2,0.2,2")
    code, result = judged(capsys, recorded, log)
    assert (code, [e["outcome"] for e in result["encounters"]]) == (3, ["not shown"])
    assert "undecided proposed objects: " in result["not_shown"][0]["reason"]
    assert [stop["is_false"] for stop in result["stops"]] == [None]
    with pytest.raises(HeadlandError, match=r"--complete: objects [0-9]+ are undecided"):
        run("label", log, "--complete")


def test_added_object_moves_between_its_positions(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (one,) = listed(capsys, log)["objects"]
    listed(capsys, log, "--reject", one["id"])
    after = listed(capsys, log, "--add", "0.5:20,1", "1.5:14,1", "--class", "animal", "--size", "1,0.5,0.8")
    added = after["objects"][-1]
    assert (added["id"], added["status"], added["class"]) == (one["id"] + 1, "accepted", "animal")
    positions = {
        round((m.stamp_ns - START_NS) * 1e-9, 2): m.objects[0].center_map_m
        for m in read_sidecar(Path(after["truth"])).messages
        if m.objects
    }
    assert (min(positions), max(positions)) == (0.5, 1.5)
    assert positions[1.0] == pytest.approx([17.0, 1.0, 0.4 - 1.8])


def test_lines_are_never_lost(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (one,) = listed(capsys, log)["objects"]
    listed(capsys, log, "--add", "0.5:20,1", "--class", "mound", "--size", "1,1,0.5")
    truth = Path(f"{log}.truth.jsonl")
    before = truth.read_text().splitlines()
    listed(capsys, log, "--accept", one["id"])
    after = truth.read_text().splitlines()
    assert len(after) == len(before)
    assert [json.loads(line)["id"] for line in after[1:]] == [json.loads(line)["id"] for line in before[1:]]
    text = truth.read_text()
    for words in (("--accept", 99, 98), ("--accept", one["id"], "--reject", one["id"]), ("--accept", "1", "--list")):
        with pytest.raises(HeadlandError):
            run("label", log, *words)
    with pytest.raises(HeadlandError, match="no object 98, 99; objects: "):
        run("label", log, "--accept", 99, 98)
    assert truth.read_text() == text
    assert sorted(p.name for p in log.parent.iterdir()) == sorted([log.name, truth.name, f"{log.name}.proposed.jsonl"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--accept", 1, "--class", "cow"], "--class cow: one of "),
        (["--class", "person"], "need --accept"),
        (["--add", "1:2,3"], "--add needs --class and --size"),
        (["--add", "1;2,3", "--class", "person", "--size", "1,1,1"], "not T:X,Y"),
        (["--add", "1:nan,3", "--class", "person", "--size", "1,1,1"], "2 numbers needed"),
        (["--add", "99:2,3", "--class", "person", "--size", "1,1,1"], "not within the log"),
        (["--accept", 1, "--size", "1,0,1"], "must be positive"),
        (["--truth", "/nowhere/t.jsonl", "--accept", 1], "cannot be opened"),
    ],
)
def test_wrong_decisions_write_nothing(log: Path, words: list[object], message: str) -> None:
    with pytest.raises(HeadlandError, match=message):
        run("label", log, *words)
    assert not Path(f"{log}.truth.jsonl").exists()


def test_log_without_proposal_and_labels_of_another_log(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    other = tmp_path / "other.mcap"
    other.symlink_to(log)
    with pytest.raises(HeadlandError, match=r"no proposed objects; first run headland validate other\.mcap"):
        run("label", other)
    with pytest.raises(HeadlandError, match=r"labels of drive 1\.mcap, not of other\.mcap"):
        run("label", other, "--proposed", f"{log}.proposed.jsonl")
    for words in (["label", tmp_path / "none.mcap"], ["label", log, "--proposed", "nothing.jsonl"]):
        with pytest.raises(SystemExit):
            run(*words)


def test_newest_run_is_the_default_proposal(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("20260101T000000Z-validate", "20270101T000000Z-validate", "20280101T000000Z-run"):
        (tmp_path / "runs" / name).mkdir(parents=True)
    newest = tmp_path / "runs" / "20270101T000000Z-validate" / f"{log.name}.proposed.jsonl"
    Path(f"{log}.proposed.jsonl").rename(newest)
    result = listed(capsys, log)
    assert Path(result["proposed"]).resolve() == newest
    assert result["objects"][0]["picture"].startswith("runs/20270101T000000Z-validate/logs/")


def test_id_of_another_object_is_refused(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (one,) = listed(capsys, log)["objects"]
    listed(capsys, log, "--accept", one["id"])
    proposal = Path(f"{log}.proposed.jsonl")
    moved = proposal.read_text().replace('"center_m": [2', '"center_m": [1')
    assert moved != proposal.read_text()
    proposal.write_text(moved)
    with pytest.raises(HeadlandError, match=f"object {one['id']} is another one than object {one['id']} of"):
        run("label", log)
