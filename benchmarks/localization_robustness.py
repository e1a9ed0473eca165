"""Integrity of the localizer on synthetic drives with sensor faults: misleading time, availability, detection.

    ./headland benchmark localization_robustness [--seeds N] [--first-seed K] [--only REGEX] [--sets open lidar]
                                                 [--seconds S] [--out FOLDER]

Misleading: the horizontal error exceeds L while the protection level is at most L. Each row of the table is a case and
a sensor set, all seeds together; rows of single drives are appended to FOLDER/rows.jsonl, and a second call continues.
Drives are those of tests/localization, with true errors drawn around the configuration (GNSS correlated over 200 s).
`open`: GNSS, IMU, wheels. `lidar`: also lidar odometry, as a model of its errors.
"""

import argparse
import math
import re
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.localization_faults import CASES, Case, Draw, edited, lidar_motions
from benchmarks.rows import append_row, rows_of
from tests.localization.harness import Run, run
from tests.localization.synthetic_drive import START_NS, SensorErrors, Truth, drive

LIMITS_M = (0.10, 0.25, 0.30, 0.50)
SETTLED_S, RECOVERY_S, POSE_S = 10.0, 5.0, 0.1
# faults that say the position is in doubt; others are notes
DOUBT = ("gnss.", "localization.", "imu.", "wheel.", "imu_or_wheel.")
SETS = ("open", "lidar")


@dataclass(frozen=True)
class Row:
    """Result of one drive; times in seconds, lengths in metres.

    `misleading_s` and `available` are by `LIMITS_M`; `available` is the share of the time after `SETTLED_S` (clean) or
    of that during the fault; `after` the same after the fault and `RECOVERY_S`. `detect_s`: from the begin of the
    fault to its first alarm, or until the protection level exceeds 0.5 m. `false_alarms`: before the fault.
    """

    case: str
    sensors: str
    seed: int
    driven_s: float
    misleading_s: list[float]
    available: list[float]
    after: list[float]
    max_error_m: float
    max_excess_m: float
    p95_error_m: float
    level_m: float
    detect_s: float | None
    alarms: list[str]
    false_alarms: int
    start_s: float | None
    nees: float
    cpu_share: float


def sensor_errors(seed: int) -> SensorErrors:
    """True errors of one drive, drawn around what the localizer is configured for."""
    rng = np.random.default_rng([seed, 20])
    return SensorErrors(
        seed=seed, slip=float(rng.uniform(0.0, 0.06)), slip_swing=float(rng.uniform(0.0, 0.01)),
        slip_per_force=float(rng.uniform(0.1, 0.4)), drift=float(rng.uniform(-0.008, 0.008)),
        slip_angle_per_force=float(rng.uniform(0.1, 0.3)), soil_side=float(rng.uniform(0.001, 0.003)),
        steering_offset_rad=math.radians(float(rng.uniform(-0.5, 0.5))), gnss_slow_s=200.0,
        furrow_m=float(rng.uniform(0.0, 0.015)),
    )  # fmt: skip


def drawn_drive(case: Case, seed: int, seconds: float) -> Truth:
    """Standstill and swaths with half turns; or in motion from the first moment."""
    errors = sensor_errors(seed)
    if case.legs == "moving":
        return drive(seconds, legs=[(25.0, 2.0, 0.0), (12.0, 1.6, 1 / 6.0), (seconds, 2.78, 0.0)], sensor_errors=errors)
    return drive(seconds, sensor_errors=errors)


def measured(case: Case, sensors: str, seed: int, seconds: float) -> Row:
    """One drive."""
    truth, draw = drawn_drive(case, seed, seconds), Draw(seed)
    messages = edited(truth, case, draw)
    if sensors == "lidar":
        messages = sorted(messages + lidar_motions(truth, seed, seconds), key=lambda m: m[0])
    began = time.thread_time()
    try:
        result = run(messages)
    except RuntimeError as error:  # the node stops for good, and the machine with it
        nothing = [math.nan] * len(LIMITS_M)
        return Row(
            case.name, sensors, seed, seconds, [0.0] * len(LIMITS_M), nothing, nothing, 0.0, -math.inf, math.nan,
            math.nan, None, [f"crash:{type(error).__name__}"], 0, None, math.nan, 0.0,
        )  # fmt: skip
    cpu_share = (time.thread_time() - began) / seconds
    return judged(case, sensors, seed, result, truth, draw, cpu_share)


def judged(case: Case, sensors: str, seed: int, result: Run, truth: Truth, draw: Draw, cpu_share: float) -> Row:
    """Compares the poses with the truth."""
    poses = [p for p in result.poses if p.is_initialized]
    t_s = np.array([(p.stamp_ns - START_NS) * 1e-9 for p in poses])
    gap_m = np.array([(p.T_map_base - truth.at(p.stamp_ns))[:2, 3] for p in poses]).reshape(-1, 2)
    error_m = np.linalg.norm(gap_m, axis=1)
    level_m = np.array([p.protection_level_m for p in poses])
    nees = [_nees(p.T_map_base, p.covariance, e) for p, e in zip(poses, gap_m, strict=True)]
    start_s, end_s = case.window_s(draw)
    during = (t_s >= SETTLED_S) if case.is_clean else (t_s >= max(start_s, SETTLED_S)) & (t_s < end_s)
    alarms = [(round((f.stamp_ns - START_NS) * 1e-9, 2), f.code) for f in result.faults if f.is_active]
    doubts = [(s, code) for s, code in alarms if code.startswith(DOUBT) and s >= SETTLED_S]
    false = [code for s, code in doubts if case.is_clean or s < start_s]
    true = [s for s, _ in doubts if s >= start_s] + t_s[(t_s >= start_s) & (level_m > 0.5)].tolist()
    return Row(
        case.name, sensors, seed, float(len(truth.T_map_base) * 0.002),
        [float(POSE_S * np.sum((error_m > limit) & (level_m <= limit))) for limit in LIMITS_M],
        _shares(level_m[during]), _shares(level_m[t_s >= end_s + RECOVERY_S]),
        float(np.max(error_m, initial=0.0)), float(np.max(error_m - level_m, initial=-math.inf)),
        float(np.percentile(error_m[during], 95)) if np.any(during) else math.nan,
        float(np.percentile(level_m[during], 99)) if np.any(during) else math.nan,
        None if case.is_clean or not true else max(0.0, min(true) - start_s),
        sorted({code for _, code in alarms}), len(false), float(t_s[0]) if len(t_s) else None,
        float(np.mean(np.array(nees)[during])) if np.any(during) else math.nan, cpu_share,
    )  # fmt: skip


def _nees(T: np.ndarray, covariance: np.ndarray, gap_m: np.ndarray) -> float:
    R = T[:3, :3]
    flat = (R @ covariance[3:, 3:] @ R.T)[:2, :2]
    return float(gap_m @ np.linalg.solve(flat, gap_m) / 2.0)


def _shares(level_m: np.ndarray) -> list[float]:
    return [float(np.mean(level_m <= limit)) if len(level_m) else math.nan for limit in LIMITS_M]


def table(rows: list[Row]) -> str:
    """Markdown table by case and sensor set."""
    limits = ", ".join(f"{limit:.2f}" for limit in LIMITS_M)
    lines = [
        f"| case | sensors | drives | misleading s at L = {limits} m | worst error m | worst error - PL m "
        "| PL ≤ 0.30 m % | after % | NEES | detected after s | false alarms | alarms |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        for sensors in SETS:
            found = [r for r in rows if r.case == case.name and r.sensors == sensors]
            if found:
                lines.append(_line(case, sensors, found))
    total = [sum(r.misleading_s[k] for r in rows) for k in range(len(LIMITS_M))]
    hours = sum(r.driven_s for r in rows) / 3600.0
    cpu = 100.0 * float(np.mean([r.cpu_share for r in rows])) if rows else 0.0
    lines.append(
        f"\nTotal: {hours:.2f} h, misleading {', '.join(f'{t:.1f}' for t in total)} s, "
        f"false alarms {sum(r.false_alarms for r in rows)}, processor time {cpu:.1f} % of a core"
    )
    return "\n".join(lines)


def _line(case: Case, sensors: str, rows: list[Row]) -> str:
    misleading = ", ".join(f"{sum(r.misleading_s[k] for r in rows):.1f}" for k in range(len(LIMITS_M)))
    detected = [r.detect_s for r in rows if r.detect_s is not None]
    never = len(rows) - len(detected)
    times = f"{np.median(detected):.1f} (max {max(detected):.1f})" if detected else "—"
    detect = "—" if case.is_clean else times + (f", {never} never" if never else "")
    started = [r for r in rows if r.start_s is not None]
    note = "" if len(started) == len(rows) else f" (no start: {len(rows) - len(started)})"
    cells = (
        case.name + note, sensors, str(len(rows)), misleading, f"{max(r.max_error_m for r in rows):.2f}",
        f"{max(r.max_excess_m for r in rows):.2f}", _percent([r.available[2] for r in rows]),
        _percent([r.after[2] for r in rows]), _mean([r.nees for r in rows]), detect,
        str(sum(r.false_alarms for r in rows)), " ".join(sorted({a for r in rows for a in r.alarms})) or "—",
    )  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def _mean(values: list[float]) -> str:
    known = [v for v in values if math.isfinite(v)]
    return f"{np.mean(known):.1f}" if known else "—"


def _percent(shares: list[float]) -> str:
    known = [s for s in shares if math.isfinite(s)]
    return f"{100.0 * np.mean(known):.0f}" if known else "—"


def main() -> None:
    """Runs what is missing and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=110.0)
    parser.add_argument("--only", type=re.compile, default=re.compile(""))
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--out", type=Path, default=Path("runs/localization_robustness"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "rows.jsonl"
    rows = rows_of(file, Row)
    done = {(r.case, r.sensors, r.seed) for r in rows}
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        for case in CASES:
            for sensors in arguments.sets:
                if arguments.only.search(case.name) and (case.name, sensors, seed) not in done:
                    rows.append(measured(case, sensors, seed, arguments.seconds))
                    append_row(file, rows[-1])
    print(table(rows))


if __name__ == "__main__":
    main()
