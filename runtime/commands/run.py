"""`headland run`: drives a mission in simulation, evaluates the log, and writes the report."""

import argparse
import json
import os
import sys
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from runtime.commands.checks import check_drive

if TYPE_CHECKING:
    from runtime.page.shown_run import ShownRun


def main(arguments: argparse.Namespace) -> int:
    """Drives; 0 if the mission finished without contact, zone exit or false stop, else 1; 130 or 143 after a signal."""
    check_drive(arguments)
    # only now: these imports take seconds, and a wrong argument is reported at once
    from runtime.interruption import Interruption
    from runtime.run_folder import RunFolder, command_of

    with RunFolder("run", arguments.out, command_of(arguments)) as folder, Interruption() as interruption:
        from runtime.setup import load_scenario, setup_from, with_model
        from runtime.simulated_drive import drive

        setup = setup_from(arguments)
        setup = with_model(setup, arguments.model)
        scenario = load_scenario(arguments.scenario, setup.mission, arguments.field, arguments.plant)
        is_ablation, limit_s = arguments.without_obstacle_rules, arguments.duration
        cores = arguments.cores or len(os.sched_getaffinity(0))
        with _shown(arguments.page) as shown:
            result = drive(setup, scenario, folder, sys.stderr, is_ablation, limit_s, interruption, shown, cores)
        report = folder.path / "report.html"
    if arguments.json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        sys.stdout.write(f"{result['outcome']}; report: {report}\n")
    is_complete = result["outcome"] in ("finished", "docked")
    is_required = is_complete and not (result["contacts"] or result["zone_exits"] or result["false_stops"])
    return interruption.exit_code or (0 if is_required else 1)


def _shown(is_shown: bool) -> "AbstractContextManager[ShownRun | None]":
    """The page of the drive, None without one."""
    if not is_shown:
        return nullcontext()
    from runtime.page.shown_run import shown_run

    return shown_run()
