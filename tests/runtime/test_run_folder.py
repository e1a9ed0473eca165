"""A run folder belongs to one command: locked, continued by the same command only; no other file is touched."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from messages.errors import HeadlandError
from runtime.run_folder import RunFolder

ROOT = Path(__file__).resolve().parents[2]
SEED_1, SEED_2 = {"seed": 1}, {"seed": 2}


def contents(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


def interrupted(out: Path) -> None:
    """Leaves a run as after a kill: log in two parts, a record, no end marker."""
    with RunFolder("run", out, SEED_1) as folder:
        folder.record("conditions", {})
        folder.file("log.mcap").write_text("first part")
        (out / "log.2.mcap").write_text("second part")


def test_folder_with_a_file_of_the_user_is_refused_and_unchanged(tmp_path: Path) -> None:
    (tmp_path / "field.geojson").write_text("mine")
    with pytest.raises(HeadlandError, match=r"contains field.geojson"):
        RunFolder("run", tmp_path, SEED_1)
    assert contents(tmp_path) == {"field.geojson": "mine"}


def test_file_as_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("mine")
    for out in (tmp_path / "x", tmp_path / "x" / "y"):
        with pytest.raises(HeadlandError, match="x"):
            RunFolder("run", out, SEED_1)
    assert contents(tmp_path) == {"x": "mine"}


def test_interrupted_drive_is_kept_and_the_same_command_begins_again(tmp_path: Path) -> None:
    interrupted(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    for number in (1, 2):
        with RunFolder("run", tmp_path, SEED_1) as folder:
            folder.file("log.mcap").write_text("complete")
            folder.record("conditions", {})
            found = contents(tmp_path)
            assert found["interrupted-1/log.mcap"] == "first part"
            assert found["interrupted-1/log.2.mcap"] == "second part"
            assert f"interrupted-{number}/result.jsonl" in found
            assert found["notes.txt"] == "mine"
            assert "log.2.mcap" not in found


def test_name_taken_by_the_user_after_an_interruption_is_not_overwritten(tmp_path: Path) -> None:
    interrupted(tmp_path)
    (tmp_path / "report.html").write_text("mine")
    with RunFolder("run", tmp_path, SEED_1) as folder, pytest.raises(HeadlandError, match=r"report.html: exists"):
        folder.file("report.html")
    assert (tmp_path / "report.html").read_text() == "mine"


@pytest.mark.parametrize(("verb", "command"), [("run", SEED_2), ("plan", SEED_1), ("live", SEED_1)])
def test_another_command_is_refused(tmp_path: Path, verb: str, command: dict[str, int]) -> None:
    interrupted(tmp_path)
    before = contents(tmp_path)
    with pytest.raises(HeadlandError, match="of another command"):
        RunFolder(verb, tmp_path, command)
    assert contents(tmp_path) == before


def test_complete_run_is_not_repeated(tmp_path: Path) -> None:
    with RunFolder("run", tmp_path, SEED_1) as folder:
        folder.file("log.mcap").write_text("drive")
        folder.finish()
    before = contents(tmp_path)
    with pytest.raises(HeadlandError, match="is complete"):
        RunFolder("run", tmp_path, SEED_1)
    assert contents(tmp_path) == before


def test_second_writer_is_refused_until_the_first_is_gone(tmp_path: Path) -> None:
    with RunFolder("run", tmp_path, SEED_1), pytest.raises(HeadlandError, match="another run is writing"):
        RunFolder("run", tmp_path, SEED_1)
    RunFolder("run", tmp_path, SEED_1).close()


def test_lock_of_a_killed_process_is_free(tmp_path: Path) -> None:
    code = "import time; from pathlib import Path; from runtime.run_folder import RunFolder as R\n"
    code += f"f = R('run', Path({str(tmp_path)!r}), {SEED_1!r}); f.file('log.mcap')\n"
    code += "print(1, flush=True); time.sleep(60)"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=environment)
    assert process.stdout is not None
    process.stdout.readline()
    with pytest.raises(HeadlandError, match="another run is writing"):
        RunFolder("run", tmp_path, SEED_1)
    process.kill()
    process.communicate()
    with RunFolder("run", tmp_path, SEED_1) as folder:
        folder.file("log.mcap")


def test_folder_made_for_a_run_that_did_not_begin_is_removed(tmp_path: Path) -> None:
    with RunFolder("run", tmp_path / "a" / "b", SEED_1):
        assert (tmp_path / "a" / "b").is_dir()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "mine").mkdir()
    RunFolder("run", tmp_path / "mine", SEED_1).close()
    assert (tmp_path / "mine").is_dir()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"files": 3}'])
def test_foreign_manifest_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(HeadlandError, match=r"manifest.json"):
        RunFolder("run", tmp_path, SEED_1)
    assert contents(tmp_path) == {"manifest.json": text}


def test_manifest_that_names_files_elsewhere_moves_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    interrupted(out)
    (tmp_path / "x").write_text("mine")
    (out / "manifest.json").write_text('{"files": ["../x"], "verb": "run", "command": {"seed": 1}}')
    with RunFolder("run", out, SEED_1) as folder, pytest.raises(HeadlandError, match="was not made by this run"):
        folder.file("log.mcap")
    assert (tmp_path / "x").read_text() == "mine"


def test_campaign_keeps_the_results_of_an_interrupted_one(tmp_path: Path) -> None:
    for _ in range(2):
        with RunFolder("campaign-demo", tmp_path, {"campaign": "demo"}, resumes=True) as folder:
            folder.file("seed-1").mkdir(exist_ok=True)
            (tmp_path / "seed-1" / "result.jsonl").write_text("done")
    assert contents(tmp_path)["seed-1/result.jsonl"] == "done"
