"""`headland campaign`: runs many seeds in parallel, resumable, and writes one table."""

import argparse
import json
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from messages.errors import HeadlandError
from runtime.processes import run_headland, terminate_children
from runtime.run_folder import ROOT, RunFolder, named_errors
from validation.html import render_page

COLUMNS = (
    "trial", "outcome", "simulated_s", "wall_s", "distance_m", "planned_share", "coverage", "xte_sigma_m", "xte_max_m",
    "stops", "false_stops", "contacts", "zone_exits", "dock_error_m", "dock_error_deg",
)  # fmt: skip
BAYS = ("wide", "narrow")
REFUSED = 2  # exit code of a run that did not start
DONE = ("finished", "docked")
DEFAULT_SEEDS = {"hazards": 1}


@dataclass(frozen=True)
class Trial:
    """One run of the campaign: its folder, the arguments of `run`, and whether `run` may refuse."""

    name: str
    folder: Path
    arguments: tuple[str, ...]
    may_refuse: bool = False

    @property
    def result(self) -> dict[str, Any] | None:
        """Object of `run --json` if the trial has ended, else None."""
        try:
            lines = (self.folder / "result.jsonl").read_text(encoding="utf-8").splitlines()
            records = [json.loads(line) for line in lines]
        except (OSError, ValueError):  # not written yet, or cut off
            return None
        return records[-2]["result"] if records and records[-1]["record"] == "end" else None

    def drive(self) -> dict[str, Any]:
        """Runs the trial in a process unless it has ended already; `run` keeps the files of an interrupted one."""
        if (found := self.result) is not None:
            return found
        code, text = run_headland(["run", *self.arguments, "--cores", "1", "--out", str(self.folder), "--json"], ROOT)
        if (result := self.result) is not None:
            return result
        reason = " ".join(text.strip().splitlines()[-1:])
        if self.may_refuse and code == REFUSED:
            return {"outcome": f"refused: {reason}"}
        raise HeadlandError(f"{self.name} did not finish: {reason}")


def trials_of(campaign: str, seeds: int, top: Path, plant: str | None = None) -> list[Trial]:
    """All runs of a campaign with this plant (None: the scenario's); `dock` has one run per bay and seed."""

    def trial(name: str, *arguments: str, may_refuse: bool = False) -> Trial:
        chosen = () if plant is None else ("--plant", plant)
        return Trial(name, (top / name).absolute(), (*arguments, *chosen), may_refuse)

    numbers = range(1, seeds + 1)
    if campaign == "dock":
        return [
            trial(f"{bay}-{k}", "--mission", "dock", "--bay", bay, "--seed", str(k), may_refuse=True)
            for k in numbers
            for bay in BAYS
        ]
    extra = ["--without-obstacle-rules"] if campaign == "ablation" else []
    return [trial(f"seed-{k}", "--seed", str(k), *extra) for k in numbers]


def main(arguments: argparse.Namespace) -> int:
    """Runs the missing trials; 0 if every trial passed."""
    arguments.seeds = DEFAULT_SEEDS.get(arguments.campaign, 10) if arguments.seeds is None else arguments.seeds
    name = arguments.campaign
    verb, command = f"campaign-{name}", {"campaign": name}
    if name == "fault-injection":
        command |= {"model": arguments.model and str(arguments.model)}
    elif name != "hazards":
        command |= {"plant": arguments.plant}
    with RunFolder(verb, arguments.out, command, resumes=True):
        pass  # a folder of another command is refused before the imports, which take seconds
    if name == "fault-injection":
        from runtime.fault_injection import campaign as fault_injection

        return fault_injection.main(arguments, command)
    if name == "hazards":
        from runtime.hazards import campaign as hazards

        return hazards.main(arguments)
    with RunFolder(verb, arguments.out, command, resumes=True) as folder:
        trials = trials_of(name, arguments.seeds, folder.path, arguments.plant)
        for trial in trials:
            folder.file(trial.name)
        found = {trial.name: result for trial, result in _drive_all(trials, arguments.jobs)}
        results = [{"trial": trial.name, **found[trial.name]} for trial in trials if trial.name in found]
        rows = [_row(result) for result in results]
        table = folder.file("table.html")
        with named_errors(folder.path):
            table.write_text(page(name, rows), encoding="utf-8")
    passed = sum(_has_passed(result, name) for result in results)
    if arguments.json:
        values = {"campaign": name, "passed": passed, "runs": results, "run_dir": str(folder.path)}
        sys.stdout.write(json.dumps(values) + "\n")
    else:
        sys.stdout.write(f"{passed} of {len(trials)} passed; table: {table}\n")
    return 0 if passed == len(trials) else 1


def _drive_all(trials: list[Trial], jobs: int) -> Iterator[tuple[Trial, dict[str, Any]]]:
    """Results in the order of completion, with a progress line each; a failed trial does not end the campaign."""
    with ThreadPoolExecutor(jobs) as pool:  # each thread only waits for its process
        waiting = {pool.submit(trial.drive): trial for trial in trials}
        try:
            for number, future in enumerate(as_completed(waiting), 1):
                trial = waiting[future]
                try:
                    result = future.result()
                except HeadlandError as error:
                    sys.stderr.write(f"[{number}/{len(trials)}] {error}\n")
                    continue
                sys.stderr.write(f"[{number}/{len(trials)}] {trial.name}: {_summary(result)}\n")
                yield trial, result
        except BaseException:  # interrupted: each drive closes its log
            pool.shutdown(wait=False, cancel_futures=True)
            terminate_children()
            raise


def _summary(result: dict[str, Any]) -> str:
    if "stops" not in result:
        return str(result["outcome"])
    dock = "" if result["dock_error_m"] is None else f", {100.0 * result['dock_error_m']:.1f} cm dock error"
    ends = f"{len(result['stops'])} stops, {result['contacts']} contacts{dock}"
    return f"{result['outcome']}, {ends}, {result['wall_s']:.0f} s"


def _has_passed(result: dict[str, Any], campaign: str) -> bool:
    if "stops" not in result:
        return True
    expected: int = sum(result["expected_stops"].values())
    contacts, zone_exits = int(result["contacts"]), int(result["zone_exits"])
    if campaign == "ablation":
        return contacts == expected
    is_done, stops = str(result["outcome"]) in DONE, len(result["stops"])
    return is_done and stops == expected and contacts == zone_exits == 0


def _row(result: dict[str, Any]) -> dict[str, Any]:
    xte = result.get("xte_m") or {"sigma": None, "max_abs": None}
    more = {"xte_sigma_m": xte["sigma"], "xte_max_m": xte["max_abs"]}
    more |= {"stops": len(result["stops"])} if "stops" in result else {}
    return {key: (result | more).get(key) for key in COLUMNS}


def page(campaign: str, rows: list[dict[str, Any]]) -> str:
    """HTML page with one row per trial."""
    title = f"Campaign {campaign}"
    return render_page("table.html", title=title, totals="", keys=COLUMNS, rows=rows, number="%.4g", failures=())
