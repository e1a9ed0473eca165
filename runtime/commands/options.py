"""Table of the commands with their options; imports nothing that a command needs."""

import argparse
import math
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from runtime.commands.argument_types import (
    address,
    existing,
    file,
    folder,
    model,
    names_of,
    new_file,
    number,
    path_name,
    regex,
    seeds,
    user,
    whole,
)

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Option:
    """Arguments of one `add_argument` call."""

    names: tuple[str, ...]
    settings: dict[str, Any]


@dataclass(frozen=True)
class Command:
    """A verb: its one-line help, the module whose `main` runs it, and its options."""

    verb: str
    help: str
    module: str
    options: tuple[Option, ...]
    exit_codes: str = "0 as required, 1 not as required, 2 wrong input or configuration"


def _option(*names: str, **settings: Any) -> Option:
    return Option(names, settings)


SECONDS, POSITIVE_SECONDS = number(0.0, 1e6, " s"), number(0.001, 1e6, " s")
JSON = _option("--json", action="store_true", help="print the result as one JSON object on standard output")
SEED = _option("--seed", type=whole(0, 2**32 - 1), default=1, help="seed of all random draws (default 1)")
DURATION = _option("--duration", type=POSITIVE_SECONDS, metavar="S", help="end after this many seconds")
MODEL = _option(
    "--model", type=model, metavar="MODEL",
    help="detector of the cameras: ONNX file (YOLOX, NanoDet, PicoDet or RT-DETR), or a name that `model` downloaded",
)  # fmt: skip
TRUTH = _option("--truth", type=existing, metavar="PATH", help="ground truth: KITTI labels or a JSONL sidecar file")
SCENARIO = _option(
    "--scenario", help="a file, or a name in configs/scenarios (default demo; empty with --field or without field work)"
)
PLANT = _option(
    "--plant", choices=["nominal", "drawn", "worst", "slow_brake"],
    help="true parameters of the machine: as configured, drawn from the seed, as bad as the stopping distance allows, "
    "or as configured with that brake (default: the scenario's)",
)  # fmt: skip
FIELD_FILE = "GeoJSON, KML, KMZ, Shapefile, ISOXML or GAOS file, or a folder or ZIP archive of it"
FIELD = _option(
    "--field", type=path_name, metavar="FILE", help=f"field outline that replaces the mission's site: {FIELD_FILE}"
)
FEATURE = _option(
    "--feature", metavar="NAME",
    help="field of a file with several: its name, or its number from 1; with .PART one part of it",
)  # fmt: skip
GUIDANCE = _option(
    "--guidance",
    metavar="LINE",
    help="line of the field file (AB, A+, curve, pivot), by name or number: swaths are parallel to it",
)
BUS_NAMES = "CAN bus: loopback:GROUP:PORT, or INTERFACE:CHANNEL of python-can such as socketcan:can0"
MISSION = (
    _option("--mission", default="demo", help="a file, or a name in configs/missions (default demo)"),
    _option("--machine", help="a file, or a name in configs/machines (default: the mission's)"),
    _option("--implement", help="a file, or a name in configs/implements (default: the mission's)"),
    _option("--bay", metavar="NAME", help="shed bay in which the mission starts and ends docked"),
)


def _out(verb: str, more: str = "") -> Option:
    return _option("--out", type=folder, metavar="FOLDER", help=f"run folder (default runs/<stamp>-{verb}){more}")


SITUATIONS = ("turn", "swath", "obstacle", "docking")
RESUMES = "; results already in it are kept"
COMMANDS = (
    Command("run", "drive a mission in simulation and write the report", "runtime.commands.run", (
        FIELD, FEATURE, GUIDANCE, *MISSION, SCENARIO, PLANT, SEED, MODEL, DURATION,
        _option("--without-obstacle-rules", action="store_true", help="ablation: no obstacle rules in the supervisor"),
        _option("--page", action="store_true", help="show the drive in the browser while it goes on"),
        _option("--cores", type=whole(1, 2), metavar="N",
                help="1: the whole drive in one process; 2: perception and localization in another (default: as this "
                "computer has); the result is the same"),
        _out("run"), JSON,
    )),
    Command("live", "run the stack in real time, one process per part", "runtime.commands.live", (
        _option("--world", choices=["simulation"], required=True, help="the machine that is driven"),
        _option("--bus", default="loopback", metavar="NAME", help=f"{BUS_NAMES} (default: a loopback bus of its own)"),
        FIELD, FEATURE, GUIDANCE, *MISSION, SCENARIO, SEED, DURATION,
        _option("--kill", metavar="PROCESS:SIGNAL:S", help="send KILL or STOP to a process, e.g. safety:KILL:20"),
        _option("--reaction-trials", type=whole(0, 1_000_000), default=0, metavar="N",
                help="measure reaction times to N pop-ups"),
        _out("live"), JSON,
    )),
    Command("page", "serve the operator's page: simulation, running drive or log", "runtime.commands.page", (
        FIELD, FEATURE, GUIDANCE, *MISSION, SCENARIO, PLANT, SEED,
        _option("--replay", type=file, metavar="LOG", help="play a log of `run` or `live` instead of a simulation"),
        _option("--connect", type=existing, metavar="FOLDER", help="run folder of a running `live`, which is shown"),
        _option("--key", type=file, metavar="FILE.pem",
                help="with --connect: Ed25519 key for orders, whose public key the machine has (default: no orders)"),
        _option("--live", action="store_true",
                help="simulate as `live` does, one process per part (default: not faster than real time)"),
        _option("--port", type=whole(0, 65535), metavar="N", help="port of the page (default in configs/page.yaml)"),
        _option("--stop-port", type=whole(0, 65535), metavar="N", help="port of the emergency stop"),
        _option("--foxglove", type=whole(0, 65535), metavar="N",
                help="port for Foxglove or Lichtblick on the loopback interface (default: none)"),
        _option("--setup-version", type=whole(1, 1_000_000), metavar="N",
                help="version of the machine's setup with which the first drive begins (default: the newest)"),
        _option("--listen", type=address, metavar="ADDRESS",
                help="IP address of this computer at which other devices reach the page, by TLS (default: loopback)"),
        _option("--add-user", type=user, metavar="NAME:ROLE",
                help="add or replace a user (view, operate, setup or service); password from standard input"),
        _option("--state", type=folder, metavar="FOLDER",
                help="users, key, missions and statistics (default state/page)"),
        _option("--config", type=file, metavar="FILE",
                help="ports, log-in, notifications and upload (default configs/page.yaml)"),
        _out("page"),
    ), "2 wrong input or configuration, 130 and 143 ended by SIGINT and SIGTERM"),
    Command("shadow", "log a machine's CAN bus without sending", "runtime.commands.shadow", (
        _option("--bus", required=True, metavar="NAME", help=f"{BUS_NAMES}, as `live` reports it"),
        DURATION, _out("shadow"), JSON,
    )),
    Command("plan", "plan a field: figure, GeoJSON, KML, ISOXML, path length and area", "runtime.commands.plan", (
        _option("field", type=path_name, metavar="FIELD", help=f"field outline, holes are excluded: {FIELD_FILE}"),
        FEATURE, GUIDANCE, *MISSION, SEED, _out("plan"), JSON,
    )),
    Command("coverage", "show which swept places the sensors cover", "runtime.commands.coverage", (
        _option("machine", metavar="MACHINE", help="a file, or a name in configs/machines"),
        _option("implement", metavar="IMPLEMENT", nargs="?", help="a file, or a name in configs/implements"),
        _option("--mission", default="demo", help="mission whose speeds count (default demo)"),
        _out("coverage"), JSON,
    )),
    Command("validate", "replay recorded logs and evaluate the obstacle stops", "runtime.commands.validate", (
        _option("log", type=existing, nargs="+", metavar="LOG", help="MCAP, ROS bag, KITTI folder or PCD folder"),
        _option("--vehicle", type=Path, metavar="FILE", help="recording vehicle: dimensions, lidars, mounts"),
        _option("--conditions", type=file, metavar="FILE", help="pass conditions (default: validation/conditions/)"),
        TRUTH, MODEL,
        _option("--remove-object", metavar="NAME", help="remove this object of the ground truth from all sensor data"),
        _option("--without-sensor-data", action="store_true", help="leave scans and images out of replay.mcap"),
        _option("--jobs", type=whole(1, 1024), metavar="N", help="logs at a time (default: all cores)"),
        _option("--scheduler", metavar="ADDRESS", help="run on this Dask cluster"),
        _out("validate", RESUMES), JSON,
    ), "0 passed, 1 failed, 2 bad input (a log could not be read), 3 not shown"),
    Command("label", "decide on the objects that validate proposes as truth", "runtime.commands.label", (
        _option("log", type=existing, metavar="LOG", help="a log that validate has replayed without truth"),
        _option("--list", action="store_true", help="only list the objects (the default without a decision)"),
        _option("--accept", type=int, nargs="+", action="extend", default=[], metavar="ID", help="objects that exist"),
        _option("--reject", type=int, nargs="+", action="extend", default=[], metavar="ID",
                help="what was perceived but is no obstacle; braking for it is a false stop"),
        _option("--class", dest="label", metavar="CLASS", help="class of the accepted or added objects"),
        _option("--size", metavar="L,W,H", help="size (m) of the accepted or added objects"),
        _option("--add", nargs="+", action="append", default=[], metavar="T:X,Y",
                help="an object that was not perceived: seconds in the log, m ahead and left of the lidar"),
        _option("--complete", action="store_true", help="the log was reviewed: no object in the path is missing"),
        _option("--proposed", type=file, metavar="FILE", help="default: beside the log, else of the newest run"),
        _option("--truth", type=Path, metavar="FILE", help="file that is written (default LOG.truth.jsonl)"), JSON,
    ), "0 done, 2 wrong input; nothing is written then"),
    Command("campaign", "run many drives or faults and write one table", "runtime.commands.campaign", (
        _option(
            "campaign", choices=["demo", "ablation", "dock", "fault-injection", "hazards"],
            help="demo: field work; ablation: demo without the obstacle rules; dock: docking into each bay; "
            "fault-injection: each fault in each situation; hazards: objects by placement, phase and environment",
        ),
        _option("--seeds", type=whole(1, 10_000), metavar="N", help="seeds 1 to N (default 10; hazards: 1)"),
        _option("--jobs", type=whole(1, 1024), default=2, metavar="N", help="runs at a time (default 2)"),
        PLANT,
        _option("--core", action="store_true", help="hazards: the first 60 drives of the list"),
        _option("--draws", type=seeds, metavar="FIRST-LAST",
                help="hazards: instead of the list a random drive of its levels for each of these seeds"),
        _option("--without", metavar="SENSOR", help="hazards: this sensor is off, e.g. lidar/front"),
        _option("--scheduler", metavar="ADDRESS", help="hazards: run on this Dask cluster"),
        _option("--only", type=regex, metavar="REGEX",
                help="fault-injection, hazards: matching names, e.g. swath-imu-off"),
        _option("--model", type=model, metavar="MODEL", help="fault-injection: detector of the cameras, as of `run`"),
        _option("--situations", type=names_of(SITUATIONS), metavar="NAMES",
                help=f"fault-injection: of {','.join(SITUATIONS)} (default all)"),
        _out("campaign", RESUMES), JSON,
    )),
    Command("import", "convert a recording into a Headland log", "runtime.commands.import_log", (
        _option("source", type=existing, metavar="SOURCE"),
        _option("--out", type=new_file, required=True, metavar="LOG.mcap"),
        TRUTH,
        _option("--topics", metavar="A,B", help="import these topics of the recording only"),
        _option("--from", dest="start", type=SECONDS, default=0.0, metavar="S", help="start second"),
        _option("--to", dest="end", type=SECONDS, default=math.inf, metavar="S", help="end second"),
        JSON,
    )),
    Command("localize", "run the localizer over a recording", "runtime.commands.localize", (
        _option("log", type=existing, metavar="LOG", help="any recording that `import` reads"),
        _option("--truth", type=existing, metavar="PATH",
                help="true positions: TUM, CSV, comma2k19's global_pose, or a recording with fixes such as .pos"),
        _option("--vehicle", type=Path, metavar="FILE",
                help="mounts and noise of the sensors (default: that of the format, or in a Headland log)"),
        _option("--fixes-every", type=whole(1, 10_000), default=1, metavar="N",
                help="use every N-th fix only; without --truth the others are the truth"),
        _out("localize"), JSON,
    ), "0 placed as required and never off by more than the protection level, 1 not, 2 bad input, 3 no position"),
    Command("animate", "write an animation of a logged drive", "runtime.commands.animate", (
        _option("log", type=existing, metavar="LOG", help="log of `headland run`"),
        _option("--out", type=new_file, required=True, metavar="FILE.webp"),
        _option("--from", dest="start", type=SECONDS, default=0.0, metavar="S", help="start second of the log"),
        _option("--duration", type=number(0.1, 1e6, " s"), default=20.0, metavar="S",
                help="seconds of the drive (default 20)"),
        _option("--rate", type=number(0.1, 100.0), default=2.0, metavar="X", help="times real time (default 2)"),
        _option("--quality", type=whole(0, 100), default=65, metavar="Q", help="WebP quality, 0 to 100 (default 65)"),
    )),
    Command("model", "download a known network of the camera detector", "runtime.commands.model", (
        _option("name", metavar="NAME", help="a name in configs/models.yaml"), JSON,
    ), "0 the file is in the cache, 2 it is not, or is damaged"),
    Command("inspect-log", "list the topics, gaps and damage of a log", "runtime.commands.inspect_log", (
        _option("log", type=existing, metavar="LOG"), JSON,
    )),
)  # fmt: skip


class Parser(argparse.ArgumentParser):
    """Parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Prints the error and exits with code 2."""
        text = re.sub(r"^argument ([^ :]+):", r"\1", message)
        text = re.sub(r"[\x00-\x1f\x7f]", lambda match: repr(match[0])[1:-1], text)
        self.exit(2, f"{self.prog}: {text}; see ./{self.prog} --help\n")


def version() -> str:
    """Version of the project, from pyproject.toml."""
    found = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else "unknown"


def make_parser() -> Parser:
    """Parser of the command line; the namespace holds the command's `module`."""
    parser = Parser(prog="headland", description="Autonomous driving of a farm machine.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"headland {version()}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for command in COMMANDS:
        verb = verbs.add_parser(
            command.verb, help=command.help, description=command.help, allow_abbrev=False,
            epilog=f"Exit codes: {command.exit_codes}.",
        )  # fmt: skip
        for option in command.options:
            verb.add_argument(*option.names, **option.settings)
        verb.set_defaults(module=command.module)
    return parser


def parse_arguments(words: list[str] | None = None) -> argparse.Namespace:
    """Arguments of the command line; prints one line and exits with code 2 for wrong ones."""
    parser, given = make_parser(), sys.argv[1:] if words is None else words
    for word in given:
        try:
            word.encode()
        except UnicodeEncodeError:
            parser.error(f"{word!r}: not valid UTF-8")
    return parser.parse_args(given)
