"""Classes of tracks in simulation: confusion matrix by weather and sensor set.

    ./headland benchmark perception_classes [--seeds N] [--first-seed K] [--only REGEX] [--sensors all lidar]
                                            [--jobs N] [--out FOLDER]

The machine drives along a swath with `OBJECTS` beside its path, 4 to 12 m away, some of them on the move, by the whole
stack with ray-cast lidar scans. Each message of tracks counts once for each true object within 20 m that has a
confirmed track within 0.5 m of its box. `right`: a track of its class; the share of one class is over all its messages.
Rows of single drives are appended to FOLDER/rows.jsonl, and a second call continues.
"""

import argparse
import multiprocessing
import re
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rows import append_row, rows_of
from configs.sensor_kinds import sensors_of
from configs.strict import CONFIGS, parse, read_yaml
from datasets.reader import read_log
from geometry.arrays import Float64
from geometry.transforms import invert
from messages.motion import Odometry
from messages.perception import Track, Tracks
from messages.truth import TrueMachine, TrueObject, TrueObjects
from runtime.setup import load_setup
from runtime.simulated_drive import drive_into_log
from simulation.scenario import Scenario
from validation.obstacle_stop.boxes import box_of

MISSED = "missed"
LIMIT_S, RANGE_M, APART_M = 16.0, 20.0, 0.5
MAX_APART_NS = 60_000_000  # of truth, which has 10 Hz, and tracks
OBJECTS = ("adult", "child", "cyclist", "dog", "calf", "sheep", "roe_deer", "car", "quad", "post", "round_bale",
           "stone")  # fmt: skip
MOVING_MPS = {"adult": (0.8, 1.8), "child": (0.6, 1.5), "cyclist": (2.0, 6.0), "dog": (0.8, 3.0), "calf": (0.3, 1.2),
              "sheep": (0.3, 1.2), "roe_deer": (0.8, 4.0), "car": (1.5, 4.0), "quad": (1.5, 5.0)}  # fmt: skip
SENSORS = {"all": (), "lidar": ("radar", "ultrasonic")}  # kinds of those that are off
SLOTS = 6  # objects of one drive, alternately left and right
WEATHERS = ("as configured", "stubble 10 cm", "dust", "fog 60 m", "rain 100 m", "waves", "side slope")
CLEAR = ("as configured", "stubble 10 cm", "waves", "side slope")


@dataclass(frozen=True)
class Row:
    """Messages of one drive by "truth > label"; `missed`: without a confirmed track."""

    weather: str
    sensors: str
    seed: int
    counts: dict[str, int]


def scenario_of(weather: str, seed: int, sensors: str) -> dict[str, Any]:
    """Scenario as plain data: every object comes in two of `2 * len(OBJECTS) / SLOTS` seeds, once on the move."""
    at = SLOTS * seed % (2 * len(OBJECTS))
    names = [OBJECTS[(at + k) % len(OBJECTS)] for k in range(SLOTS)]
    objects = [_object(name, k, moves=(at + k) // len(OBJECTS) % 2 == 1) for k, name in enumerate(names)]
    fitted = load_setup("line", None, None, None, 1).vehicle.sensors
    off = [f"{kind}/{name}" for kind in SENSORS[sensors] for name in sensors_of(fitted, kind)]
    return {
        "name": f"classes {weather} {seed}", "objects": objects,
        "operator_commands": [{"at_s": 3.0, "command": "start", "expires_s": 5.0}],
        "environment": read_yaml(CONFIGS / "hazards.yaml")["environments"][weather],
        "faults": [{"topic": topic, "kind": "off", "from_s": 0.0, "for_s": 1e6} for topic in off],
    }  # fmt: skip


def _object(name: str, slot: int, moves: bool) -> dict[str, Any]:
    side = 1.0 if slot % 2 == 0 else -1.0
    ahead_m = [6.0 + 5.0 * slot, 10.0 + 5.0 * slot]
    place: dict[str, Any] = {"frame": "path", "ahead_m": ahead_m, "left_m": sorted([4.5 * side, 12.0 * side])}
    moves &= name in MOVING_MPS
    place["heading_deg"] = [-20.0, 20.0] if moves and slot % 3 else [160.0, 200.0] if moves else [-180.0, 180.0]
    walk = {"kind": "cross", "speed_mps": list(MOVING_MPS[name]), "distance_m": 60.0} if moves else {"kind": "stand"}
    return {"name": f"{name} {slot}", "object": name, "place": place, "behaviour": walk}


def drive(case: tuple[str, str, int], out: Path) -> Row:
    """One drive, into a log that is removed afterwards."""
    weather, sensors, seed = case
    folder = out / f"{weather.replace(' ', '-')}-{sensors}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    scenario = parse(Scenario, scenario_of(weather, seed, sensors), folder.name)
    log = folder / "log.mcap"
    log.unlink(missing_ok=True)
    with (folder / "console.log").open("w", encoding="utf-8") as console:
        setup = load_setup("line", None, None, None, seed)
        drive_into_log(setup, scenario, folder, {"seed": str(seed)}, console, limit_s=LIMIT_S)
    counts = counted(log)
    log.unlink()
    return Row(weather, sensors, seed, dict(sorted(counts.items())))


def counted(log: Path) -> Counter[str]:
    """Messages of tracks by class of each true object and of its track."""
    counts: Counter[str] = Counter()
    objects: TrueObjects | None = None
    machine: TrueMachine | None = None
    odom: Odometry | None = None
    for envelope in read_log(log, {"truth_objects", "truth_machine", "odom", "tracks"}):
        message = envelope.message
        if isinstance(message, TrueObjects):
            objects = message
        elif isinstance(message, TrueMachine):
            machine = message
        elif isinstance(message, Odometry):
            odom = message
        elif (
            isinstance(message, Tracks) and objects is not None and machine is not None and odom is not None
            and abs(message.stamp_ns - objects.stamp_ns) <= MAX_APART_NS
        ):  # fmt: skip
            counts.update(_pairs(message, objects, machine, odom))
    return counts


def _pairs(tracks: Tracks, objects: TrueObjects, machine: TrueMachine, odom: Odometry) -> list[str]:
    T_base_odom, T_base_map = invert(odom.T_odom_base), invert(machine.T_map_base)
    confirmed = [track for track in tracks.tracks if track.is_confirmed]
    places = np.array([track.p_odom_m for track in confirmed]).reshape(-1, 3) @ T_base_odom[:3, :3].T
    places_base_m = (places + T_base_odom[:3, 3])[:, :2]
    return [
        f"{true.kind} {true.label} > {label_of(true, confirmed, places_base_m, T_base_map)}"
        for true in objects.objects if true.role and true.clearance_m <= RANGE_M
    ]  # fmt: skip


def label_of(true: TrueObject, tracks: list[Track], places_base_m: Float64, T_base_map: Float64) -> str:
    """Class of the nearest of the tracks with centres (N, 2) in base that belongs to an object; `missed` without."""
    if not tracks:
        return MISSED
    box = box_of(true, T_base_map)
    apart_m = box.distance_m(places_base_m)
    nearest = min(np.flatnonzero(apart_m <= APART_M), default=None,
                  key=lambda k: float(np.hypot(*(places_base_m[k] - box.center_m[:2]))))  # fmt: skip
    return MISSED if nearest is None else str(tracks[nearest].label)


def table(rows: list[Row], is_clear: bool, sensors: str) -> str:
    """Confusion matrix in percent of the messages with a track, by true class and kind; the share that is right."""
    total: Counter[str] = Counter()
    for row in rows:
        if row.sensors == sensors and (row.weather in CLEAR) == is_clear:
            total.update(row.counts)
    lines, right, tracked = [], 0, 0
    for kind in sorted({pair.partition(" > ")[0] for pair in total}):
        mine = {pair.partition(" > ")[2]: n for pair, n in total.items() if pair.startswith(f"{kind} > ")}
        n, truth = sum(mine.values()) - mine.get(MISSED, 0), kind.split()[1]
        right, tracked = right + mine.get(truth, 0), tracked + n
        shares = ", ".join(f"{label} {100.0 * count / max(n, 1):.1f} %" for label, count in
                           sorted(mine.items(), key=lambda one: -one[1]) if label != MISSED)  # fmt: skip
        lines.append(f"  {kind}: {shares}; {n} messages, {mine.get(MISSED, 0)} without a track")
    share = 100.0 * right / max(tracked, 1)
    return "\n".join([f"{sensors}, {'clear' if is_clear else 'bad weather'}: right {share:.1f} % of {tracked}", *lines])


def main() -> int:
    """Drives what is missing, and prints the matrices."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--only", default="", help="weathers whose name matches")
    parser.add_argument("--sensors", nargs="+", choices=tuple(SENSORS), default=["all"])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/perception_classes"))
    arguments = parser.parse_args()
    out, file = arguments.out, arguments.out / "rows.jsonl"
    out.mkdir(parents=True, exist_ok=True)
    rows = rows_of(file, Row)
    done = {(row.weather, row.sensors, row.seed) for row in rows}
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    weathers = [name for name in WEATHERS if re.search(arguments.only, name)]
    cases = [(w, s, seed) for seed in seeds for w in weathers for s in arguments.sensors if (w, s, seed) not in done]
    with ProcessPoolExecutor(arguments.jobs, multiprocessing.get_context("spawn")) as pool:
        for row in pool.map(partial(drive, out=out), cases):
            append_row(file, row)
            rows.append(row)
            sys.stderr.write(f"[{len(rows)}] {row.weather}, {row.sensors}, seed {row.seed}\n")
    for sensors in sorted({row.sensors for row in rows}):
        for is_clear in (True, False):
            sys.stdout.write(table(rows, is_clear, sensors) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
