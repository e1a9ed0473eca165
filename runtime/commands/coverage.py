"""`headland coverage`: the swept places that the sensors of machine and implement cover, from configuration alone."""

import argparse
import csv
import io
import json
import sys
from typing import Any

from configs.mission import Mission
from configs.strict import CONFIGS, find, load
from configs.vehicle import ImplementFile, Vehicle
from runtime.run_folder import RunFolder, command_of, named_errors, resolved, versions


def main(arguments: argparse.Namespace) -> int:
    """Evaluates and writes picture and table; 0 if every reached place is covered or enclosed, else 1."""
    vehicle = load(Vehicle, find("machines", arguments.machine))
    mission, name = load(Mission, find("missions", arguments.mission)), arguments.implement
    implement = None if name is None else load(ImplementFile, find("implements", name)).implement
    with RunFolder("coverage", arguments.out, command_of(arguments)) as folder:
        # only now: these imports take seconds, and a wrong argument is reported at once
        from runtime.coverage.config import CoverageConfig
        from runtime.coverage.drawing import draw
        from runtime.coverage.evaluation import evaluate
        from runtime.coverage.states import states_of
        from runtime.setup import with_implement_sensors
        from runtime.stack import load_stack

        vehicle = vehicle if implement is None else with_implement_sensors(vehicle, implement)
        config, stack = load(CoverageConfig, CONFIGS / "coverage.yaml"), load_stack()
        states = states_of(mission, vehicle, implement, stack.planning)
        found = evaluate(vehicle, implement, states, stack.safety, config)
        rows = [one.row() for one in found]
        uncovered_m2 = round(sum(float(str(row["uncovered_m2"])) for row in rows), 2)
        result = {
            "machine": vehicle.name, "implement": implement and implement.name, "uncovered_m2": uncovered_m2,
            "rows": rows, "run_dir": str(folder.path),
        }  # fmt: skip
        sections = {"machine": vehicle, "mission": mission, "coverage": config}
        with named_errors(folder.path):
            folder.file("config.yaml").write_text(resolved(**sections), encoding="utf-8")
            folder.file("coverage.csv").write_text(table_csv(rows), encoding="utf-8")
            draw(found, vehicle, implement, folder.file("coverage.png"))
        folder.record("conditions", versions())
        folder.record("result", {"result": result})
        folder.finish()
    sys.stdout.write(json.dumps(result) + "\n" if arguments.json else table_text(rows) + f"{folder.path}\n")
    return 0 if all(one.worst_m is None for one in found) else 1


def table_csv(rows: list[dict[str, Any]]) -> str:
    """The table as CSV."""
    out = io.StringIO()
    writer = csv.DictWriter(out, rows[0])
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


COLUMNS = ("state", "speed_mps", "stopping_m", "height_m", "reached_m2", "covered_m2", "enclosed_m2", "uncovered_m2")


def table_text(rows: list[dict[str, Any]]) -> str:
    """The table for the console; the last column is the worst place (x, y) in base."""
    lines = [f"{COLUMNS[0]:18} " + " ".join(f"{name:>12}" for name in COLUMNS[1:]) + "  worst_m"]
    for row in rows:
        values = " ".join(f"{row[name]:12.2f}" for name in COLUMNS[1:])
        lines.append(f"{row['state']:18} {values}  {row['worst_m'] or ''}".rstrip())
    return "\n".join(lines) + "\n"
