"""Logs for which `validate` once returned *passed*; none of them may, and each has its true reason."""

import re

import pytest
import yaml

import runtime.replay.prepare
from messages.sensors import LidarScan
from runtime.stack import load_stack
from tests.replay import recorded_drive
from tests.replay.test_odd_logs import write_bag
from tests.validation.attacks.attack import DRIVE, PERSON, Attack, blind, mounted, person
from tests.validation.attacks.damages import cloud, delivered_late, each
from tests.validation.attacks.recorded import Bench, drive, reasons, standing
from tests.validation.obstacle_stop.consistency.changes import late_truth, moved_labels

IN_LIDAR = drive(PERSON, truth_in_map=False)
CASES: dict[str, Attack] = {
    "person without returns": Attack("failed", "encounter 9: missed", drive(person(blind))),
    "first returns at 3.6 m and 6 m/s": Attack(
        "failed", "encounter 9: late",
        drive(standing(9, 20.0, 0.2, has_returns=lambda t: 20.0 - 0.3 - 3.6 - 6.0 * t < 3.6), speed_mps=6.0),
    ),
    "brake request of 0.1 s": Attack("failed", "encounter 9: late", drive(person(lambda t: 0.9 <= t < 1.1))),
    "machine that never moves": Attack(
        "not_shown", r"no_motion: .*moved by 0\.0 m", drive(standing(9, 8.0, 0.2), speed_mps=0.0)
    ),
    "labels 10 m ahead": Attack("not_shown", r"truth_shifted: .*\+10\.00 m", change=each(moved_labels(10.0, 0.0))),
    "labels 10 m ahead in the frame of the lidar": Attack(
        "not_shown", r"truth_shifted: .*\+10\.00 m", IN_LIDAR, each(moved_labels(10.0, 0.0))
    ),
    "labels 2 s late": Attack("not_shown", r"truth_shifted: .*2\.0 s late", change=each(late_truth(2.0))),
    "labels 2 s late in the frame of the lidar": Attack(
        "not_shown", r"truth_shifted: .*2\.0 s late", IN_LIDAR, each(late_truth(2.0))
    ),
    "dust before the bumper in every scan": Attack(
        "failed", "false stop: protective_field", change=cloud((3.4, 0.0, -1.2), 0.2, 60)
    ),
    "scans delivered 1.5 s late": Attack(
        "failed", "encounter 9: (late|missed)", change=delivered_late(LidarScan, 1.5)
    ),
    "reverse onto a person without returns": Attack(
        "failed", "encounter 9: missed", drive(standing(9, -10.0, 0.2, has_returns=blind), speed_mps=-3.0)
    ),
    **{
        f"{name} of the mount {by:+g}": Attack(state, f"{code}: .*{text}", mounted(axis, by, is_angle))
        for name, axis, is_angle, by, state, code, text in (
            ("roll", 0, True, 2.0, "not_shown", "mount_roll", r"\+(1\.[89]|2\.\d)°"),
            ("roll", 0, True, -2.0, "not_shown", "mount_roll", r"-(1\.[89]|2\.\d)°"),
            ("pitch", 1, True, 2.0, "not_shown", "mount_pitch", r"\+(1\.[89]|2\.\d)°"),
            ("pitch", 1, True, -2.0, "not_shown", "mount_pitch", r"-(1\.[89]|2\.\d)°"),
            ("yaw", 2, True, 2.0, "not_shown", "mount_yaw", r"\+(1\.[89]|2\.\d)°"),
            ("yaw", 2, True, -2.0, "not_shown", "mount_yaw", r"-(1\.[89]|2\.\d)°"),
            ("place along", 0, False, 0.5, "not_shown", "truth_shifted", r"-0\.\d+ m and"),
            ("place along", 0, False, -0.5, "not_shown", "truth_shifted", r"\+0\.\d+ m and"),
            ("place across", 1, False, 0.5, "not_shown", "truth_shifted", r"and -0\.\d+ m"),
            ("place across", 1, False, -0.5, "not_shown", "truth_shifted", r"and \+0\.\d+ m"),
            ("height", 2, False, 0.5, "failed", "mount_height", r"\+0\.\d+ m"),
            ("height", 2, False, -0.5, "not_shown", "mount_height", r"-0\.\d+ m"),
        )
    },
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_log_does_not_pass(bench: Bench, name: str) -> None:
    CASES[name].check(bench)


def test_outputs_delivered_late(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same stack on a computer that takes 1.5 s for a step of the supervisor."""
    stack = load_stack()
    slow = stack.executor.latency_ms | {"supervisor": 1500.0}
    executor = stack.executor.model_copy(update={"latency_ms": slow, "cores": 100})
    monkeypatch.setattr(runtime.replay.prepare, "load_stack", lambda: stack.model_copy(update={"executor": executor}))
    result = bench.judge(DRIVE)
    assert result["state"] == "failed"
    assert re.search("encounter 9: (late|missed)", reasons(result))


def test_two_odometries_of_unknown_frames(bench: Bench) -> None:
    """Not replaced by an odometry from the scans; without a choice in the vehicle file the log is refused."""
    log = recorded_drive.drive(bench.folder / "log.mcap", (20.0, 0.3), seconds=2.2)
    bag = write_bag(bench.folder / "bag", log, has_mount=True, frames=("wheels", "visual"))
    result = bench.judge_log(bag, yaml.safe_load(recorded_drive.VEHICLE))
    assert result["state"] == "not_shown"
    assert "no odometry is usable" in result["failed_to_read"][0]["reason"]
