"""Kills each writing verb at random moments (kill -9), or fills its disk: what was there and what was written remains.

    ./headland benchmark kills [--times 100] [--verbs run,plan] [--full-disk] [--seed 1] [--out FOLDER]

A trial passes if no file of the user changed or vanished, every log is readable, and no process of the command is left;
after every tenth kill the same command must also run to its end in the same folder. With --full-disk (needs root, or
user namespaces: `unshare -rm ./headland benchmark kills --full-disk`) the command works on a disk of 160 MB that is
filled at the moment, and must end by itself without a traceback. Rows are appended to `rows.jsonl`; the same command
with --out continues. Exit code 1 if a trial failed.
"""

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datasets.reader import LogScan
from messages.errors import LogError
from runtime.run_folder import ROOT

GROUP = "239.74.163.2"
FIELD = [[6.0, 51.5], [6.0011, 51.5], [6.0011, 51.5006], [6.0, 51.5006], [6.0, 51.5]]
COMPLETE_EVERY = 10
DISK_MB = 160
WAIT_S = 1800.0
NOT_A_CRASH = (0, 1, 2, 3)


@dataclass(frozen=True)
class Verb:
    """A command line; `{top}` is the folder of the inputs, `{out}` what the command writes, `main` its main file."""

    line: str
    main: str
    out: str = "out"

    def words(self, top: Path, out: Path) -> list[str]:
        """Words of the command line."""
        return [word.format(top=top, out=out) for word in self.line.split()]


VERBS = {
    "run": Verb("run --mission line --duration 5 --out {out}", "log.mcap"),
    "plan": Verb("plan {top}/field.geojson --out {out}", "plan.png"),
    "live": Verb("live --world simulation --mission line --duration 3 --out {out}", "log.mcap"),
    "shadow": Verb(f"shadow --bus loopback:{GROUP}:42999 --duration 2 --out {{out}}", "log.mcap"),
    "validate": Verb("validate {top}/drive/log.mcap --out {out}", "replay.mcap"),
    "campaign": Verb("campaign hazards --only ^adult_before_wing-1$ --jobs 1 --out {out}", "log.mcap"),
    "import": Verb("import {top}/drive/log.mcap --out {out}", "out.mcap*", "out.mcap"),
    "animate": Verb("animate {top}/drive/log.mcap --duration 4 --out {out}", "out.webp*", "out.webp"),
}


def main() -> int:
    """Prints one line per trial and the number of passed ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--verbs", default=",".join(VERBS))
    parser.add_argument("--full-disk", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    top = (arguments.out or Path(tempfile.mkdtemp(prefix="kills-"))).absolute()
    top.mkdir(parents=True, exist_ok=True)
    make_inputs(top)
    rows = top / "rows.jsonl"
    found = [json.loads(line) for line in rows.read_text().splitlines()] if rows.is_file() else []
    done = {(row["how"], row["verb"], row["trial"]): row for row in found}
    how = "full disk" if arguments.full_disk else "kill"
    passed = total = 0
    for name in arguments.verbs.split(","):
        random = np.random.default_rng([arguments.seed, *name.encode()])
        moments = random.uniform(size=arguments.times)
        for trial, moment in enumerate(moments):
            row = done.get((how, name, trial)) or {"how": how, "verb": name, "trial": trial}
            if "failure" not in row:
                row |= one_trial(name, top, float(moment), trial, arguments.full_disk)
                with rows.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print(f"{name} {trial}: {how} after {row['after_s']:.1f} s: {row['failure'] or 'passed'}", flush=True)
            passed, total = passed + (not row["failure"]), total + 1
    print(f"{passed} of {total} passed; {top}")
    return 0 if passed == total else 1


def make_inputs(top: Path) -> None:
    """A field, a drive, and the duration of each verb are made once."""
    polygon = {"type": "Polygon", "coordinates": [FIELD]}
    feature = {"type": "Feature", "properties": {}, "geometry": polygon}
    (top / "field.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    if not (top / "drive" / "result.jsonl").is_file():
        words = VERBS["run"].words(top, top / "drive")
        subprocess.run([sys.executable, "-m", "runtime", *words], check=False, cwd=ROOT, capture_output=True)


def duration_s(name: str, top: Path) -> float:
    """Wall time of an undisturbed run of a verb, measured once."""
    path = top / "durations.json"
    known: dict[str, float] = json.loads(path.read_text()) if path.is_file() else {}
    if name not in known:
        with tempfile.TemporaryDirectory(dir=top) as folder:
            began_s = time.monotonic()
            process = start(VERBS[name].words(top, Path(folder) / VERBS[name].out), Path(folder))
            process.communicate(timeout=WAIT_S)
            known[name] = time.monotonic() - began_s
        path.write_text(json.dumps(known))
    return known[name]


def one_trial(name: str, top: Path, moment: float, trial: int, is_full_disk: bool) -> dict[str, Any]:
    """One disturbed run: time of the disturbance and what failed ("" for nothing)."""
    after_s = moment * duration_s(name, top)
    if is_full_disk:
        with disk(top / f"disk-{name}") as folder:
            return {"after_s": after_s, "failure": fill(name, top, folder, after_s)}

    def wait(process: subprocess.Popen[str], folder: Path) -> None:
        with suppress(subprocess.TimeoutExpired):
            process.wait(after_s)

    folder = top / name / str(trial // COMPLETE_EVERY)
    return {"after_s": after_s, "failure": kill(name, top, folder, wait, trial % COMPLETE_EVERY == COMPLETE_EVERY - 1)}


def kill(
    name: str, top: Path, folder: Path, wait: Callable[[subprocess.Popen[str], Path], None], is_run_again: bool
) -> str:
    """Runs a verb in `folder` and kills it when `wait` returns; what failed ("" for nothing)."""
    out = folder / VERBS[name].out
    if not folder.is_dir():
        folder.mkdir(parents=True)
        (folder / "mine.txt").write_text("mine")
        (folder / "out.1.png").write_text("mine")
    before = users_files(folder, out)
    process = start(VERBS[name].words(top, out), folder)
    wait(process, folder)
    was_over = process.poll() is not None
    process.kill()
    text = process.communicate()[1]
    failures = [f"ended with {process.returncode}: {text[-300:]}"] if was_over and is_crash(process, out) else []
    failures += remaining(process.pid) + changed(before, folder) + unreadable(folder)
    if name != "validate" and (out / "manifest.json").is_file():  # validate accepts only its own files
        (out / "notes.txt").write_text("mine")
    if is_run_again:
        again = start(VERBS[name].words(top, out), folder)
        text = again.communicate(timeout=WAIT_S)[1]
        is_done = again.returncode in (0, 1, 3) or "is complete" in text or "exists and is not overwritten" in text
        failures += [] if is_done else [f"again: ended with {again.returncode}: {text[-300:]}"]
        failures += changed(before, folder) + unreadable(folder)
    return "; ".join(failures)


def start(words: list[str], folder: Path) -> subprocess.Popen[str]:
    """Starts a headland command with `runs/` in a folder."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", "runtime", *words]
    return subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip


def is_crash(process: subprocess.Popen[str], out: Path) -> bool:
    """Whether a command that was not disturbed failed; a complete one is refused."""
    return process.returncode not in (0, 1, 3) and not (process.returncode == 2 and out.exists())


def users_files(folder: Path, out: Path) -> dict[Path, str]:
    """SHA-256 of all files of the user."""
    own = [p for p in folder.rglob("*") if p.is_file() and (p.name == "notes.txt" or out not in (p, *p.parents))]
    return {p: hashlib.sha256(p.read_bytes()).hexdigest() for p in own if ".incomplete" not in str(p)}


def changed(before: dict[Path, str], folder: Path) -> list[str]:
    """Files of the user that changed or vanished."""
    now = {p: hashlib.sha256(p.read_bytes()).hexdigest() for p in before if p.is_file()}
    return [f"{p.relative_to(folder)} of the user changed" for p in before if now.get(p) != before[p]]


def unreadable(folder: Path) -> list[str]:
    """Logs that cannot be read; a log that was just begun may be empty."""
    failures = []
    for path in (one for one in folder.rglob("*.mcap") if one.is_file()):
        try:
            scan = LogScan(path)
            sum(1 for _ in scan)
            failures += [f"{path.name}: {d.reason} in its middle" for d in scan.damages if not d.is_end]
        except LogError as error:
            failures += [] if "is empty" in str(error) else [str(error)]
    return failures


def remaining(session: int, wait_s: float = 15.0) -> list[str]:
    """Processes of the command that live on after it."""
    until_s = time.monotonic() + wait_s
    while (left := _of_session(session)) and time.monotonic() < until_s:
        time.sleep(0.2)
    for pid in left:
        with suppress(OSError):
            os.kill(pid, signal.SIGKILL)
    return [f"{len(left)} processes are left"] if left else []


def _of_session(session: int) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with suppress(OSError, IndexError):
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                if int(fields[3]) == session and fields[0] != "Z":
                    found.append(int(entry.name))
    return found


@contextmanager
def disk(folder: Path) -> Iterator[Path]:
    """A small disk of its own in memory."""
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"--full-disk needs a mount: {done.stderr.strip()}; use unshare -rm")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(name: str, top: Path, folder: Path, after_s: float) -> str:
    """Fills the disk at the moment; the command ends by itself and what it wrote is readable."""
    out = folder / VERBS[name].out
    (folder / "mine.txt").write_text("mine")
    before = users_files(folder, out)
    process = start(VERBS[name].words(top, out), top)
    with suppress(subprocess.TimeoutExpired):
        process.wait(after_s)
    with (folder / "filler").open("wb", buffering=0) as file, suppress(OSError):
        for size in (1 << 20, 1 << 12):
            with suppress(OSError):
                while file.write(b"x" * size) == size:
                    pass
    text = process.communicate(timeout=WAIT_S)[1]
    failures = [] if process.returncode in NOT_A_CRASH else [f"ended with {process.returncode}"]
    failures += [f"a traceback: {text[-400:]}"] if "Traceback" in text else []
    return "; ".join(failures + remaining(process.pid) + changed(before, folder) + unreadable(folder))


if __name__ == "__main__":
    sys.exit(main())
