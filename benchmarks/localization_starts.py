"""Starts of the localizer under conditions nobody prepared: right, or refused with the reason, within 20 s.

    ./headland benchmark localization_starts [--first-seed 1] [--starts 100] [--only shed] [--out FOLDER]

Each start is a synthetic drive of its own (tests/localization) with all errors drawn. A start is right when every pose
of its first 20 s is within the protection level and 3 degrees or five sigma of heading; refused when there is no
position and a fault says why; else wrong. Rows are appended to FOLDER/rows.jsonl, and a second call continues.
"""

import argparse
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.localization_faults import FLOAT, Case, Draw, edited, worse
from benchmarks.localization_robustness import sensor_errors
from benchmarks.rows import append_row, rows_of
from configs.site import PoseConfig, Shed
from configs.vehicle import Mount
from geometry.angles import wrap
from geometry.transforms import yaw_of
from localization.lidar.map_localization import LidarMap
from localization.localizer import Localizer
from messages.message import Message
from messages.sensors import GnssFix
from tests.localization.harness import Run, configuration, run
from tests.localization.synthetic_drive import DATUM, START_NS, Truth, drive
from tests.localization.synthetic_shed import UwbErrors, harrow, messages, shed, simulate_scan, tagged

WITHIN_S, HEADING_DEG, HEADING_SIGMAS = 20.0, 3.0, 5.0
REASONS = ("gnss.", "localization.", "imu.", "wheel.", "imu_or_wheel.")
Entry = tuple[int, str, Message]


@dataclass(frozen=True)
class Start:
    """Result of one start; `after_s` to the first position, `excess_m` the largest error above the protection level.

    `detail`: how wrong, or the reasons of a refusal.
    """

    case: str
    seed: int
    outcome: str
    after_s: float | None
    error_m: float
    excess_m: float
    heading_deg: float
    detail: str


def by_float(seed: int) -> tuple[Run, Truth]:
    """RTK float with an error of 0.4 m (1 sigma, 60 s) from power-on; the machine stands for 4 to 12 s."""
    rng = np.random.default_rng([seed, 30])
    truth = drive(
        WITHIN_S, legs=[(rng.uniform(4.0, 12.0), 0.0, 0.0), *_motions(rng)], sensor_errors=sensor_errors(seed)
    )
    return run(edited(truth, worse(FLOAT, WITHIN_S, 0.0, is_start=True), Draw(seed))), truth


def moving(seed: int) -> tuple[Run, Truth]:
    """In motion at power-on, forwards or in reverse; every second machine with one antenna."""
    rng = np.random.default_rng([seed, 31])
    truth = drive(WITHIN_S, legs=_motions(rng), sensor_errors=sensor_errors(seed))
    return run(_without_heading(truth, seed) if seed % 2 else truth.messages), truth


def heading_unknown(seed: int) -> tuple[Run, Truth]:
    """One antenna; the machine stands for 2 to 8 s and is then driven by hand, forwards or in reverse."""
    rng = np.random.default_rng([seed, 32])
    truth = drive(WITHIN_S, legs=[(rng.uniform(2.0, 8.0), 0.0, 0.0), *_motions(rng)], sensor_errors=sensor_errors(seed))
    return run(_without_heading(truth, seed)), truth


def in_shed(seed: int) -> tuple[Run, Truth]:
    """Parked within 1 m and 30 degrees of the place in the dock where the machine is believed to be.

    The survey is wrong by 2 to 5 cm and 0.2 degrees, posts by 1 cm, anchors by 5 cm, mounts by 0.5 degrees.
    """
    rng = np.random.default_rng([seed, 33])
    bay = "narrow" if seed % 2 else "wide"
    dock = shed().bay(bay).dock
    x_m, y_m, turn_deg = rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), rng.uniform(-30.0, 30.0)
    begin = dock.x_m + x_m, dock.y_m + y_m, math.radians(dock.heading_deg + turn_deg)
    errors = replace(
        sensor_errors(seed), slip=0.005, slip_swing=0.0, slip_per_force=0.05, soil_side=0.001, furrow_m=0.0
    )
    legs = [(8.0, 0.0, 0.0), (12.0, 0.4, 0.0)]
    truth = drive(WITHIN_S, legs=legs, sensor_errors=errors, begin=begin, is_flat=True)
    surveyed = surveyed_shed(shed(), rng)
    vehicle = tagged()
    lidars = {
        name: lidar.model_copy(update={"mount": _turned(lidar.mount, rng)})
        for name, lidar in vehicle.sensors.lidar.items()
    }
    vehicle = vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"lidar": lidars})})
    config, noise = configuration(), np.random.default_rng([seed, 34])
    node = Localizer(vehicle, DATUM, config, surveyed, surveyed.bay(bay).dock)
    lidar_map = LidarMap(vehicle, harrow(), surveyed, config.lidar_map)
    mapped = (
        lidar_map,
        lambda t: {s: simulate_scan(truth, t, s, noise) for s in ("front", "rear")} if t > START_NS + 2e8 else None,
    )
    return run(messages(truth, UwbErrors(), seed), localizer=node, lidar_map=mapped), truth


def surveyed_shed(true: Shed, rng: np.random.Generator) -> Shed:
    """The shed as a survey has it: shifted and turned as a whole, posts and anchors each wrong in addition."""
    shift = rng.uniform(0.02, 0.05) * _direction(rng)
    turn = math.radians(0.2) * rng.choice([-1.0, 1.0])
    center = np.mean(np.array(true.outline_m), axis=0)
    c, s = math.cos(turn), math.sin(turn)

    def moved(p: tuple[float, ...], error: np.ndarray) -> tuple[float, ...]:
        xy = np.array([[c, -s], [s, c]]) @ (np.array(p[:2]) - center) + center + shift + error[:2]
        return (*map(float, xy), *(float(z + e) for z, e in zip(p[2:], error[2:], strict=False)))

    none = np.zeros(3)
    posts = [p.model_copy(update={"at_m": moved(p.at_m, rng.normal(0.0, 0.01, 3))}) for p in true.posts]
    anchors = {name: moved(p, rng.normal(0.0, 0.05, 3)) for name, p in true.anchors.items()}
    bays = tuple(
        bay.model_copy(
            update={"dock": PoseConfig(x_m=p[0], y_m=p[1], heading_deg=bay.dock.heading_deg + math.degrees(turn))}
        )
        for bay in true.bays
        for p in [moved((bay.dock.x_m, bay.dock.y_m), none)]
    )
    walls = tuple(tuple(moved(p, none) for p in wall) for wall in true.walls_m)
    return true.model_copy(update={
        "outline_m": tuple(moved(p, none) for p in true.outline_m), "walls_m": walls, "posts": tuple(posts),
        "anchors": anchors, "bays": bays,
    })  # fmt: skip


def _direction(rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle)])


def _turned(mount: Mount, rng: np.random.Generator) -> Mount:
    roll, pitch, yaw = (float(a + e) for a, e in zip(mount.rpy_deg, rng.normal(0.0, 0.5, 3), strict=True))
    return mount.model_copy(update={"rpy_deg": (roll, pitch, yaw)})


def _motions(rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """Two to three sections at 0.5 to 2.8 m/s with curvatures up to that of R = 8 m; a third of them in reverse."""
    sign, left_s, legs = (1.0 if rng.random() < 2.0 / 3.0 else -1.0), WITHIN_S, []
    while left_s > 0.0:
        for_s = float(rng.uniform(4.0, 12.0))
        curvature = 0.0 if rng.random() < 0.5 else float(rng.uniform(-0.125, 0.125))
        legs.append((for_s, sign * float(rng.uniform(0.5, 2.8)), curvature))
        left_s -= for_s
    return legs


def _without_heading(truth: Truth, seed: int) -> list[Entry]:
    def edit(message: Message, elapsed_s: float, draw: Draw) -> Message:
        if not isinstance(message, GnssFix):
            return message
        return replace(message, heading_rad=math.nan, sigma_heading_rad=math.nan)

    return edited(truth, Case("one antenna", edit, 0.0), Draw(seed))


def judged(case: str, seed: int, result: Run, truth: Truth) -> Start:
    """Compares the poses with the truth."""
    poses = [p for p in result.poses if p.is_initialized]
    error_m = [float(np.linalg.norm((p.T_map_base - truth.at(p.stamp_ns))[:2, 3])) for p in poses]
    excess_m = [e - p.protection_level_m for e, p in zip(error_m, poses, strict=True)]
    heading_deg = [abs(math.degrees(wrap(yaw_of(p.T_map_base) - yaw_of(truth.at(p.stamp_ns))))) for p in poses]
    allowed_deg = [max(HEADING_DEG, HEADING_SIGMAS * math.degrees(math.sqrt(p.covariance[2, 2]))) for p in poses]
    is_wrong = any(e > 0.0 for e in excess_m) or any(h > a for h, a in zip(heading_deg, allowed_deg, strict=True))
    active: dict[str, str] = {}
    for fault in result.faults:
        active.pop(fault.code, None)
        if fault.is_active and fault.code.startswith(REASONS):
            active[fault.code] = fault.text_en
    reasons = "; ".join(f"{code} {detail}".strip() for code, detail in sorted(active.items(), reverse=True))
    is_placed = bool(result.poses) and result.poses[-1].is_initialized
    outcome = "wrong" if is_wrong else "right" if is_placed else "refused" if reasons else "refused without a reason"
    after_s = (poses[0].stamp_ns - START_NS) * 1e-9 if poses else None
    return Start(
        case, seed, outcome, after_s, max(error_m, default=0.0), max(excess_m, default=-math.inf),
        max(heading_deg, default=0.0), reasons,
    )  # fmt: skip


CASES: dict[str, Callable[[int], tuple[Run, Truth]]] = {
    "float": by_float, "moving": moving, "heading unknown": heading_unknown, "shed": in_shed,
}  # fmt: skip


def table(rows: list[Start]) -> str:
    """Markdown table by case."""
    lines = [
        "| start | starts | right | refused | without a reason | wrong | median s | reasons |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        found = [r for r in rows if r.case == case]
        if found:
            n = Counter(r.outcome for r in found)
            after = [r.after_s for r in found if r.outcome == "right" and r.after_s is not None]
            median = f"{np.median(after):.1f}" if after else "—"
            reasons = Counter(r.detail.split(" ")[0] for r in found if r.outcome == "refused")
            named = ", ".join(f"{code} {k}" for code, k in sorted(reasons.items())) or "—"
            lines.append(
                f"| {case} | {len(found)} | {n['right']} | {n['refused']} | {n['refused without a reason']} "
                f"| {n['wrong']} | {median} | {named} |"
            )
    return "\n".join(lines)


def main() -> None:
    """Runs what is missing and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--out", type=Path, default=Path("runs/localization_starts"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "rows.jsonl"
    rows = rows_of(file, Start)
    done = {(r.case, r.seed) for r in rows}
    for case in arguments.only:
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.starts):
            if (case, seed) not in done:
                rows.append(judged(case, seed, *CASES[case](seed)))
                append_row(file, rows[-1])
    print(table(rows))


if __name__ == "__main__":
    main()
