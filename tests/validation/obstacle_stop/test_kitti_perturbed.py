"""The first forty KITTI frames with faults: not shown or failed with the true reason, or the margin as computed.

Each fault is judged by the same conditions as all other logs. Labels and deliveries are changed after one replay; scans
and mounts before a replay of their own.
"""

from dataclasses import replace

import numpy as np
import pytest

from datasets.importers.point_clouds import list_scan
from messages.command import SupervisorState
from messages.message import Envelope
from messages.perception import Obstacles, Tracks
from messages.sensors import LidarScan
from messages.truth import TrueObjects
from tests.validation.obstacle_stop import by_hand
from tests.validation.obstacle_stop.consistency.changes import (
    Change,
    late_scans,
    late_truth,
    moved_labels,
    without_rings,
)
from tests.validation.obstacle_stop.kitti import LIDAR, NEEDED, judged, recorded, replayed

pytestmark = [NEEDED, pytest.mark.slow]
TOLERANCE_M = 0.1


def reason(result: dict, code: str) -> dict:
    """The only blocking finding, of this code; it is the first reason why the log is not shown."""
    (found,) = (f for f in result["findings"] if f["is_blocking"])
    assert found["code"] == code, found
    assert result["state"] == "not_shown"
    assert result["not_shown"][0]["reason"] == found["text"]
    assert result["headline"].startswith(f"not shown: kitti: {found['text']}")
    return found


def margins(result: dict) -> dict[int, float]:
    """Margins to van and cyclist of a result that is passed with the cyclist as the only trial."""
    assert result["state"] == "passed", result["headline"]
    assert (result["outcomes"], result["false_stops"]) == ({"in time": 1, "no demand": 1}, 0)
    by_id = {e["id"]: e for e in result["encounters"]}
    return {0: by_id[0]["least_margin_m"], 1: by_id[1]["margin_m"]}


@pytest.mark.parametrize(("x_m", "y_m"), [(0.3, 0.0), (-0.3, 0.0), (0.0, 0.3)])
def test_labels_hardly_out_of_place_change_the_margins_as_computed(x_m: float, y_m: float) -> None:
    expected = {0: by_hand.van_margin_m(x_m, y_m), 1: by_hand.cyclist_margin_m(x_m, y_m)}
    assert margins(judged(moved_labels(x_m, y_m))) == pytest.approx(expected, abs=TOLERANCE_M)


@pytest.mark.parametrize("by_s", [0.1, 0.2, 0.4])
def test_late_delivery_of_outputs_changes_the_margin_as_computed(by_s: float) -> None:
    def change(e: Envelope) -> Envelope:
        is_output = isinstance(e.message, SupervisorState | Obstacles | Tracks)
        return replace(e, receive_ns=e.receive_ns + round(by_s * 1e9)) if is_output else e

    expected = by_hand.cyclist_margin_m(late_s=by_s)
    assert margins(judged(change))[1] == pytest.approx(expected, abs=TOLERANCE_M)


def test_late_delivery_of_scans_changes_the_margin_as_computed() -> None:
    def change(e: Envelope) -> Envelope:
        return replace(e, receive_ns=e.receive_ns + 200_000_000) if isinstance(e.message, LidarScan) else e

    expected = by_hand.cyclist_margin_m(late_s=0.2)
    assert margins(replayed(change))[1] == pytest.approx(expected, abs=TOLERANCE_M)


@pytest.mark.parametrize(
    ("x_m", "y_m"), [(a * s, b * s) for a, b in ((1, 0), (0, 1)) for s in (2.0, -2.0, 10.0, -10.0)]
)
def test_labels_out_of_place(x_m: float, y_m: float) -> None:
    found = reason(judged(moved_labels(x_m, y_m)), "truth_shifted")
    assert (found["numbers"]["shift_x_m"], found["numbers"]["shift_y_m"]) == pytest.approx((x_m, y_m), abs=0.3)
    assert "out of place" in found["text"]


@pytest.mark.parametrize("only", [0, 1], ids=["van", "cyclist"])
def test_label_of_one_moving_object_out_of_place(only: int) -> None:
    def change(envelope: Envelope) -> Envelope | None:
        truth = envelope.message
        if isinstance(truth, TrueObjects):
            kept = tuple(o for o in truth.objects if o.id == only)
            envelope = replace(envelope, message=replace(truth, objects=kept))
        return move(envelope)

    move = moved_labels(0.0, 2.0)
    found = reason(judged(change), "truth_shifted")
    assert (found["numbers"]["shift_x_m"], found["numbers"]["shift_y_m"]) == pytest.approx((0.0, 2.0), abs=0.3)


@pytest.mark.parametrize("by_s", [0.2, -0.2])
def test_labels_out_of_time(by_s: float) -> None:
    found = reason(judged(late_truth(by_s)), "truth_shifted")
    assert found["numbers"]["delay_s"] == pytest.approx(by_s, abs=0.11)
    assert f"s {'late' if by_s > 0 else 'early'} against the scans" in found["text"]


@pytest.mark.parametrize("by_s", [2.0, -2.0])
def test_labels_far_out_of_time_miss_half_of_the_log(by_s: float) -> None:
    result = judged(late_truth(by_s))
    shifted, missing = (f for f in result["findings"] if f["is_blocking"])
    assert (shifted["code"], missing["code"], result["state"]) == ("truth_shifted", "truth_missing", "not_shown")
    assert shifted["numbers"]["delay_s"] == pytest.approx(by_s, abs=0.15)
    assert missing["numbers"]["missing_share"] == pytest.approx(0.5, abs=0.05)
    assert result["not_shown"][0]["reason"] == shifted["text"]


def test_scans_with_late_stamps_make_the_truth_early() -> None:
    found = reason(replayed(late_scans(0.2)), "truth_shifted")
    assert found["numbers"]["delay_s"] == pytest.approx(-0.2, abs=0.11)
    assert "early against the scans" in found["text"]


@pytest.mark.parametrize("by_deg", [2.0, -2.0])
@pytest.mark.parametrize(("axis", "name"), [(0, "roll"), (1, "pitch"), (2, "yaw")])
def test_mount_turned(axis: int, name: str, by_deg: float) -> None:
    rpy = list(recorded().machine.vehicle.sensors.lidar[LIDAR].mount.rpy_deg)
    rpy[axis] += by_deg
    found = reason(replayed(rpy_deg=tuple(rpy)), f"mount_{name}")
    assert found["numbers"][f"{name}_deg"] == pytest.approx(by_deg, abs=0.7)


def second_part(envelope: Envelope) -> Envelope | None:
    """The last 2.5 s of the log."""
    start_ns = recorded().inspection.first_ns or 0
    return envelope if envelope.message.stamp_ns >= start_ns + 1_450_000_000 else None


@pytest.mark.parametrize(("axis", "name", "by_deg"), [(1, "pitch", 2.0), (2, "yaw", -2.0)])
def test_mount_turned_in_a_short_log(axis: int, name: str, by_deg: float) -> None:
    rpy = list(recorded().machine.vehicle.sensors.lidar[LIDAR].mount.rpy_deg)
    rpy[axis] += by_deg
    reason(replayed(second_part, rpy_deg=tuple(rpy)), f"mount_{name}")


def test_short_log_is_passed() -> None:
    assert margins(replayed(second_part))[1] > 0.0


@pytest.mark.parametrize("by_m", [0.3, -0.3])
def test_mount_too_high_or_low(by_m: float) -> None:
    x, y, z = recorded().machine.vehicle.sensors.lidar[LIDAR].mount.xyz_m
    found = reason(replayed(xyz_m=(x, y, z + by_m)), "mount_height")
    assert found["numbers"]["height_m"] == pytest.approx(by_m, abs=0.08)


def test_every_other_ring_missing() -> None:
    found = reason(replayed(rings(lambda ring: ring % 2 == 0)), "rings_missing")
    assert "50 % of the beams" in found["text"]


@pytest.mark.parametrize("half", [lambda ring: ring >= 32, lambda ring: ring < 32], ids=["lower", "upper"])
def test_half_of_the_field_of_view_missing(half) -> None:  # type: ignore[no-untyped-def]
    result = replayed(rings(half))
    assert result["state"] != "passed"  # with the upper half alone an animal that is none stops the machine
    assert "rings_missing" in {f["code"] for f in result["findings"] if f["is_blocking"]}


def rings(is_kept) -> Change:  # type: ignore[no-untyped-def]
    return without_rings(recorded().machine.vehicle.sensors.lidar[LIDAR].elevation_deg, is_kept)


def dust(low_m: tuple[float, float, float], high_m: tuple[float, float, float]) -> Change:
    """Scans with 300 returns in a box in base, others in every frame."""
    T = recorded().machine.vehicle.sensors.lidar[LIDAR].mount.T_base_sensor
    rng = np.random.default_rng(0)

    def change(envelope: Envelope) -> Envelope:
        scan = envelope.message
        if not isinstance(scan, LidarScan):
            return envelope
        cloud = (rng.uniform(low_m, high_m, (300, 3)) - T[:3, 3]) @ T[:3, :3]
        points = np.vstack([scan.points_m, cloud.astype(np.float32)])
        return replace(envelope, message=list_scan(scan.stamp_ns, points))

    return change


def board(envelope: Envelope) -> Envelope:
    """A scan with returns on an upright board of 1 m before the bumper."""
    scan = envelope.message
    if not isinstance(scan, LidarScan):
        return envelope
    T = recorded().machine.vehicle.sensors.lidar[LIDAR].mount.T_base_sensor
    y, z = np.meshgrid(np.arange(-0.5, 0.5, 0.03), np.arange(0.3, 1.3, 0.03))
    cloud = (np.column_stack([np.full(y.size, 4.4), y.ravel(), z.ravel()]) - T[:3, 3]) @ T[:3, :3]
    points = np.vstack([scan.points_m, cloud.astype(np.float32)])
    return replace(envelope, message=list_scan(scan.stamp_ns, points))


def test_what_nobody_knows_before_the_bumper_counts_as_a_false_stop() -> None:
    result = replayed(board)
    (stop,) = (s for s in result["stops"] if s["is_false"])
    assert (result["state"], result["false_stops"]) == ("failed", 1)
    assert result["false_stop_scans"]["count"] >= 38
    assert stop["reason"] == "protective_field"
    assert stop["objects"] == []
    assert stop["t_s"] < 0.5
    assert stop["until_s"] > 3.8
    assert "1 false stops" in result["headline"]


def test_dust_before_the_bumper_is_no_false_stop() -> None:
    result = replayed(dust((3.9, -1.0, 0.3), (4.9, 1.0, 1.5)))
    assert (result["state"], result["false_stops"]) == ("passed", 0)
    assert result["false_stop_scans"]["count"] == 0


def test_dust_beside_the_path_is_no_false_stop() -> None:
    assert margins(replayed(dust((3.9, 5.0, 0.3), (4.9, 7.0, 1.5))))[1] > 0.0


def test_object_without_returns_in_the_bend_ahead_is_missed_and_no_fault_of_the_truth() -> None:
    def change(envelope: Envelope) -> Envelope:
        truth = envelope.message
        if not isinstance(truth, TrueObjects):
            return envelope
        ghost = replace(truth.objects[0], id=99, center_map_m=np.array([10.0, 1.7, -0.8]), size_m=np.array([0.6] * 3))
        return replace(envelope, message=replace(truth, objects=(*truth.objects, ghost)))

    result = judged(change)
    assert not [f for f in result["findings"] if f["is_blocking"]]
    assert (result["state"], result["missed"]) == ("failed", 1)
