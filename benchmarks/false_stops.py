"""False stops of field work without anybody near, by condition: hours, stops, and area worked against clear weather.

    ./headland benchmark false_stops [--seeds N] [--first-seed K] [--seconds S] [--only REGEX] [--jobs N] [--out FOLDER]

Each drive is the demo mission from the shed on, without encounters, with lidar scans by ray casting, and ends after
--seconds. Nobody is on the site: every stop is a false one. `conditions` are those of configs/hazards.yaml and those
below. Rows of single drives are appended to FOLDER/rows.jsonl, and a second call continues; the folder of a drive with
a stop is kept. The bound is one-sided, 95 %, of a Poisson process: (0.5 · χ² quantile) / hours.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import yaml
from scipy.stats import chi2

from benchmarks.rows import append_row, rows_of
from configs.strict import CONFIGS, find, read_yaml

CONSENT = {"by": "benchmark false_stops", "vegetation_m": 0.35}
OUTSIDE = ("grass 60 cm",)  # of the operational design domain
MORE = {
    "crop 20 cm": {"vegetation": [{"kind": "crop", "height_m": 0.20}]},
    "fog 100 m": {"fog": {"visibility_m": 100.0}},
    "crest": read_yaml(find("scenarios", "environments/crest"))["environment"],
    "trees and hedge": {"boundary": {"hedge_height_m": 1.5, "trees": 40}},
    "neighbour machine": {"neighbour": {}},
}


@dataclass(frozen=True)
class Row:
    """Result of one drive; `stops` are time (s) and cause."""

    condition: str
    seed: int
    simulated_s: float
    distance_m: float
    worked_m2: float
    contacts: int
    stops: list[tuple[float, str]]


def conditions() -> dict[str, dict[str, object]]:
    """Environments by name."""
    named = read_yaml(CONFIGS / "hazards.yaml")["environments"]
    return {name: value for name, value in {**named, **MORE}.items() if name not in OUTSIDE}


def drive(condition: str, environment: dict[str, object], seed: int, seconds: float, out: Path) -> Row:
    """One drive in a process of its own."""
    folder = out / f"{condition.replace(' ', '-')}-{seed}"
    shutil.rmtree(folder, ignore_errors=True)
    mission = read_yaml(find("missions", "demo")) | {"consent": CONSENT}
    scenario = read_yaml(find("scenarios", "empty")) | ({"environment": environment} if environment else {})
    files = {"mission": mission, "scenario": scenario}
    for name, content in files.items():
        (out / f"{folder.name}.{name}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    command = [sys.executable, "-m", "runtime", "run", "--seed", str(seed), "--duration", str(seconds), "--cores", "1"]
    command += [f"--{name}={out / f'{folder.name}.{name}.yaml'}" for name in files]
    done = subprocess.run([*command, "--json", "--out", folder], capture_output=True, text=True, check=False)
    if not done.stdout:
        raise SystemExit(f"{condition}, seed {seed}: exit status {done.returncode}\n{done.stderr[-2000:]}")
    found = json.loads(done.stdout)
    row = Row(
        condition, seed, found["simulated_s"], found["distance_m"], found["worked_m2"], found["contacts"],
        [(stop["t_s"], stop["cause"]) for stop in found["stops"]],
    )  # fmt: skip
    if not row.stops:
        shutil.rmtree(folder)
    return row


def table(rows: list[Row]) -> str:
    """Markdown table by condition, and the total."""
    clear = [r for r in rows if r.condition == "as configured"]
    clear_m2 = sum(r.worked_m2 for r in clear) / len(clear) if clear else float("nan")
    lines = [
        "| condition | drives | hours | stops | area worked against clear weather | causes |",
        "|---|---|---|---|---|---|",
    ]
    for name in conditions():
        own = [r for r in rows if r.condition == name]
        if own:
            share = sum(r.worked_m2 for r in own) / len(own) / clear_m2
            causes = " ".join(f"{r.seed}: {cause} {t_s:.0f} s;" for r in own for t_s, cause in r.stops)
            lines.append(
                f"| {name} | {len(own)} | {_hours(own):.2f} | {sum(len(r.stops) for r in own)} | {100.0 * share:.0f} % "
                f"| {causes or '—'} |"
            )
    count, hours = sum(len(r.stops) for r in rows), _hours(rows)
    bound = 0.5 * float(chi2.ppf(0.95, 2 * count + 2)) / hours if hours else float("inf")
    contacts = sum(r.contacts for r in rows)
    lines.append(f"\nTotal: {hours:.2f} h, {count} stops, at most {bound:.2f} per hour (95 %), {contacts} contacts")
    return "\n".join(lines)


def _hours(rows: list[Row]) -> float:
    return sum(r.simulated_s for r in rows) / 3600.0


def main() -> None:
    """Drives what is missing and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=400.0)
    parser.add_argument("--only", type=re.compile, default=re.compile(""))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/false_stops"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "rows.jsonl"
    rows = rows_of(file, Row)
    done = {(r.condition, r.seed) for r in rows}
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    todo = [
        (name, environment, seed)
        for seed in seeds for name, environment in conditions().items()
        if arguments.only.search(name) and (name, seed) not in done
    ]  # fmt: skip
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for row in pool.map(
            lambda one: drive(one[0], one[1], one[2], arguments.seconds, arguments.out.resolve()), todo
        ):
            rows.append(row)
            append_row(file, row)
            print(
                f"[{len(rows) - len(done)}/{len(todo)}] {row.condition}, seed {row.seed}: {row.stops or 'no stop'}",
                flush=True,
            )
    print(table(rows))


if __name__ == "__main__":
    main()
