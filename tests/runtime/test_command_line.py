"""Wrong arguments: one line that names the value, exit code 2, before the imports that take seconds."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from runtime.commands.options import COMMANDS, SITUATIONS, make_parser
from runtime.fault_injection import situations

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 1.0  # processor time
WRONG = {
    "run --seed -1": "--seed -1",
    "run --seed 1e3": "--seed 1e3",
    "run --duration nan": "--duration nan",
    "run --duration 0": "--duration 0",
    "run --mission nix": "'nix'",
    "run --machine nix": "'nix'",
    "run --bay nix": "'nix'",
    "run --scenario nix": "'nix'",
    "run --field /nix.geojson": "/nix.geojson: no such file",
    "run --model /nix.onnx": "/nix.onnx: no such file",
    "run --out FILE": "is a file, not a folder",
    "run --out FILLED": "contains notes.txt",
    "run --no-such-option": "--no-such-option",
    "live --world simulation --duration -5": "--duration -5",
    "live --world simulation --kill safety:KILL:nan": "'nan'",
    "coverage nix": "'nix'",
    "coverage tractor_e nix": "'nix'",
    "coverage tractor_e --out FILLED": "contains notes.txt",
    "shadow --bus nix": "--bus nix: loopback",
    "shadow --bus socketcan:nix": "socketcan:nix cannot be opened",
    "live --world simulation --bus nix:0": "--bus nix:0: loopback",
    "shadow --bus socketcan:nix --out FILLED": "contains notes.txt",
    "plan /nix.geojson": "/nix.geojson: no such file",
    "plan": "FIELD",
    "validate /nix.mcap": "/nix.mcap: does not exist",
    "validate FILE --jobs 0": "--jobs 0",
    "validate FILE --out FILLED": "contains notes.txt",
    "label /nix.mcap": "/nix.mcap: does not exist",
    "campaign hazards --only [": "--only [",
    "campaign demo --seeds 0": "--seeds 0",
    "campaign demo --out FILLED": "contains notes.txt",
    "campaign hazards --out FILLED": "contains notes.txt",
    "campaign fault-injection --out FILLED": "contains notes.txt",
    "campaign fault-injection --situations nix": "'nix'",
    "import /nix --out new.mcap": "/nix: does not exist",
    "import FILE --out FILE": "is not overwritten",
    "import FILE --out /nix/new.mcap": "the folder /nix does not exist",
    "animate /nix.mcap --out new.webp": "/nix.mcap: does not exist",
    "animate FILE --out FILE": "is not overwritten",
    "animate FILE --out new.webp --rate inf": "--rate inf",
    "inspect-log /nix.mcap": "/nix.mcap: does not exist",
    "nonsense": "'nonsense'",
    "run a\nb": "a\\nb",
}


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("places")
    (folder / "filled").mkdir()
    for name in ("file", "filled/notes.txt"):
        (folder / name).write_text("mine")
    return {"FILE": str(folder / "file"), "FILLED": str(folder / "filled")}


@pytest.mark.parametrize("line", WRONG)
def test_wrong_argument(line: str, places: dict[str, str]) -> None:
    words = [places.get(word, word) for word in line.split(" ")]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "runtime", *words], capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, cwd=Path(places["FILE"]).parent, check=False,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert WRONG[line] in done.stderr
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < LIMIT_S
    assert Path(places["FILE"]).read_text() == "mine"
    assert os.listdir(places["FILLED"]) == ["notes.txt"]


def test_help_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--help"], ["--version"], *([command.verb, "--help"] for command in COMMANDS)):
        with pytest.raises(SystemExit) as ended:
            make_parser().parse_args(words)
        assert ended.value.code == 0
    out = capsys.readouterr().out
    assert all(command.help in out for command in COMMANDS)
    assert "headland 0." in out


def test_situations_are_those_of_the_campaign() -> None:
    assert set(SITUATIONS) == {name for named in situations.SITUATIONS.values() for name in named}
