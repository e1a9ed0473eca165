"""Each process of `headland live` killed and halted in turn, at full speed on a swath: does the machine stand in time?

    ./headland benchmark live_breaks [--times 10] [--only NAME] [--out FOLDER]

A row is good when the machine stands within its stopping distance (as `headland live --break` judges it), and when
the log can be read up to its last second. A drive that a busy computer has stopped before anything was broken says
nothing: it is told and driven again. Wants two cores of its own.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from configs.strict import find, load
from runtime.live.command import SIGNALS, Broken, drive
from runtime.live.config import ROLES
from runtime.run_folder import RunFolder
from runtime.setup import Setup, load_setup
from simulation.scenario import Scenario

ORDER_S, AT_S = 0.5, 11.0  # the start waits until all is ready; by then the machine drives at full speed
READABLE_S = 1.0
FAST_MPS, ATTEMPTS = 2.0, 5
FIELD = [[6.0, 51.5], [6.0022, 51.5], [6.0022, 51.5003], [6.0, 51.5003], [6.0, 51.5]]


def is_readable(result: dict[str, Any]) -> bool:
    """Whether the log goes on to a second before what ended it."""
    until_s: float = result["at_s"] if result["broken"] == "log" else result["until_s"]
    return bool(result["log_until_s"] >= until_s - READABLE_S)


def broken_drive(setup: Setup, scenario: Scenario, folder: Path, broken: Broken) -> dict[str, Any]:
    """The first drive in which the machine drove at full speed when the process was broken."""
    for attempt in range(ATTEMPTS):
        result = drive(setup, scenario, RunFolder("live", folder / str(attempt)), broken, None, 0)
        if "broken" in result and result["speed_mps"] > FAST_MPS:
            return result
        print(f"{folder.name}: not at full speed; {result['outcome']} ({', '.join(result['told'][-1:])})", flush=True)
    raise SystemExit(f"{ATTEMPTS} drives were stopped before {broken[0]} could be broken: this computer is too busy")


def main() -> None:
    """Print a line a run, and how many were good."""
    words = argparse.ArgumentParser(description="each process of the live stack killed and halted in turn")
    words.add_argument("--times", type=int, default=10, help="of each process and signal")
    words.add_argument("--only", choices=ROLES, help="this process alone")
    words.add_argument("--out", type=Path, help="folder for logs and rows (default: a new one)")
    arguments = words.parse_args()
    top = (arguments.out or Path(tempfile.mkdtemp(prefix="live-breaks-"))).absolute()
    top.mkdir(parents=True, exist_ok=True)
    field = top / "field.geojson"
    polygon = {"type": "Polygon", "coordinates": [FIELD]}
    feature = {"type": "Feature", "properties": {}, "geometry": polygon}
    field.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}), encoding="utf-8")
    setup, scenario = load_setup("demo", None, None, str(field), 1), load(Scenario, find("scenarios", "empty"))
    orders = tuple(order.model_copy(update={"at_s": ORDER_S}) for order in scenario.operator_commands)
    scenario = scenario.model_copy(update={"operator_commands": orders})
    roles = (arguments.only,) if arguments.only else ROLES
    good = 0
    trials = [(role, signal, k) for k in range(arguments.times) for role in roles for signal in SIGNALS]
    for role, signal, k in trials:
        result = broken_drive(setup, scenario, top / f"{role}-{signal}-{k}", (role, signal, AT_S))
        is_good = result["is_good"] and is_readable(result)
        good += is_good
        with (top / "rows.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"round": k, "is_good": is_good} | result) + "\n")
        travel = f"{result['travel_m']} of {result['allowed_m']} m, {result['reason']}"
        print(f"{role} {signal} {k}: {'good' if is_good else 'BAD'}; {travel}", flush=True)
    print(f"{good} of {len(trials)} good; {top}")


if __name__ == "__main__":
    main()
