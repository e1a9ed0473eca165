"""Coverage plans of textbook fields, random polygons and parcels of national registers: share, coverage, time.

    ./headland benchmark planning [--groups textbook random registers] [--widths 3 6 12]
                                  [--turns reverse forward trailed] [--sample N] [--seed SEED]
                                  [--limit SECONDS] [--bound] [--pictures] [--work JSON] [--out FOLDER]

Each plan runs in a process of its own, forked after imports and kernels; its processor time is that of the process and
its children. Results are appended to FOLDER/results.jsonl; a second call continues, and prints the tables.
Parcels are read from HEADLAND_DATA, else from ../shared/data. A parcel counts where its largest inscribed circle is at
least 4 working widths wide; above 20 ha with the widest implement alone. `--sample` draws N parcels of the registers,
each with one of its widths. `--turns trailed` turns forwards with a trailed disc harrow. `--bound` adds the share of
each field that is workable by any plan (`planning_bound.py`). `--work` sets keys of `work`, such as
'{"swath_skip": 1}': with another FOLDER.
"""

import argparse
import json
import math
import os
import resource
import select
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.planning_bound import workable_share
from benchmarks.planning_check import check
from benchmarks.planning_fields import LARGE_M2, MIN_WIDTHS, Parcel, random_fields, registers, textbook
from benchmarks.recordings import DATA
from configs.mission import Work
from configs.site import DatumConfig
from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import ImplementFile, MountedImplement, TrailedImplement, Vehicle
from messages.errors import FieldError
from planning.config import PlanningConfig
from planning.drawing import draw_plan
from planning.field.field import FieldOutline
from planning.field.site_generation import site_within
from planning.plan import NARROW_PART, plan_field

LEAST_PLANNED_SHARE = 0.95
ROUNDING_M = 1e-9  # outside
WALL = 30.0  # wall time to processor time that is waited
PASSES = {3.0: 4, 6.0: 2, 12.0: 2}
Turns = Literal["forward", "reverse", "trailed"]
GROUPS = {"textbook": textbook, "random": lambda data: random_fields(), "registers": registers}


@dataclass(frozen=True)
class Case:
    """One plan of the benchmark."""

    parcel: Parcel
    width_m: float
    turns: Turns
    settings: str = "{}"  # of `work`, JSON

    @property
    def key(self) -> str:
        """Name in the results."""
        return f"{self.parcel.group} {self.parcel.name} {self.width_m:g} {self.turns}"


def implement_of(width_m: float, turns: Turns) -> MountedImplement | TrailedImplement:
    """The mounted harrow or the trailed disc harrow with another width, its frame as wide as its work."""
    name = "disc_harrow_3m" if turns == "trailed" else "harrow_6m"
    values = read_yaml(CONFIGS / f"implements/{name}.yaml")["implement"]
    values |= {"working_width_m": width_m, "width_m": width_m}
    return parse(ImplementFile, {"implement": values}, "benchmark").implement


def work_of(width_m: float, turns: Turns) -> Work:
    """Field work without overlap, 0.1 m from the edge."""
    return Work(
        headland_passes=PASSES[width_m], overlap_m=0.0, work_speed_kmh=10.0, turn_speed_kmh=5.0, lane_speed_kmh=10.0,
        boundary_margin_m=0.1, turns="reverse" if turns == "reverse" else "forward",
    )  # fmt: skip


def run(case: Case, picture: Path | None) -> dict[str, Any]:
    """Plans and checks one case; the processor time is that of planning alone."""
    vehicle, implement = load(Vehicle, find("machines", "tractor_e")), implement_of(case.width_m, case.turns)
    planning = parse(PlanningConfig, read_yaml(CONFIGS / "stack/planning.yaml"), "stack/planning.yaml")
    polygon, work = case.parcel.polygon, work_of(case.width_m, case.turns)
    work = parse(Work, work.model_dump() | json.loads(case.settings), "--work")
    datum = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
    before = busy_s()
    try:
        site = site_within(FieldOutline(case.parcel.name, datum, polygon), vehicle, implement, work)
        plan = plan_field(site, vehicle, implement, work, planning.planner, 1)
    except FieldError as error:
        return {"state": "refused", "reason": str(error), "cpu_s": busy_s() - before}
    cpu_s = busy_s() - before
    if picture is not None:
        draw_plan(plan, site, picture)
    paths = [p for p in plan.paths if p.p_map_m.shape[0] > 1]
    free = plan.drivable.allowed.union(polygon.buffer(-work.boundary_margin_m))
    found = check(paths, polygon, free, vehicle, implement)
    return {
        "state": "planned" if plan.planned_share >= LEAST_PLANNED_SHARE else "below share",
        "share": plan.planned_share, "narrow_share": plan.uncovered_m2.get(NARROW_PART, 0.0) / plan.field_area_m2,
        "coverage": found.coverage, "outside_m": found.outside_m, "gap_m": found.gap_m,
        "curvature_radpm": found.curvature_radpm,
        "hitch_deg": math.degrees(found.hitch_rad), "off_line_m": found.off_line_m,
        "length_m": found.length_m, "working_m": found.working_m,
        "reverse_m": found.reverse_m, "cusps": found.cusps, "cpu_s": cpu_s,
        "time_s": sum(float((np.diff(p.s_m) / np.maximum(p.speed_mps[:-1], 0.05)).sum()) for p in paths),
    }  # fmt: skip


def busy_s() -> float:
    """Processor time of this process and its ended children."""
    now = os.times()
    return now.user + now.system + now.children_user + now.children_system


def bound_of(case: Case) -> float:
    """Greatest share of the field that any plan works."""
    vehicle, implement = load(Vehicle, find("machines", "tractor_e")), implement_of(case.width_m, case.turns)
    if not isinstance(implement, MountedImplement):
        raise SystemExit("--bound: only for mounted implements")
    margin_m = work_of(case.width_m, case.turns).boundary_margin_m
    return workable_share(case.parcel.polygon, margin_m, vehicle, implement)


def run_apart(case: Case, picture: Path | None, limit_s: float) -> dict[str, Any]:
    """`run` in a forked process, killed with its children after `limit_s` of processor time."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        os.close(reader)
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(busy_s() + limit_s), resource.RLIM_INFINITY))
        try:
            result = run(case, picture)
        except Exception as error:  # the table shows it
            result = {"state": "error", "reason": f"{type(error).__name__}: {error}", "cpu_s": busy_s()}
        os.write(writer, json.dumps(result).encode())
        os._exit(0)
    os.close(writer)
    ready, _, _ = select.select([reader], [], [], WALL * limit_s)
    if not ready:
        os.killpg(child, signal.SIGKILL)
    text = os.read(reader, 1 << 20) if ready else b""
    os.close(reader)
    _, _, usage = os.wait4(child, 0)
    found: dict[str, Any] = json.loads(text) if text else {"state": "too long", "cpu_s": limit_s}
    return {"key": case.key, "area_ha": case.parcel.polygon.area / 1e4, "rss_mib": usage.ru_maxrss / 1024, **found}


def cases(arguments: argparse.Namespace) -> Iterator[Case]:
    """All cases in order; of the registers with `--sample` those drawn by `--seed`."""
    for group in arguments.groups:
        parcels = [p for p in GROUPS[group](DATA) if arguments.only in p.name]
        widths = [_widths(p, [3.0] if group == "textbook" else arguments.widths) for p in parcels]
        if group == "registers" and arguments.sample:
            rng = np.random.default_rng(arguments.seed)
            drawn = [k for k in rng.permutation(len(parcels)) if widths[k]][: arguments.sample]
            parcels, widths = [parcels[k] for k in drawn], [[float(rng.choice(widths[k]))] for k in drawn]
        for parcel, fitting in zip(parcels, widths, strict=True):
            settings = arguments.work
            yield from (Case(parcel, width, turns, settings) for width in fitting for turns in arguments.turns)


def _widths(parcel: Parcel, widths: list[float]) -> list[float]:
    """The widths that a parcel is planned with."""
    is_large = parcel.group != "textbook" and parcel.polygon.area > LARGE_M2
    fitting = sorted(widths)[-1:] if is_large else sorted(widths)
    return [w for w in fitting if parcel.min_width_m >= MIN_WIDTHS * w]


def table(results: list[dict[str, Any]]) -> str:
    """One line for each group, width and kind of turns, and one for each textbook field."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for r in results:
        group, *_, width, turns = r["key"].split(" ")
        groups.setdefault(f"{group} {width} m {turns}", []).append(r)
    lines = [
        "group, width, turns        n  planned  below  refused  long  outside  coverage median/p5  "
        "cpu s median/p95/max  length/bound  idle  reverse  MiB"
    ]
    for name, found in groups.items():
        states = [r["state"] for r in found]
        done = [r for r in found if "coverage" in r]
        cpu = [r["cpu_s"] for r in found]
        line = f"{name:24} {len(found):4} {states.count('planned') / len(found):7.1%} {states.count('below share'):6} "
        line += f"{states.count('refused') + states.count('error'):8} {states.count('too long'):5} "
        if done:
            coverage = [r["coverage"] for r in done]
            line += f"{max(r['outside_m'] for r in done):8.4f}  "
            line += f"{np.median(coverage):.2%}/{np.quantile(coverage, 0.05):.2%} "
        line += f"   {np.median(cpu):6.2f}/{np.quantile(cpu, 0.95):6.2f}/{max(cpu):6.2f} "
        if done:
            total, work = sum(r["length_m"] for r in done), sum(r["working_m"] for r in done)
            ideal = sum(r["area_ha"] * 1e4 / float(r["key"].split(" ")[-2]) for r in done)
            line += f"  {total / ideal:8.3f}  {1 - work / total:.1%}  {sum(r['reverse_m'] for r in done) / total:.1%}"
            line += f"  {max(r['rss_mib'] for r in done):5.0f}"
        lines.append(line)
        bounded = [r for r in found if "workable" in r]
        if bounded:
            able = [r for r in bounded if r["workable"] >= LEAST_PLANNED_SHARE]
            share = [r.get("coverage", 0.0) / max(r["workable"], 1e-9) for r in bounded]
            line = f"  workable: p5 {np.quantile([r['workable'] for r in bounded], 0.05):.2%}, {len(able)} of "
            line += f"{len(bounded)} fields to {LEAST_PLANNED_SHARE:.0%}, of which planned "
            line += f"{sum(r['state'] == 'planned' for r in able)}; worked of it median/p5 "
            lines.append(line + f"{np.median(share):.2%}/{np.quantile(share, 0.05):.2%}")
    for r in results:
        if r["key"].startswith("textbook"):
            detail = r.get("reason", "")
            if "coverage" in r:
                detail = f"{r['coverage']:.2%} {r['length_m']:.0f} m, {r['cusps']} cusps"
            lines.append(f"  {r['key'][9:]:24} {r['state']:12} {r['cpu_s']:6.2f} s {detail}")
    return "\n".join(lines)


def main() -> int:
    """Runs what is missing, and prints the table; returns 1 when a plan leaves its field."""
    began_s = busy_s()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--widths", nargs="+", type=float, choices=PASSES, default=list(PASSES))
    parser.add_argument("--turns", nargs="+", choices=("reverse", "forward", "trailed"), default=["reverse"])
    parser.add_argument("--sample", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--limit", type=float, default=60.0)
    parser.add_argument("--bound", action="store_true")
    parser.add_argument("--pictures", action="store_true")
    parser.add_argument("--work", default="{}")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmark-planning"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "results.jsonl"
    known = {r["key"]: r for r in map(json.loads, file.read_text().splitlines())} if file.is_file() else {}
    wanted = list(cases(arguments))
    run(Case(next(textbook(DATA)), 12.0, arguments.turns[0]), None)  # compiles the kernels
    sys.stdout.write(f"imports and kernels {busy_s() - began_s:.1f} s, {len(wanted)} cases\n")
    for case in wanted:
        if case.key in known:
            continue
        picture = arguments.out / f"{case.key.replace('/', '-')}.png" if arguments.pictures else None
        limit_s = max(arguments.limit, case.parcel.polygon.area / 1e4)  # a second for each hectare
        known[case.key] = found = run_apart(case, picture, limit_s)
        if arguments.bound:
            found["workable"] = bound_of(case)
        with file.open("a") as stream:
            stream.write(json.dumps(found) + "\n")
    sys.stdout.write(table([known[c.key] for c in wanted]) + "\n")
    return int(any(known[c.key].get("outside_m", 0.0) > ROUNDING_M for c in wanted))


if __name__ == "__main__":
    sys.exit(main())
