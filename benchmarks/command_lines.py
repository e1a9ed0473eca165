"""Fuzzed command lines: no traceback; a wrong one is one line with exit code 2 within a second of processor time.

    ./headland benchmark command_lines [--count 500] [--seed 1]

Words are drawn from the verbs, their options, plausible and hostile values. A command line that is accepted is stopped
after some seconds of processor time. Exit code 1 if one failed.
"""

import argparse
import os
import resource
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from runtime.commands.options import COMMANDS, Command
from runtime.run_folder import ROOT

LIMIT_S = 1.0
STOP_S = 4  # processor time after which an accepted command is stopped
KILLED = (-9, -24)
VALUES = (
    "", "-1", "0", "1", "7", "1e3", "nan", "inf", "-inf", "1e400", "99999999999999999999", "x", "ü", "\n", "\x1b[31m",
    "%s", "{}", "../..", "/", "/dev/null", "/dev/full", "/proc/self/mem", ".", "FILE", "FOLDER", "LOG", "a" * 300,
    "a" * 5000, "demo", "line", "dock", "empty", "wide", "hazards", "fault-injection", "simulation", "safety:KILL:1",
    "[", "(?P<", "1,2,3", "0:1,2", "--", "-", "--json", "--help", "-h", "=", "null", "~", "*", "'", '"', "$(true)",
)  # fmt: skip


def main() -> int:
    """Prints what failed, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    counts = {"refused": 0, "accepted": 0, "failed": 0}
    random = np.random.default_rng(arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        places = _places(Path(folder))
        for _ in range(arguments.count):
            words = [places.get(word, word) for word in line(random)]
            failure, kind = run(words, Path(folder))
            counts[kind] += 1
            if failure:
                print(f"{shlex.join(words)[:300]}: {failure}", flush=True)
    print(", ".join(f"{count} {kind}" for kind, count in counts.items()))
    return 1 if counts["failed"] else 0


def _places(folder: Path) -> dict[str, str]:
    (folder / "file").write_text("mine")
    (folder / "folder").mkdir()
    (folder / "folder" / "notes.txt").write_text("mine")
    (folder / "log.mcap").write_bytes(b"\x89MCAP0\r\n")
    return {"FILE": str(folder / "file"), "FOLDER": str(folder / "folder"), "LOG": str(folder / "log.mcap")}


def line(random: np.random.Generator) -> list[str]:
    """A command line: a verb, its positional arguments and some options, each right or wrong."""

    def pick(values: Any) -> Any:
        return values[int(random.integers(len(values)))]

    if random.random() < 0.1:
        return [str(pick(VALUES)) for _ in range(int(random.integers(0, 4)))]
    command: Command = pick(COMMANDS)
    words = [command.verb]
    for option in command.options:
        name, settings = option.names[0], option.settings
        is_positional, is_required = not name.startswith("-"), settings.get("required", False)
        if random.random() > (0.9 if is_positional or is_required else 0.3):
            continue
        words += [] if is_positional else [name]
        if settings.get("action") != "store_true":
            values = settings.get("choices") if random.random() < 0.5 else None
            words.append(str(pick(values or VALUES)))
    if random.random() < 0.2:
        words.insert(int(random.integers(len(words) + 1)), str(pick(VALUES)))
    return words


def run(words: list[str], folder: Path) -> tuple[str, str]:
    """What is wrong with the reaction to a command line, and its kind."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "runtime", *words], cwd=folder, capture_output=True, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (STOP_S, STOP_S)),
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    text = done.stderr.decode(errors="replace")
    if "Traceback" in text:
        return text[-600:], "failed"
    if (folder / "file").read_text() != "mine" or os.listdir(folder / "folder") != ["notes.txt"]:
        return "a file of the user changed", "failed"
    if done.returncode == 2:
        wrong = f"{cpu_s:.1f} s of processor time" if cpu_s > LIMIT_S else ""
        wrong = wrong or (f"{len(text.splitlines())} lines: {text[-300:]}" if len(text.splitlines()) != 1 else "")
        return wrong, "failed" if wrong else "refused"
    is_known = done.returncode in (0, 1, 3, *KILLED)
    return "" if is_known else f"exit code {done.returncode}: {text[-300:]}", "accepted" if is_known else "failed"


if __name__ == "__main__":
    sys.exit(main())
