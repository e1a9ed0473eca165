"""Setup of the machine: versions in SQLite, drafts that stay valid, and what a drive takes from a version."""

import asyncio
import os
import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from configs.machine_setup import MachineSetup, leaves, setup_from_json, with_values
from hmi.calibration_view.desk import CalibrationDesk
from hmi.plan_view.mission_store import MISSION
from hmi.plan_view.options import read_mission
from hmi.refusal import Refused
from hmi.setup_view.desk import SetupDesk
from hmi.setup_view.settings import SECTIONS, mounts_of, settings_of, shown_text, unit_of, value_from
from hmi.setup_view.store import FILES, SetupStore
from messages.errors import ConfigError, HeadlandError
from messages.sensors import WheelSample
from runtime.assembly import plant_of
from runtime.machine_setup import configured_setup, running_setup
from runtime.run_folder import resolved
from runtime.setup import load_scenario, load_setup
from tests.hmi.drive_messages import NOW_NS, demo_scene
from tests.hmi.planned import desk_in
from tests.hmi.test_page_app import GivenFeed
from tests.recordings import ROOT

RADIUS, ZERO = "vehicle.drivetrain.wheel_radius_m", "vehicle.sensors.wheels.angle_zero_deg"
PITCH = "vehicle.sensors.lidar.front.mount.rpy_deg.1"


@pytest.fixture(scope="module")
def configured() -> MachineSetup:
    return configured_setup("line", None, None)


@pytest.fixture
def desk(tmp_path: Path, configured: MachineSetup) -> SetupDesk:
    store = SetupStore(tmp_path / "setup.db")
    number, setup = store.newest(configured)
    return SetupDesk(store, setup, number)


def test_text_of_a_setup_is_read_back(configured: MachineSetup) -> None:
    assert setup_from_json(configured.to_json(), "test") == configured
    for text in ("", "[]", "{}", configured.to_json()[:-1]):
        with pytest.raises(ConfigError, match=r"^test: "):
            setup_from_json(text, "test")


@pytest.mark.parametrize(("key", "value"), [
    (RADIUS, -1.0), (RADIUS, float("nan")), (RADIUS, "x"), ("vehicle.drivetrain", 1.0), ("vehicle.wings", 1.0),
    ("vehicle.sensors.lidar.front.mount.rpy_deg.3", 0.0), ("implement.working_width_m", 7.0), ("", 1.0),
])  # fmt: skip
def test_a_bad_value_is_refused_by_name(configured: MachineSetup, key: str, value: object) -> None:
    with pytest.raises(ConfigError) as found:
        with_values(configured, {key: value})
    assert key.rpartition(".")[2][:5] in str(found.value) or "working_width_m" in str(found.value)


def test_each_value_of_the_page_is_in_one_section_and_can_be_entered_again(configured: MachineSetup) -> None:
    shown = {key: value for one in SECTIONS for key, value in settings_of(configured, one).items()}
    shown |= {key: value for axes in mounts_of(configured).values() for key, value in axes}
    assert len(shown) > 120
    for key, value in shown.items():
        assert value_from(key, shown_text(value), value) == value
    assert [unit_of(key) for key in (RADIUS, ZERO, "vehicle.acceleration_mps2", PITCH)] == ["m", "°", "m/s²", "°"]


def test_versions_are_numbered_with_author_and_time(desk: SetupDesk) -> None:
    desk.edit(RADIUS, "0.83")
    assert desk.changes == {RADIUS: (0.82, 0.83)}
    assert desk.keep("anna", "") == 2
    desk.edit(ZERO, "0,5")
    assert desk.keep("bo", "zero") == 3
    found = [(one.number, one.author, one.note) for one in desk.versions]
    assert found == [(3, "bo", "zero"), (2, "anna", RADIUS), (1, FILES, "")]
    assert leaves(desk.store.setup(desk.machine, 2))[ZERO] == 0.0


def test_nothing_changed_is_no_version(desk: SetupDesk) -> None:
    with pytest.raises(Refused, match="no_change"):
        desk.keep("anna", "")
    desk.edit(RADIUS, "0.83")
    desk.edit(RADIUS, "0.82")
    with pytest.raises(Refused, match="no_change"):
        desk.keep("anna", "")
    with pytest.raises(Refused, match="no_setting"):
        desk.edit("vehicle.name", "x")


def test_an_old_version_is_restored_as_a_new_one(desk: SetupDesk) -> None:
    desk.edit(RADIUS, "0.83")
    desk.keep("anna", "")
    desk.open(1)
    assert desk.keep("anna", "") == 3
    assert desk.store.setup(desk.machine, 3) == desk.store.setup(desk.machine, 1)


def test_calibrated_values_leave_a_draft_out(desk: SetupDesk) -> None:
    desk.edit(RADIUS, "0.9")
    desk.put_calibrated({PITCH: 0.3}, "anna", "lidar")
    found = leaves(desk.store.setup(desk.machine, 2))
    assert (found[RADIUS], found[PITCH]) == (0.82, 0.3)


def test_a_changed_file_is_a_version_and_an_unchanged_one_is_not(tmp_path: Path, configured: MachineSetup) -> None:
    store = SetupStore(tmp_path / "setup.db")
    assert [store.newest(configured)[0] for _ in range(2)] == [1, 1]
    store.put(with_values(configured, {RADIUS: 0.83}), "anna", "")
    assert store.newest(configured)[0] == 2
    changed = with_values(configured, {"vehicle.body.mass_kg": 6000.0})
    assert store.newest(changed) == (3, changed)


def test_a_file_that_is_no_database_is_named(tmp_path: Path) -> None:
    (tmp_path / "setup.db").write_text("x" * 5000)
    with pytest.raises(HeadlandError, match=r"setup\.db"):
        SetupStore(tmp_path / "setup.db")
    with sqlite3.connect(tmp_path / "later.db") as link:
        link.execute("PRAGMA user_version = 9")
    with pytest.raises(HeadlandError, match="version 9"):
        SetupStore(tmp_path / "later.db")


def test_a_drive_takes_the_version_and_its_plant_stays(configured: MachineSetup) -> None:
    """What is calibrated changes what the stack assumes, and what wheel and angle sensors report; nothing true."""
    changes = {
        RADIUS: 0.80,
        ZERO: 0.4,
        PITCH: 1.0,
        "corrections.max_correction_age_s": 7.0,
        "corrections.uses_sbas": False,
    }
    assumed = with_values(configured, changes)
    setups = [load_setup("line", None, None, None, 1, assumed=one) for one in (None, configured, assumed)]
    scenario = load_scenario("empty", setups[0].mission, None, "drawn")
    before, same, after = (plant_of(setup, scenario) for setup in setups)
    assert before == same
    assert after.vehicle.sensors.lidar == before.vehicle.sensors.lidar
    assert setups[2].vehicle.sensors.lidar["front"].mount.rpy_deg == (0.0, 1.0, 0.0)
    errors = [one.models.machine.drive.wheel_radius_error for one in (before, after)]
    assert 0.82 * (1.0 + errors[0]) == pytest.approx(0.80 * (1.0 + errors[1]))
    assert after.vehicle.sensors.wheels is not None
    assert after.vehicle.sensors.wheels.angle_zero_deg == 0.4
    gnss = setups[2].stack.localization.map_alignment.gnss
    assert (gnss.max_correction_age_s, gnss.sbas.is_used, gnss.ppp.is_used) == (7.0, False, True)
    assert setups[1].stack == setups[0].stack


def test_the_setup_of_a_running_machine_is_that_of_its_configuration(configured: MachineSetup) -> None:
    setup = load_setup("line", None, None, None, 1)
    text = resolved(machine=setup.vehicle, implement=setup.implement, stack=setup.stack)
    assert running_setup(text) == configured


def test_new_plans_take_the_work_mode_of_the_newest_version(tmp_path: Path, desk: SetupDesk) -> None:
    plans = desk_in(tmp_path)
    plans.work = desk.work
    desk.edit("work.work_speed_kmh", "7")
    desk.keep("anna", "")
    asyncio.run(plans.load({"a.geojson": b"field"}))
    asyncio.run(plans.make_plan())
    assert plans.draft is not None
    assert read_mission(plans.draft / MISSION)[1].work_speed_kmh == 7.0


@pytest.mark.slow
def test_a_version_that_cannot_be_planned_names_itself_and_the_way_out(
    tmp_path: Path, configured: MachineSetup
) -> None:
    store = SetupStore(tmp_path / "setup.db")
    store.newest(configured)
    store.put(with_values(configured, {"implement.width_m": 40.0}), "anna", "")
    store.close()
    command = [sys.executable, "-m", "runtime", "page", "--mission", "calibration", "--port", "0", "--stop-port", "0"]
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    words = {(): "Version 2 .*--setup-version N begins", ("--setup-version", "9"): "setup 9 of .*: is not stored"}
    for more, message in words.items():
        done = subprocess.run(
            [*command, "--state", str(tmp_path), *more],
            cwd=tmp_path,
            env=env,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 2
        assert re.search(message, done.stderr), done.stderr
        assert "Traceback" not in done.stderr


def test_a_recording_counts_its_way_and_says_what_is_missing(desk: SetupDesk) -> None:
    feed, calibration = GivenFeed(), CalibrationDesk(desk)
    with pytest.raises(Refused, match="no_recording"):
        asyncio.run(calibration.evaluate())
    calibration.record(feed, demo_scene())
    assert feed.is_recording
    for k in range(101):
        feed.given = [("wheel", WheelSample(NOW_NS + k * 100_000_000, 2.0, 0.0))]
        calibration.take(feed.poll())
    assert calibration.recorder is not None
    assert (calibration.recorder.length_s, calibration.recorder.distance_m) == pytest.approx((10.0, 20.0))
    asyncio.run(calibration.evaluate())
    assert calibration.missing is not None
    assert (calibration.missing.key, calibration.result) == ("straight_m", None)
    with pytest.raises(Refused, match="no_result"):
        calibration.accept("anna", "")
    with pytest.raises(Refused, match="no_setting"):
        calibration.choose("lidar_mount.nowhere")
    calibration.end()
    assert not feed.is_recording
