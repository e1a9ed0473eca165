"""Results replace only files that were written as results, all at once, and never when the new ones are incomplete."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from messages.errors import HeadlandError
from runtime.result_folder import ResultFolder


def contents(folder: Path) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): p.read_text()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and not p.is_symlink()
    }


def write(out: Path, log: str, text: str) -> None:
    with ResultFolder("validate", out) as folder:
        folder.write("report.html", text)
        folder.write(f"logs/{log}/result.json", text)
        folder.replace({f"logs/{log}"})


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder with the results of one log; spaces and umlauts in its name."""
    folder = tmp_path / "Prüfung am Öhr"
    write(folder, "a log.mcap", "first")
    return folder


def test_results_of_another_log_replace_the_earlier_ones(out: Path) -> None:
    write(out, "b.mcap", "second")
    found = contents(out)
    listed = json.loads(found.pop("manifest.json"))["files"]
    assert found == {"report.html": "second", "logs/b.mcap/result.json": "second"}
    assert set(listed) == set(found)
    assert not (out / "logs" / "a log.mcap").exists()


@pytest.mark.parametrize("name", ["fawn.png", "logs/a log.mcap/notes.txt", "logs/mine/x", "log.mcap"])
def test_foreign_file_is_named_and_nothing_changes(out: Path, name: str) -> None:
    (out / name).parent.mkdir(exist_ok=True)
    (out / name).write_text("mine")
    before = contents(out)
    with pytest.raises(HeadlandError, match=name):
        ResultFolder("validate", out)
    assert contents(out) == before


def test_changed_result_and_links_are_refused(out: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "result.json").write_text("mine")
    (out / "report.html").write_text("with my notes")
    with pytest.raises(HeadlandError, match=r"report.html was changed after it was written"):
        ResultFolder("validate", out)
    (out / "report.html").unlink()
    (out / "report.html").symlink_to(elsewhere / "result.json")
    with pytest.raises(HeadlandError, match=r"report.html was changed"):
        ResultFolder("validate", out)
    (out / "report.html").unlink()
    (out / "logs" / "b").symlink_to(elsewhere)
    with pytest.raises(HeadlandError, match="logs/b"):
        ResultFolder("validate", out)
    assert (elsewhere / "result.json").read_text() == "mine"


def test_interrupted_run_leaves_the_earlier_results_and_its_own_for_the_next(out: Path) -> None:
    with ResultFolder("validate", out) as folder:
        folder.write("logs/b.mcap/result.json", "partial")
        folder.write("report.html", "partial")
    assert (out / "report.html").read_text() == "first"
    with ResultFolder("validate", out) as again:
        assert (again.new / "logs/b.mcap/result.json").read_text() == "partial"
        again.write("report.html", "complete")
        again.replace({"logs/b.mcap"})
    assert (out / "report.html").read_text() == "complete"
    assert (out / "logs/b.mcap/result.json").read_text() == "partial"


def test_interrupted_replacement_is_repaired(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Path.replace

    def fails_at_report(self: Path, to: Path) -> Path:
        if to.name == "report.html":
            raise OSError(5, "Input/output error")
        return real(self, to)

    with ResultFolder("validate", out) as folder:
        for name in ("command", "report.html", "logs/a log.mcap/result.json"):
            folder.write(name, "second")
        monkeypatch.setattr(Path, "replace", fails_at_report)
        with pytest.raises(HeadlandError, match="cannot be written"):
            folder.replace({"logs/a log.mcap"})
    monkeypatch.undo()
    assert contents(out)["report.html"] == "first"
    write(out, "a log.mcap", "third")
    assert {v for k, v in contents(out).items() if k != "manifest.json"} == {"third"}


def test_folder_without_manifest_is_refused_even_with_a_folder_of_our_name(tmp_path: Path) -> None:
    (tmp_path / ".incomplete").mkdir()
    (tmp_path / ".incomplete" / "photo.png").write_text("mine")
    with pytest.raises(HeadlandError, match=r"contains \.incomplete"):
        ResultFolder("validate", tmp_path)
    assert contents(tmp_path) == {".incomplete/photo.png": "mine"}


def test_second_run_in_the_same_folder_is_refused(out: Path) -> None:
    with ResultFolder("validate", out) as first:
        with pytest.raises(HeadlandError, match="another run is writing"):
            ResultFolder("validate", out)
        first.discard()
    assert contents(out)["report.html"] == "first"


@pytest.mark.skipif(os.geteuid() != 0, reason="mounts need root")
def test_full_disk_leaves_the_earlier_results(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(disk)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip("mounts are not permitted here")
    try:
        write(disk / "out", "a", "first")
        full = pytest.raises(HeadlandError, match="No space left on device")
        with ResultFolder("validate", disk / "out") as folder, full:
            folder.write("report.html", "x" * 1_000_000)
        assert (disk / "out" / "report.html").read_text() == "first"
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        with pytest.raises(HeadlandError, match="Read-only file system"):
            ResultFolder("validate", disk / "out")
        with pytest.raises(HeadlandError, match="Read-only file system"):
            ResultFolder("validate", disk / "new")
        assert (disk / "out" / "report.html").read_text() == "first"
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)
