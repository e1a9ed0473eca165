"""Kills and halts each process of `headland live` in turn at full speed on a swath, and evaluates the stop.

    ./headland benchmark live_breaks [--times 10] [--only NAME] [--out FOLDER]

A row passes if the machine stops within its stopping distance (as `headland live --kill` evaluates it) and the log is
readable up to its last second. A drive that stopped before the kill, on a busy computer, is reported and repeated.
Needs two free cores.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from configs.strict import find, load
from runtime.commands.live import ProcessKill
from runtime.live.command import SIGNALS, drive
from runtime.live.config import ROLES
from runtime.run_folder import RunFolder
from runtime.setup import Setup, load_setup
from simulation.scenario import Scenario

START_S, KILL_S = 0.5, 11.0  # start command; time at which the machine drives at full speed
READABLE_S = 1.0
FAST_MPS, ATTEMPTS = 2.0, 5
FIELD = [[6.0, 51.5], [6.0022, 51.5], [6.0022, 51.5003], [6.0, 51.5003], [6.0, 51.5]]


def is_readable(result: dict[str, Any]) -> bool:
    """Whether the log is readable up to a second before its end."""
    until_s: float = result["at_s"] if result["killed"] == "log" else result["until_s"]
    return bool(result["log_until_s"] >= until_s - READABLE_S)


def drive_with_kill(setup: Setup, scenario: Scenario, folder: Path, kill: ProcessKill) -> dict[str, Any]:
    """First drive in which the machine was at full speed at the kill."""
    for attempt in range(ATTEMPTS):
        with RunFolder("live", folder / str(attempt)) as run_folder:
            result = drive(setup, scenario, run_folder, kill, None, 0)
        if "killed" in result and result["speed_mps"] > FAST_MPS:
            return result
        print(f"{folder.name}: not at full speed; {result['outcome']} ({', '.join(result['alarms'][-1:])})", flush=True)
    raise SystemExit(f"{ATTEMPTS} drives stopped before the kill of {kill[0]}: this computer is too busy")


def main() -> None:
    """Prints one line per run and the number of passed runs."""
    parser = argparse.ArgumentParser(description="kills and halts each process of the live stack in turn")
    parser.add_argument("--times", type=int, default=10, help="number of runs per process and signal")
    parser.add_argument("--only", choices=ROLES, help="this process only")
    parser.add_argument("--out", type=Path, help="folder for logs and rows (default: a new one)")
    arguments = parser.parse_args()
    top = (arguments.out or Path(tempfile.mkdtemp(prefix="live-breaks-"))).absolute()
    top.mkdir(parents=True, exist_ok=True)
    field = top / "field.geojson"
    polygon = {"type": "Polygon", "coordinates": [FIELD]}
    feature = {"type": "Feature", "properties": {}, "geometry": polygon}
    field.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}), encoding="utf-8")
    setup, scenario = load_setup("demo", None, None, str(field), 1), load(Scenario, find("scenarios", "empty"))
    commands = tuple(command.model_copy(update={"at_s": START_S}) for command in scenario.operator_commands)
    scenario = scenario.model_copy(update={"operator_commands": commands})
    roles = (arguments.only,) if arguments.only else ROLES
    passed_count = 0
    trials = [(role, signal, k) for k in range(arguments.times) for role in roles for signal in SIGNALS]
    for role, signal, k in trials:
        result = drive_with_kill(setup, scenario, top / f"{role}-{signal}-{k}", (role, signal, KILL_S))
        passed = result["passed"] and is_readable(result)
        passed_count += passed
        with (top / "rows.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"round": k} | result | {"passed": passed}) + "\n")
        travel = f"{result['travel_m']} of {result['allowed_m']} m, {result['reason']}"
        print(f"{role} {signal} {k}: {'passed' if passed else 'FAILED'}; {travel}", flush=True)
    print(f"{passed_count} of {len(trials)} passed; {top}")


if __name__ == "__main__":
    main()
