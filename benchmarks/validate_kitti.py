"""Evaluation of many logs: excerpts of KITTI and invalid logs, on processes and on a local Dask cluster.

    ./headland benchmark validate_kitti [--logs 100] [--frames 6] [--demo LOG.mcap]

Prints the results of the first forty KITTI frames, the time for the logs, and whether both give the same table. With a
demo log every fourth log is an excerpt of it around its first obstacle stop.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.recordings import DATA
from datasets.importers.excerpt import excerpt
from datasets.importers.formats import open_recording
from datasets.importers.recording import Recording
from datasets.importers.write_recording import write_recording
from datasets.reader import read_log
from messages.command import Mode, SupervisorState
from runtime.stack import load_stack

ROOT = Path(__file__).resolve().parent.parent
LOG, TRUTH = DATA / "kitti-seq-pcd", DATA / "kitti-tracking-truth"


def validate(logs: list[Path], *words: str) -> tuple[dict[str, Any], float]:
    """Object of `--json`, and duration (s)."""
    start = time.monotonic()
    command = [sys.executable, "-m", "runtime", "validate", *map(str, logs), "--truth", str(TRUTH), "--json", *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    if not done.stdout:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout), time.monotonic() - start


def imported(recording: Recording, out: Path) -> Path:
    """A recording as a Headland log."""
    stack = load_stack().datasets
    write_recording(recording, out, stack.log, stack.viewer)
    return out


def demo_excerpts(folder: Path, demo: Path, count: int, seconds: float) -> list[Path]:
    """Excerpts of a demo log, from 8 s before its first obstacle stop."""
    states = [e for e in read_log(demo, {"supervisor"}) if isinstance(e.message, SupervisorState)]
    stop_ns = next(e.receive_ns for e in states if getattr(e.message, "mode", None) is Mode.OBSTACLE_STOP)
    begin_s = max(0.0, (stop_ns - states[0].receive_ns) * 1e-9 - 8.0)
    end_s = begin_s + 0.5 * count + seconds
    near = open_recording(imported(excerpt(open_recording(demo), begin_s, end_s), folder / "near.mcap"))
    times = [0.5 * k for k in range(count)]
    return [imported(excerpt(near, t, t + seconds), folder / f"demo-{k:03d}.mcap") for k, t in enumerate(times)]


def excerpts(folder: Path, count: int, frames: int, demo: Path | None) -> list[Path]:
    """Excerpts of KITTI as folders of links, and of the demo; the last three logs are invalid."""
    out = demo_excerpts(folder, demo, count // 4, 0.1 * frames + 0.5) if demo is not None else []
    for k in range(count - 3 - len(out)):
        path = folder / f"cut-{k:03d}"
        (path / "frames").mkdir(parents=True)
        for number in range(k % (40 - frames), k % (40 - frames) + frames):
            (path / "frames" / f"{number:06d}.npz").symlink_to(LOG / "frames" / f"{number:06d}.npz")
        out.append(path)
    complete = imported(open_recording(out[-1]), folder / "complete.mcap").read_bytes()
    (folder / "truncated.mcap").write_bytes(complete[: len(complete) // 2])
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "nolidar.log").write_text("(1.000000) can0 123#0011\n")
    return [*out, folder / "truncated.mcap", folder / "empty.mcap", folder / "nolidar.log"]


def table(result: dict[str, Any]) -> dict[str, Any]:
    """Result without the run folder."""
    return {k: v for k, v in result.items() if k != "run_dir"}


def main() -> None:
    """Prints the results."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--demo", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        one, wall_s = validate([LOG], "--out", str(folder / "one"))
        print(f"40 frames (3.9 s of driving) in {wall_s:.1f} s: {one['state']}")
        for e in one["encounters"]:
            keys = ("role", "outcome", "entry_s", "clearance_m", "stopping_distance_m", "margin_m", "request_delay_s")
            print({k: e[k] for k in keys})
        print({k: one[k] for k in ("missed", "false_stops", "safe_speed_kmh")})
        logs = excerpts(folder, arguments.logs, arguments.frames, arguments.demo)
        mine, wall_s = validate(logs, "--jobs", "2", "--out", str(folder / "processes"))
        print(f"{len(logs)} logs on 2 processes in {wall_s:.0f} s; failed to read: {mine['failed_to_read']}")
        print(f"damaged: {mine['damaged']}")
        from distributed import LocalCluster

        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:  # type: ignore[no-untyped-call]
            theirs, wall_s = validate(logs, "--scheduler", cluster.scheduler_address, "--out", str(folder / "cluster"))
        print(f"{len(logs)} logs on a cluster of 2 in {wall_s:.0f} s; same table: {table(mine) == table(theirs)}")


if __name__ == "__main__":
    main()
