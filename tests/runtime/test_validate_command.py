"""Command line of `validate`: exit codes, headline, and errors that come before any work and change nothing."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from messages.errors import HeadlandError
from runtime.commands.options import make_parser
from runtime.commands.validate import main
from tests.recordings import ROOT
from tests.replay.recorded_drive import drive, vehicle_file
from validation.obstacle_stop.headline import headline
from validation.obstacle_stop.ranges import rate_bounds, share_bounds


def run(*words: object) -> int:
    return main(make_parser().parse_args(["validate", *map(str, words)]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of a drive towards a person (`in time.mcap`), and of one without truth."""
    top = tmp_path_factory.mktemp("höfe und felder")
    vehicle_file(top)
    drive(top / "in time.mcap", (20.0, 0.3), seconds=2.0)
    drive(top / "none.mcap", None, seconds=2.5, has_truth=False)
    return top


def result_of(text: str) -> dict:
    return json.loads(text)


def test_passed_log_states_the_bound(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out put"
    code = run(folder / "in time.mcap", "--vehicle", folder / "car.yaml", "--out", out, "--json", "--jobs", "1")
    result = result_of(capsys.readouterr().out)
    assert (code, result["state"]) == (0, "passed")
    assert result["headline"].startswith("0 of 1 encounters missed: at most 97.5 % (95 %); 0 false stops in ")
    assert result["headline"] in (out / "report.html").read_text()
    assert run(folder / "in time.mcap", "--vehicle", folder / "car.yaml", "--out", out) == 0
    assert capsys.readouterr().out.startswith(result["headline"])


def test_not_shown_is_three_with_the_reason_first(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = run(folder / "none.mcap", "--vehicle", folder / "car.yaml", "--out", tmp_path / "out", "--jobs", "1")
    assert code == 3
    assert capsys.readouterr().out.startswith("not shown: no ground truth; missed encounters: not shown;")


def test_unreadable_log_is_two_and_keeps_earlier_results(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad, out = tmp_path / "bad.mcap", tmp_path / "out"
    bad.write_bytes(b"not a log")
    with pytest.raises(HeadlandError, match=r"bad\.mcap"):
        run(bad, "--out", out, "--jobs", "1")
    assert not out.exists()
    words = ("--vehicle", folder / "car.yaml", "--out", out, "--json", "--jobs", "1")
    assert run(folder / "none.mcap", bad, *words) == 2
    result = result_of(capsys.readouterr().out)
    assert result["state"] == "not_shown"
    assert [one["log"] for one in result["not_shown"]] == ["bad.mcap", ""]
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    with pytest.raises(HeadlandError, match=r"bad\.mcap"):
        run(bad, "--out", out, "--jobs", "1")
    assert {p: p.read_bytes() for p in out.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["missing.mcap"], "missing.mcap: does not exist"),
        (["dangling.mcap"], "dangling.mcap: the link target nowhere does not exist"),
        (["none.mcap", "--jobs", "0"], "--jobs 0: must be a whole number from 1"),
        (["none.mcap", "again.mcap"], "again.mcap: the same log as "),
        (["none.mcap", "--vehicle", "no.yaml"], "--vehicle no.yaml: does not exist"),
        (["none.mcap", "--conditions", "."], "--conditions .: is a folder, a file is needed"),
        (["none.mcap", "--truth", "no.jsonl"], "--truth no.jsonl: does not exist"),
        (["none.mcap", "in time.mcap", "--truth", "t.jsonl"], "--truth t.jsonl: a file belongs to one log"),
    ],
)
def test_wrong_arguments_at_once(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    words: list[str], message: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dangling.mcap").symlink_to("nowhere")
    for name in ("none.mcap", "in time.mcap"):
        (tmp_path / name).symlink_to(folder / name)
    (tmp_path / "again.mcap").symlink_to("none.mcap")
    (tmp_path / "t.jsonl").write_text("")
    with pytest.raises((HeadlandError, SystemExit)) as error:
        run(*words, "--out", "out")
    assert message in f"{error.value}{capsys.readouterr().err}"
    assert not (tmp_path / "out").exists()


def test_missing_file_needs_no_slow_import() -> None:
    code = (
        "import sys; sys.argv = ['headland', 'validate', '/missing.mcap']; from runtime.__main__ import main\n"
        "try: main()\n"
        "except SystemExit as e: sys.exit(9 if {'numpy', 'pydantic', 'scipy'} & sys.modules.keys() else e.code)"
    )
    start = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2
    assert done.stderr == "headland validate: LOG /missing.mcap: does not exist; see ./headland validate --help\n"
    assert time.monotonic() - start < 5.0


def test_two_logs_with_one_name(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "x.mcap").write_bytes((folder / "none.mcap").read_bytes())
    words = ("--vehicle", folder / "car.yaml", "--out", tmp_path / "out", "--json", "--jobs", "1")
    run(tmp_path / "a" / "x.mcap", tmp_path / "b" / "x.mcap", *words)
    assert result_of(capsys.readouterr().out)["logs"] == 2
    assert {p.name for p in (tmp_path / "out" / "logs").iterdir()} == {"x.mcap", "x.mcap-2"}


def test_help_lists_the_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        make_parser().parse_args(["validate", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "0 passed, 1 failed, 2 bad input (a log could not be read), 3 not shown" in text


def result(state: str, missed: int, of: int, not_shown: tuple[str, ...] = (), late: int = 0) -> dict:
    low, high = share_bounds(missed, of)
    rate_low, rate_high = rate_bounds(0, 2.0)
    return {
        "state": state, "missed_share": {"count": missed, "of": of, "low": low, "high": high},
        "false_stops_per_hour": {"count": 0, "hours": 2.0, "low": rate_low, "high": rate_high},
        "not_shown": [{"log": "x", "reason": reason} for reason in not_shown], "outcomes": {"late": late},
        "violations": [],
    }  # fmt: skip


def test_headline_texts() -> None:
    bound = "0 of 3 encounters missed: at most 70.8 % (95 %); 0 false stops in 2 h: at most 1.84 per hour (95 %)"
    assert headline(result("passed", 0, 3)) == bound
    assert headline(result("not_shown", 0, 3, ("standstill", "other"))) == (
        f"not shown: x: standstill (2 reasons); {bound}"
    )
    assert headline(result("failed", 1, 3, late=2)).startswith(
        "failed: 2 late; 1 of 3 encounters missed: at most 90.6 %"
    )
