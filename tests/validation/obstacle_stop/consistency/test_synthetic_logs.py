"""Rates of findings on synthetic logs: none on clean ones, most of the perturbed ones."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from messages.message import Envelope
from messages.motion import Odometry
from messages.sensors import LidarScan, WheelSample
from messages.truth import TrueMachine, TrueObjects
from tests.validation.obstacle_stop.consistency.changes import (
    Change,
    between,
    late_scans,
    late_truth,
    moved_labels,
    scaled_odometry,
    unchanged,
    without_rings,
)
from tests.validation.obstacle_stop.consistency.world import START_NS, Drive, blocking

X, Y, Z = 1.0, 0.0, 1.9
TRUTH = (TrueObjects, TrueMachine)


def clean(seed: int) -> Drive:
    """A clean log: beams, curves, slopes, bumps, structure, speeds and frame of the truth vary."""
    rng = np.random.default_rng(seed)
    return Drive(
        seed, beams=(16, 32, 64)[seed % 3], columns=(600, 400, 360)[seed % 3],
        curvature_radpm=float(rng.choice([0.0, 0.03, -0.05])), slope=float(rng.choice([0.0, 0.05, -0.05])),
        bump_deg=float(rng.choice([0.0, 0.5, 1.5])), has_structure=bool(rng.random() < 0.7),
        truth_in_map=bool(rng.random() < 0.5), speed_wave=float(rng.choice([0.0, 0.4])),
        turn_wave=float(rng.choice([0.0, 0.1])), speed_mps=float(rng.choice([1.2, 3.0, 6.0])),
    )  # fmt: skip


PORTIONS = [pytest.param(range(k, k + 12), marks=pytest.mark.slow, id=f"{k} to {k + 11}") for k in range(3, 63, 12)]


@pytest.mark.parametrize("seeds", [pytest.param(range(3), id="0 to 2"), *PORTIONS])
def test_clean_logs_have_no_blocking_finding(seeds: range) -> None:
    found = {seed: blocking(clean(seed).findings()) for seed in seeds}
    false = {seed: codes for seed, codes in found.items() if codes}
    assert not false, f"{len(false)} of {len(found)} clean logs: {false}"


def drive(seed: int, **values: object) -> Drive:
    """A log with structure; every other one with varying speed and yaw rate."""
    is_varied = seed % 2 == 1
    return Drive(
        seed, curvature_radpm=0.03 * is_varied, turn_wave=0.15 * is_varied, speed_wave=0.4 * is_varied,
        truth_in_map=seed % 4 < 2, **values,
    )  # fmt: skip


def mount(axis: int, by: float, is_angle: bool) -> dict[str, object]:
    """Configured mount with one value wrong."""
    xyz, rpy = [X, Y, Z], [0.0, 0.0, 0.0]
    (rpy if is_angle else xyz)[axis] += by
    return {"configured": (tuple(xyz), tuple(rpy))}


HALF = without_rings(Drive(0).lidar().elevation_deg, lambda ring: ring % 2 == 0)
# name → change, values of the drive, codes of which one must be found, least number of six logs
PERTURBED: dict[str, tuple[Change, dict[str, object], set[str], int]] = {
    "labels 10 m ahead": (moved_labels(10.0, 0.0), {}, {"truth_shifted"}, 3),
    "labels 2 m aside": (moved_labels(0.0, 2.0), {}, {"truth_shifted"}, 5),
    "truth 0.2 s late": (late_truth(0.2), {}, {"truth_shifted"}, 4),
    "truth 2 s late": (late_truth(2.0), {}, {"truth_shifted", "truth_missing"}, 6),
    "truth 2 s early": (late_truth(-2.0), {}, {"truth_shifted", "truth_missing"}, 6),
    "scans 0.2 s late": (late_scans(0.2), {}, {"truth_shifted", "time_offset"}, 5),
    "half the rings": (HALF, {}, {"rings_missing"}, 6),
    "odometry + 30 %": (scaled_odometry(1.3), {}, {"odometry_contradicts_scans"}, 5),
    "odometry without motion": (scaled_odometry(0.0), {}, {"no_motion", "odometry_contradicts_scans"}, 6),
    "scans missing at the end": (between(LidarScan, 5.0, 9.0, START_NS), {}, {"scans_missing"}, 6),
    "scans missing for 3 s": (between(LidarScan, 2.0, 5.0, START_NS), {}, {"scans_missing"}, 6),
    "odometry missing for 3 s": (between(Odometry, 2.0, 5.0, START_NS), {}, {"odometry_missing"}, 6),
    "truth missing for 3 s": (between(TRUTH, 2.0, 5.0, START_NS), {}, {"truth_missing"}, 6),
    **{
        f"{name} {by:+g}": (unchanged, mount(axis, by, is_angle), codes, least)
        for name, axis, size, is_angle, codes, least in (
            ("roll", 0, 2.0, True, {"mount_roll"}, 5),
            ("pitch", 1, 2.0, True, {"mount_pitch"}, 5),
            ("yaw", 2, 2.0, True, {"mount_yaw"}, 5),
            ("height", 2, 0.3, False, {"mount_height"}, 6),
            ("across", 1, 0.5, False, {"mount_lateral", "truth_shifted"}, 2),
        )
        for by in (size, -size)
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PERTURBED)
def test_perturbed_logs_are_found(name: str) -> None:
    change, values, codes, least = PERTURBED[name]
    found = [blocking(drive(seed, **values).findings(change)) for seed in range(6)]
    hits = sum(bool(codes & f) for f in found)
    assert hits >= least, f"{name}: {hits} of 6; findings {dict(Counter(c for f in found for c in f))}"


@pytest.mark.slow
@pytest.mark.parametrize("invisible", [(0,), (0, 1), (0, 1, 2, 3, 4)])
def test_objects_without_returns_are_not_excused(invisible: tuple[int, ...]) -> None:
    found = [blocking(drive(seed, invisible=invisible).findings()) for seed in range(8)]
    assert not any(found), f"{sum(map(bool, found))} of 8: {found}"


def test_odometry_from_scans_without_structure_is_degenerate() -> None:
    assert "odometry_degenerate" in blocking(Drive(1, has_structure=False, objects=0).findings(is_from_scans=True))


@pytest.mark.parametrize(("kept", "codes"), [
    ((), {"no_motion", "odometry_missing", "too_few_scans"}),
    ((LidarScan,), {"no_motion", "odometry_missing", "odometry_contradicts_scans"}),
    ((Odometry,), {"too_few_scans", "speed_unconfirmed"}),
    (TRUTH, {"no_motion", "odometry_missing", "too_few_scans"}),
], ids=["nothing", "scans", "odometry", "truth"])  # fmt: skip
def test_logs_with_one_kind_of_message(kept: tuple[type, ...], codes: set[str]) -> None:
    found = blocking(Drive(0, objects=0).findings(lambda e: e if isinstance(e.message, kept) else None))
    assert found <= codes | {"truth_missing"}
    assert {"too_few_scans", "no_motion"} & found


def test_wheel_speed_against_odometry_and_scans() -> None:
    def change(envelope: Envelope) -> Envelope:
        wheel = envelope.message
        if not isinstance(wheel, WheelSample):
            return envelope
        return replace(envelope, message=replace(wheel, speed_mps=0.5 * wheel.speed_mps))

    (found,) = (f for f in drive(0).findings(change) if f.code == "odometry_contradicted")
    assert not found.is_blocking
    assert "the scans support the first" in found.text
    assert found.numbers["other_speed_mps"] == pytest.approx(1.5, abs=0.1)
    (found,) = (
        f for f in drive(0, has_structure=False, objects=0).findings(change) if f.code == "odometry_contradicted"
    )
    assert found.is_blocking
