"""The command line; what a verb needs is imported only when it is called."""

import argparse
import importlib
import math
import sys
from pathlib import Path

from messages.errors import HeadlandError

EXIT_ERROR, EXIT_INTERRUPTED = 2, 130


def parser() -> argparse.ArgumentParser:
    """All verbs with their options."""
    top = argparse.ArgumentParser(prog="headland", description="Drives a farm machine with nobody on it.")
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")

    run = verbs.add_parser("run", help="drive a mission in simulation, from the yard and back")
    _add_mission(run)
    run.add_argument(
        "--scenario", default=None, help="who else is about (default: demo; with --field or no work: empty)"
    )
    run.add_argument("--seed", type=int, default=1, help="draws places, times and noise (default 1)")
    run.add_argument("--out", type=Path, help="run folder (default runs/<stamp>-run)")
    run.add_argument("--json", action="store_true", help="one object on standard output, progress on standard error")
    run.add_argument("--model", type=Path, metavar="FILE", help="ONNX file of the cameras' detector (YOLOX, NanoDet)")
    run.add_argument("--without-obstacle-rules", action="store_true", help="ablation: show what the rules are for")
    run.set_defaults(module="runtime.commands.run")

    plan = verbs.add_parser("plan", help="draw the plan for a field: picture, GeoJSON, length, area")
    plan.add_argument("field", metavar="FIELD.geojson", help="field outline in WGS 84, holes are not entered")
    _add_mission(plan, with_field=False)
    plan.add_argument("--seed", type=int, default=1, help="of the sampling planner (default 1)")
    plan.add_argument("--out", type=Path, help="run folder (default runs/<stamp>-plan)")
    plan.add_argument("--json", action="store_true", help="one object on standard output")
    plan.set_defaults(module="runtime.commands.plan")

    check = verbs.add_parser("check-log", help="say what is in a log, whole or cut off")
    check.add_argument("log", type=Path, metavar="LOG")
    check.add_argument("--json", action="store_true", help="one object on standard output")
    check.set_defaults(module="runtime.commands.inspect_log")

    campaign = verbs.add_parser("campaign", help="drive many seeds and draw one table")
    campaign.add_argument(
        "what", choices=["demo", "ablation", "dock", "faults"],
        help="demo; demo without the obstacle rules; docking alone, into each bay; or whatever can break, broken in "
        "every situation",
    )  # fmt: skip
    campaign.add_argument("--seeds", type=int, default=10, metavar="N", help="seeds 1 to N (default 10)")
    campaign.add_argument("--jobs", type=int, default=2, metavar="N", help="runs at a time (default 2)")
    campaign.add_argument("--only", metavar="REGEX", help="of faults: cells such as swath-imu-off whose name matches")
    campaign.add_argument("--situations", metavar="NAMES", help="of faults: turn,swath,obstacle,docking (default all)")
    campaign.add_argument("--out", type=Path, help="folder; given again, what is whole in it is not driven again")
    campaign.add_argument("--json", action="store_true", help="one object on standard output")
    campaign.set_defaults(module="runtime.commands.campaign")

    live = verbs.add_parser("live", help="the same stack against the wall clock, each part in a process of its own")
    live.add_argument("--world", choices=["simulation"], required=True, help="who is driven: the simulated machine")
    _add_mission(live)
    live.add_argument(
        "--scenario", default=None, help="who else is about (default: demo; with --field or no work: empty)"
    )
    live.add_argument("--seed", type=int, default=1, help="draws places, times and noise (default 1)")
    live.add_argument("--for", dest="for_s", type=float, metavar="S", help="end after so many seconds")
    live.add_argument("--break", dest="break_", metavar="PROCESS:SIGNAL:S", help="such as safety:KILL:20 (or STOP)")
    live.add_argument("--reactions", type=int, default=0, metavar="N", help="somebody pops up N times; times are told")
    live.add_argument("--out", type=Path, help="run folder (default runs/<stamp>-live)")
    live.add_argument("--json", action="store_true", help="one object on standard output, progress on standard error")
    live.set_defaults(module="runtime.live.command")

    shadow = verbs.add_parser("shadow", help="listen to a machine's bus, log it, and send nothing")
    shadow.add_argument("--bus", required=True, metavar="CHANNEL", help="by python-can's name, such as can0")
    shadow.add_argument("--interface", default="socketcan", help="python-can's interface (default socketcan)")
    shadow.add_argument("--for", dest="for_s", type=float, metavar="S", help="end after so many seconds")
    shadow.add_argument("--out", type=Path, help="run folder (default runs/<stamp>-shadow)")
    shadow.add_argument("--json", action="store_true", help="one object on standard output")
    shadow.set_defaults(module="runtime.live.shadow")

    validate = verbs.add_parser("validate", help="judge recorded logs: would this stack have stopped?")
    validate.add_argument("log", type=Path, nargs="+", metavar="LOG", help="MCAP, ROS bag, KITTI folder, PCD folder")
    validate.add_argument("--vehicle", type=Path, metavar="FILE", help="who recorded them: dimensions, lidars, mounts")
    validate.add_argument("--conditions", type=Path, metavar="FILE", help="default: validation/conditions/")
    validate.add_argument("--truth", type=Path, metavar="PATH", help="KITTI's labels, or a sidecar (.jsonl)")
    validate.add_argument("--model", type=Path, metavar="FILE", help="ONNX file of the cameras' detector")
    validate.add_argument("--without", metavar="NAME", help="judge as if this object of the truth had not been seen")
    validate.add_argument("--out", type=Path, help="run folder; given again, logs judged in it are not judged again")
    validate.add_argument("--json", action="store_true", help="one object on standard output")
    validate.add_argument("--jobs", type=int, metavar="N", help="logs at a time (default: all cores)")
    validate.add_argument("--scheduler", metavar="ADDRESS", help="judge on this Dask cluster")
    validate.set_defaults(module="runtime.commands.validate")

    bring = verbs.add_parser("import", help="write a recording of another format as a log of ours")
    bring.add_argument("source", type=Path, metavar="SOURCE")
    bring.add_argument("--out", type=Path, required=True, metavar="LOG.mcap")
    bring.add_argument("--truth", type=Path, metavar="PATH", help="KITTI's labels, or a sidecar (.jsonl)")
    bring.add_argument("--from", dest="start", type=float, default=0.0, metavar="S", help="seconds after its start")
    bring.add_argument("--to", dest="end", type=float, default=math.inf, metavar="S", help="seconds after its start")
    bring.add_argument("--json", action="store_true", help="one object on standard output")
    bring.set_defaults(module="runtime.commands.import_log")
    return top


def _add_mission(verb: argparse.ArgumentParser, with_field: bool = True) -> None:
    if with_field:
        verb.add_argument("--field", metavar="FILE.geojson", help="work this field instead of the mission's site")
    verb.add_argument("--mission", default="demo", help="a file, or a name in configs/missions (default demo)")
    verb.add_argument("--machine", help="a file, or a name in configs/machines (default: the mission's)")
    verb.add_argument("--implement", help="a file, or a name in configs/implements (default: the mission's)")
    verb.add_argument("--bay", metavar="NAME", help="begin and end docked in this bay of the shed")


def main() -> int:
    """Run the verb; errors of the user's making are one line on standard error and exit code 2."""
    arguments = parser().parse_args()
    try:
        return int(importlib.import_module(arguments.module).main(arguments))
    except HeadlandError as error:
        sys.stderr.write(f"headland: {error}\n")
        return EXIT_ERROR
    except KeyboardInterrupt:
        sys.stderr.write("headland: interrupted\n")
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
