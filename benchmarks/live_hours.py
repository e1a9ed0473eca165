"""A live machine with the operator's page for hours: resident memory, log and its rotation (docs/hmi.md).

    ./headland benchmark live_hours [--hours 2] [--side-m 460] [--pause-s 600] [--out FOLDER]

A machine, one process per part as `live`, works a square field with the 6 m harrow; one page is open. This program is
its operator, by the key of the page: it starts, pauses and resumes each `--pause-s`, and confirms and resumes after a
stop. Each 10 s the resident memory of all processes is read. That of the machine is the sum over its processes, with
the rings, which all share, counted once. Growth, after the first 20 minutes, is the mean difference of two samples an
hour apart: the log keeps the index of the part that it writes, and begins a new part each hour. In a run of less than
80 minutes it is the slope of a line through the samples.
Exit code 1 if page or machine grow by more than 5 MB/h, the thinned log by more than 0.5 GB/h, or the machine was in
automatic operation for less than 80 % of the time.
"""

import argparse
import asyncio
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.page import Machine, Page, log_in, machine_in, memory_mb
from messages.command import Mode
from tests.hmi.planned import geojson, square_field

WARM_S, PERIOD_S = 1200.0, 10.0
MAX_MB_PER_H, MAX_GB_PER_H, LEAST_AUTOMATIC = 5.0, 0.5, 0.8
IMPLEMENT = "harrow_6m"


def size_mb(folder: Path, pattern: str) -> float:
    """Size of the files of a pattern."""
    return sum(path.stat().st_size for path in folder.glob(pattern)) / 1e6


def log_mb(folder: Path) -> dict[str, float]:
    """Thinned log of the drive and logs of its events."""
    return {"log_mb": size_mb(folder, "runs/2*/log*.mcap"), "events_mb": size_mb(folder, "runs/2*/events/*.mcap")}


def resident_mb(memory: list[list[float]]) -> float:
    """Resident memory of processes, each with three kinds as of `memory_mb`; what they share counts once."""
    return sum(own + files for own, files, _ in memory) + max(shared for *_, shared in memory)


def growth(samples: list[tuple[float, list[list[float]]]], process: slice) -> float:
    """Growth of processes in MB/h, after the warm-up."""
    late = [(seconds, memory) for seconds, memory in samples if seconds >= WARM_S]
    if len(late) < 3:
        return float("nan")
    hours = np.array([seconds for seconds, _ in late]) / 3600.0
    used = np.array([resident_mb(memory[process]) for _, memory in late])
    before = np.searchsorted(hours, hours - 1.0)
    has_before = hours - 1.0 >= hours[0]
    if has_before.any():
        return round(float((used - used[before])[has_before].mean()), 2)
    return round(float(np.polyfit(hours, used, 1)[0]), 2)


async def hours(machine: Machine, folder: Path, duration_s: float, pause_s: float) -> dict[str, object]:
    """Operates the machine; memory, log and share of automatic operation. Writes each sample to `memory.jsonl`."""
    page = Page()
    await page.open(machine, await log_in(machine))
    machine.reach(Mode.AUTOMATIC, "reset", "confirm_clear", "start")
    processes = [machine.process.pid, *machine.children]
    samples: list[tuple[float, list[list[float]]]] = []
    began_s = pause_from_s = time.monotonic()
    automatic, restarts, stops, mode_before = 0, 0, 0, machine.mode
    with (folder / "memory.jsonl").open("w") as file:
        while (elapsed_s := time.monotonic() - began_s) < duration_s and machine.process.poll() is None:
            until_s = began_s + (len(samples) + 1) * PERIOD_S
            while time.monotonic() < until_s:
                for _ in machine.records():
                    pass
                await asyncio.sleep(0.01)
                if machine.mode is not mode_before:
                    mode_before = machine.mode
                    stops += machine.mode in (Mode.OBSTACLE_STOP, Mode.FAULT_STOP, Mode.EMERGENCY_STOP)
            automatic += machine.mode is Mode.AUTOMATIC
            samples.append((elapsed_s, [memory_mb(pid) for pid in processes]))
            row = {"s": round(elapsed_s), "mode": str(machine.mode), "mb": samples[-1][1], "updates": page.updates}
            file.write(json.dumps(row | log_mb(folder)) + "\n")
            file.flush()
            if machine.mode is Mode.FINISHED:
                break
            if machine.mode is Mode.AUTOMATIC and time.monotonic() - pause_from_s > pause_s:
                machine.reach(Mode.STANDBY, "pause")
                machine.reach(Mode.AUTOMATIC, "confirm_clear", "resume")
                pause_from_s, restarts = time.monotonic(), restarts + 1
            elif machine.mode is not Mode.AUTOMATIC:
                for order in ("reset", "confirm_clear", "resume"):
                    machine.order(order)
                    await asyncio.sleep(0.3)
    await page.close()
    used = log_mb(folder)
    return {
        "hours": round(elapsed_s / 3600.0, 3), "automatic_share": round(automatic / len(samples), 3),
        "restarts": restarts, "stops": stops, "finished": machine.mode is Mode.FINISHED,
        "updates_hz": round(page.updates / elapsed_s, 2),
        "page_mb_per_h": growth(samples, slice(0, 1)), "machine_mb_per_h": growth(samples, slice(1, None)),
        "page_mb": round(resident_mb(samples[-1][1][:1])), "machine_mb": round(resident_mb(samples[-1][1][1:])),
        "log_gb_per_h": round(used["log_mb"] / 1e3 / (elapsed_s / 3600.0), 3), "events_mb": round(used["events_mb"], 1),
        "log_files": len(list(folder.glob("runs/2*/log*.mcap"))),
        "event_files": len(list(folder.glob("runs/2*/events/*.mcap"))),
    }  # fmt: skip


def main() -> int:
    """Prints one line of JSON."""
    parser = argparse.ArgumentParser(description="a live machine with the operator's page for hours")
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--side-m", type=float, default=460.0, help="of the square field")
    parser.add_argument("--pause-s", type=float, default=600.0, help="seconds between pauses")
    parser.add_argument("--out", type=Path, help="folder of the run (default: a new one)")
    arguments = parser.parse_args()
    folder = arguments.out or Path(tempfile.mkdtemp(prefix="live-"))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "field.geojson").write_bytes(geojson(square_field(arguments.side_m), "square"))
    given = ("--live", "--field", str(folder / "field.geojson"), "--implement", IMPLEMENT)
    with machine_in(folder, *given) as machine:
        result = asyncio.run(hours(machine, folder, arguments.hours * 3600.0, arguments.pause_s))
    print(json.dumps(result))
    growths = [float(result[f"{name}_mb_per_h"]) for name in ("page", "machine")]  # type: ignore[arg-type]
    is_right = all(one <= MAX_MB_PER_H for one in growths) and float(result["log_gb_per_h"]) <= MAX_GB_PER_H  # type: ignore[arg-type]
    return 0 if is_right and float(result["automatic_share"]) >= LEAST_AUTOMATIC else 1  # type: ignore[arg-type]


if __name__ == "__main__":
    sys.exit(main())
