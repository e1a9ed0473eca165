"""Findings on the first forty KITTI frames with faults in labels, mounts, rings and times."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from configs.vehicle import outlines
from messages.message import Envelope
from runtime.replay.prepare import ReplayInput, load_configuration, prepare
from runtime.replay.replay import delivered
from tests.recordings import DATA, needs
from tests.validation.obstacle_stop.consistency.changes import (
    Change,
    late_scans,
    late_truth,
    moved_labels,
    unchanged,
    without_rings,
)
from tests.validation.obstacle_stop.consistency.world import blocking
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.consistency.finding import Finding
from validation.obstacle_stop.consistency.observer import ConsistencyObserver

CONDITIONS = load_conditions(None)
pytestmark = [needs("kitti-seq-pcd", "kitti-tracking-truth"), pytest.mark.slow]


@cache
def log() -> tuple[ReplayInput, list[Envelope]]:
    """Inputs of the replay as delivered."""
    prepared = prepare(
        DATA / "kitti-seq-pcd", DATA / "kitti-tracking-truth", None, load_configuration(CONDITIONS)
    )  # fmt: skip
    return prepared, [Envelope(topic, 0, ns, message) for ns, topic, message in delivered(prepared)]


def findings(change: Change = unchanged, **mount: tuple[float, float, float]) -> tuple[Finding, ...]:
    """Findings after a change of the messages, or with another mount in the vehicle file."""
    prepared, envelopes = log()
    lidar = prepared.machine.vehicle.sensors.lidar["velodyne"]
    lidar = lidar.model_copy(update={"mount": lidar.mount.model_copy(update=mount)})
    setting = replace(prepared.setting("kitti"), T_base_lidar={"velodyne": lidar.mount.T_base_sensor})
    bodies = outlines(prepared.machine.vehicle.body, None)
    observer = ConsistencyObserver(setting, {"velodyne": lidar}, bodies, True, CONDITIONS)
    changed = [c for e in envelopes if (c := change(e)) is not None]
    for envelope in sorted(changed, key=lambda e: e.receive_ns):
        observer(envelope)
    return observer.finish()


def rings(is_kept) -> Change:  # type: ignore[no-untyped-def]
    return without_rings(log()[0].machine.vehicle.sensors.lidar["velodyne"].elevation_deg, is_kept)


def test_recorded_log_has_no_blocking_finding() -> None:
    found = findings()
    assert not blocking(found), found
    assert {f.code for f in found} == {"not_checked", "truth_sector"}


@pytest.mark.parametrize(("x_m", "y_m"), [(2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0), (10.0, 0.0), (-10.0, 0.0)])
def test_labels_out_of_place(x_m: float, y_m: float) -> None:
    (found,) = (f for f in findings(moved_labels(x_m, y_m)) if f.code == "truth_shifted")
    assert found.is_blocking
    assert (found.numbers["shift_x_m"], found.numbers["shift_y_m"]) == pytest.approx((x_m, y_m), abs=0.3)


@pytest.mark.parametrize("by_s", [0.2, -0.2, 2.0, -2.0])
def test_labels_out_of_time(by_s: float) -> None:
    (found,) = (f for f in findings(late_truth(by_s)) if f.code == "truth_shifted")
    assert found.is_blocking
    assert found.numbers["delay_s"] == pytest.approx(by_s, abs=0.15)


def test_scans_late() -> None:
    (found,) = (f for f in findings(late_scans(0.2)) if f.code == "truth_shifted")
    assert found.numbers["delay_s"] == pytest.approx(-0.2, abs=0.15)


@pytest.mark.parametrize("by_deg", [2.0, -2.0])
@pytest.mark.parametrize(("axis", "name"), [(0, "roll"), (1, "pitch"), (2, "yaw")])
def test_mount_turned(axis: int, name: str, by_deg: float) -> None:
    rpy = list(log()[0].machine.vehicle.sensors.lidar["velodyne"].mount.rpy_deg)
    rpy[axis] += by_deg
    (found,) = (f for f in findings(rpy_deg=tuple(rpy)) if f.is_blocking)
    assert found.code == f"mount_{name}"
    assert found.numbers[f"{name}_deg"] == pytest.approx(by_deg, abs=0.7)


@pytest.mark.parametrize("by_m", [0.3, -0.3])
def test_mount_too_high_or_low(by_m: float) -> None:
    x, y, z = log()[0].machine.vehicle.sensors.lidar["velodyne"].mount.xyz_m
    (found,) = (f for f in findings(xyz_m=(x, y, z + by_m)) if f.is_blocking)
    assert found.code == "mount_height"
    assert found.numbers["height_m"] == pytest.approx(by_m, abs=0.08)


@pytest.mark.parametrize("kept", ["every other", "upper half", "lower half"])
def test_half_the_rings(kept: str) -> None:
    is_kept = {
        "every other": lambda ring: ring % 2 == 0, "upper half": lambda ring: ring >= 32,
        "lower half": lambda ring: ring < 32,
    }[kept]  # fmt: skip
    assert "rings_missing" in blocking(findings(rings(is_kept)))


def test_label_without_returns_is_no_finding() -> None:
    def change(envelope: Envelope) -> Envelope:
        truth = envelope.message
        if envelope.topic != "truth_objects/velodyne":
            return envelope
        ghost = replace(truth.objects[0], id=99, center_map_m=np.array([10.0, 0.0, -0.8]), size_m=np.array([0.6] * 3))
        return replace(envelope, message=replace(truth, objects=(*truth.objects, ghost)))

    assert not blocking(findings(change))
