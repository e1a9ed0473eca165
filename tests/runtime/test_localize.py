"""`localize` over generated and recorded drives: files, exit codes, refusals."""

import dataclasses
import functools
import itertools
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest

from configs.strict import CONFIGS
from datasets.importers.recording import SOURCE, Description, Sensor, describe
from datasets.log import LogWriter
from localization.gnss_gate import position_of
from messages.errors import LogError
from messages.message import Envelope
from messages.sensors import GnssFix, ImuSample, WheelSample
from runtime.commands.options import parse_arguments
from runtime.localize.wheel_scale import WheelScale
from runtime.stack import load_stack
from tests.localization.synthetic_drive import DATUM, START_NS, SensorErrors, Truth, drive, tractor
from tests.recordings import DATA, SAMPLES, needs

SEGMENT = "comma2k19-example/Example_1/b0c9d2329ad1606b|2018-08-02--08-34-47/40"
KITTI = Path(gtsam.findExampleDataFile("KittiEquivBiasedImu.txt"))


def localized(out: Path, *words: object) -> tuple[int, dict]:
    from runtime.commands.localize import main

    code = main(parse_arguments(["localize", *map(str, words), "--out", str(out)]))
    return code, json.loads((out / "result.json").read_text())


def write_log(path: Path, truth: Truth) -> None:
    sensors = tuple(Sensor(topic, "", topic, "generated") for topic in ("imu", "gnss/main", "wheel"))
    metadata = {SOURCE: {"path": "generated", "description": json.dumps(describe(Description("generated", sensors)))}}
    with LogWriter(path, metadata, load_stack().datasets.log) as log:
        for number, (arrival_ns, topic, message) in enumerate(truth.messages):
            log.write(Envelope(topic, number, arrival_ns, message))


def changed(truth: Truth, kind: type, change: Callable[[Any], Any]) -> Truth:
    """The drive with messages of a kind changed by `change`, which gets their numbers too."""
    numbers = itertools.count()
    messages = [(t, topic, change(next(numbers), m) if isinstance(m, kind) else m) for t, topic, m in truth.messages]
    return dataclasses.replace(truth, messages=messages)


@functools.cache
def short_drive() -> Truth:
    return drive(14, legs=[(4.0, 0.0, 0.0), (100.0, 2.0, 0.05)], sensor_errors=SensorErrors(seed=5))


def localized_drive(tmp_path: Path, truth: Truth) -> tuple[int, dict]:
    tmp_path.mkdir(exist_ok=True)
    write_log(tmp_path / "drive.mcap", truth)
    return localized(tmp_path / "a", tmp_path / "drive.mcap", "--vehicle", "tractor_e")


def truth_csv(path: Path, truth: Truth, shift_m: float = 0.0) -> Path:
    antenna = np.array([*tractor().sensors.gnss["main"].mount.xyz_m, 1.0])
    rows = ["stamp_s,latitude_deg,longitude_deg,height_m"]
    for k in range(5, 65):
        stamp_ns = START_NS + k * 200_000_000
        x, y, z, _ = (truth.at(stamp_ns) @ antenna).tolist()
        latitude, longitude, height = DATUM.to_ellipsoid(x + shift_m, y, z)
        rows.append(f"{stamp_ns / 1e9:.9f},{math.degrees(latitude)!r},{math.degrees(longitude)!r},{height!r}")
    path.write_text("\n".join(rows) + "\n")
    return path


def test_generated_drive_with_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, vehicle = tmp_path / "drive.mcap", "tractor_e"
    drive_truth = short_drive()
    write_log(log, drive_truth)
    truth = truth_csv(tmp_path / "truth.csv", drive_truth)
    code, result = localized(tmp_path / "a", log, "--vehicle", vehicle, "--truth", truth)
    assert (code, result["state"]) == (0, "passed")
    assert result["first_position_s"] < 10.0
    assert result["placed_after_alignment"] > 0.99
    assert result["error"]["max_m"] < 0.1
    assert result["error"]["above_protection_level"] == 0.0
    assert "passed" in capsys.readouterr().out
    rows = [line.split() for line in (tmp_path / "a/trajectory.tum").read_text().splitlines() if line[0] != "#"]
    assert all(len(row) == 8 for row in rows)
    assert len(rows) > 80  # of 10 Hz
    (line,) = json.loads((tmp_path / "a/trajectory.geojson").read_text())["features"]
    assert len(line["geometry"]["coordinates"]) == len(rows)
    assert (tmp_path / "a/picture.png").stat().st_size > 10_000
    manifest = json.loads((tmp_path / "a/manifest.json").read_text())
    assert manifest["is_complete"]
    assert {"result.json", "trajectory.tum", "trajectory.geojson", "picture.png"} <= set(manifest["files"])
    # its own trajectory is its truth, and 5 m beside it the error exceeds the protection level
    code, result = localized(tmp_path / "b", log, "--vehicle", vehicle, "--truth", tmp_path / "a/trajectory.tum")
    assert (code, result["error"]["max_m"] < 1e-3) == (0, True)
    off = truth_csv(tmp_path / "off.csv", drive_truth, shift_m=5.0)
    code, result = localized(tmp_path / "c", log, "--vehicle", vehicle, "--truth", off)
    assert code == 1
    assert result["error"]["median_m"] == pytest.approx(5.0, abs=0.2)
    assert "above the protection level" in result["reason"]


@pytest.mark.parametrize(
    ("ahead_s", "note"),
    [
        (1.05, "stamps 1.00 s ahead of the time of arrival (at most 0.05 s are allowed)"),
        (18.05, "GPS time, which is ahead of UTC by the leap seconds (18 s since 2017)?"),
        (18.05 - 315_964_800, "seconds since 1980, the epoch of GPS?"),
        (-2 * 3600.0, "time zone (2 h)?"),
        (-START_NS / 1e9, "seconds since power-on?"),
    ],
)
def test_fixes_of_another_clock_are_not_used(tmp_path: Path, ahead_s: float, note: str) -> None:
    truth = changed(short_drive(), GnssFix, lambda _, m: replace(m, stamp_ns=m.stamp_ns + round(ahead_s * 1e9)))
    code, result = localized_drive(tmp_path, truth)
    fixes = sum(isinstance(m, GnssFix) for _, _, m in truth.messages)
    assert code == 3
    assert result["reason"].startswith("no position: gnss/main: stamps ")
    assert note in result["reason"]
    assert result["fixes"] == {"stamp too far from the time of arrival": fixes}
    assert sum(note in n for n in result["notes"]) == 1


def test_doubled_fixes_are_used_once(tmp_path: Path) -> None:
    whole = short_drive()
    messages = [one for m in whole.messages for one in [m] * (1 + isinstance(m[2], GnssFix))]
    code, result = localized_drive(tmp_path, dataclasses.replace(whole, messages=messages))
    fixes = sum(isinstance(m, GnssFix) for _, _, m in messages)
    assert code == 0
    assert result["notes"] == []
    assert sum(result["fixes"].values()) == fixes
    assert result["fixes"]["used"] < 0.5 * fixes
    assert result["fixes"]["not newer than the last one, or from before a gap"] >= result["fixes"]["used"] - 1


def test_span_is_that_of_the_samples_that_were_taken(tmp_path: Path) -> None:
    ahead_ns = 10 * 365 * 86_400 * 10**9
    truth = changed(
        short_drive(), ImuSample, lambda k, m: replace(m, stamp_ns=m.stamp_ns + ahead_ns) if k == 500 else m
    )
    code, result = localized_drive(tmp_path, truth)
    assert code == 0
    assert result["span_s"] == pytest.approx(14.0, abs=0.2)
    assert result["samples_dropped"] == 1
    assert result["placed_after_alignment"] > 0.99


@pytest.mark.parametrize(
    ("field", "name"), [("rate_radps", "angular velocity"), ("acceleration_mps2", "linear acceleration")]
)
def test_imu_that_does_not_measure_is_named(tmp_path: Path, field: str, name: str) -> None:
    unknown = {field: np.full(3, np.nan)}
    with pytest.raises(LogError, match=rf"drive.mcap: imu has no {name}, without which nothing is localized"):
        localized_drive(tmp_path, changed(short_drive(), ImuSample, lambda _, m: replace(m, **unknown)))
    some = changed(short_drive(), ImuSample, lambda k, m: replace(m, **unknown) if k % 100 == 50 else m)
    code, result = localized_drive(tmp_path / "some", some)
    samples = sum(isinstance(m, ImuSample) for _, _, m in some.messages)
    assert code == 0
    assert result["notes"] == [f"imu: {(samples + 49) // 100} of {samples} samples without {name}"]


@functools.cache
def long_drive() -> Truth:
    """Straights and half turns, forwards and back, with slip of 4 % and more."""
    legs = [(5.0, 0.0, 0.0), (25.0, 2.8, 0.0), (8.0, 2.0, 0.17), (25.0, 2.8, 0.0), (3.0, 0.0, 0.0), (12.0, -1.5, 0.1)]
    return drive(78, legs=legs)


def scale_of(truth: Truth, factor: float, has_velocity: bool) -> WheelScale:
    imu, gnss = tractor().sensors.imu, load_stack().localization.map_alignment.gnss
    scale = WheelScale(imu.mount.T_base_sensor[2, :3], 0.1)
    for _, _, m in truth.messages:
        if isinstance(m, WheelSample):
            scale.add_speed(factor * m.speed_mps)
        elif isinstance(m, ImuSample):
            scale.add_rates(m.stamp_ns, m.rate_radps)
        elif isinstance(m, GnssFix):
            fix = m if has_velocity else replace(m, velocity_enu_mps=np.full(3, np.nan))
            scale.add_fix(position_of(fix, DATUM, gnss, 10.0))
    return scale


@pytest.mark.parametrize("has_velocity", [True, False])
@pytest.mark.parametrize(
    ("factor", "finding"),
    [
        (1.0, ""),
        (1.15, ""),
        (0.87, ""),
        (3.6, "km/h?"),
        (2.237, "mph?"),
        (1.4, "radius, gear or units?"),
        (0.6, "radius, gear or units?"),
        (0.0, "the wheels say 0.00 times"),
    ],
)
def test_wheels_in_other_units_are_found(factor: float, finding: str, has_velocity: bool) -> None:
    found = scale_of(long_drive(), factor, has_velocity)
    assert len(found.ratios) >= 5
    assert (finding in found.finding()) if finding else found.finding() == ""


def test_few_metres_tell_nothing_of_the_wheels() -> None:
    assert scale_of(drive(20, legs=[(5.0, 0.0, 0.0), (100.0, 2.0, 0.0)]), 3.6, True).finding() == ""


def test_wheels_in_kilometres_per_hour_fail(tmp_path: Path) -> None:
    short = drive(17, legs=[(4.0, 0.0, 0.0), (100.0, 5.0, 0.0)])
    fast = changed(short, WheelSample, lambda _, m: replace(m, speed_mps=3.6 * m.speed_mps))
    code, result = localized_drive(tmp_path, fast)
    assert code in (1, 3)
    assert re.search(r"the wheels say 3\.\d\d times the speed of the fixes: km/h\?", result["reason"])


def test_recording_without_fixes_is_not_shown(tmp_path: Path) -> None:
    husky = (CONFIGS / "vehicles/husky.yaml").read_text().replace("/husky_velocity", "/jackal_velocity")
    vehicle = tmp_path / "jackal.yaml"
    vehicle.write_text(husky)
    code, result = localized(tmp_path / "a", SAMPLES / "bag" / "jackal.bag", "--vehicle", vehicle)
    assert (code, result["state"]) == (3, "not_shown")
    assert list(result["awaited_s"]) == ["GNSS fixes", *list(result["awaited_s"])[1:]]
    assert "no GNSS: dead reckoning only, no position in map" in result["notes"]
    assert not (tmp_path / "a/trajectory.tum").exists()


def test_fixes_alone_are_refused(tmp_path: Path) -> None:
    from messages.errors import HeadlandError
    from runtime.commands.localize import main

    words = ["localize", str(SAMPLES / "gnss" / "nmea_rtk.log"), "--vehicle", "husky", "--out", str(tmp_path / "a")]
    with pytest.raises(HeadlandError, match="no IMU, without which nothing is localized"):
        main(parse_arguments(words))
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("stamp_s,x_m\n1,2\n", "needed are latitude_deg, longitude_deg or x_m, y_m"),
        ("stamp_s,x_m,y_m\n1,2,three\n", "'1,2,three' is not a row of numbers"),
        ("nothing of the kind\n", "no truth that is read"),
    ],
)
def test_bad_truth_names_what_is_wrong(tmp_path: Path, text: str, reason: str) -> None:
    from validation.localization.truth import read_truth

    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=reason):
        read_truth(path, DATUM)


@needs(SEGMENT)
def test_comma2k19_is_better_than_its_receiver(tmp_path: Path) -> None:
    code, result = localized(tmp_path / "a", DATA / SEGMENT, "--truth", DATA / SEGMENT / "global_pose")
    assert code == 0
    assert result["placed_after_alignment"] == 1.0
    assert result["error"]["rmse_m"] < result["receiver_error"]["rmse_m"]
    assert result["error"]["median_m"] < result["receiver_error"]["median_m"]


def test_kitti_with_every_tenth_fix(tmp_path: Path) -> None:
    """The first 200 s of the drive."""
    imu, gnss = tmp_path / "imu.txt", tmp_path / "gnss.txt"
    samples = KITTI.read_text().splitlines()[:20_000]
    head, *fixes = (KITTI.parent / "KittiGps_converted.txt").read_text().splitlines()
    end_s = float(samples[-1].split()[0])
    imu.write_text("\n".join(samples) + "\n")
    gnss.write_text("\n".join([head, *(f for f in fixes if float(f.split(",")[0]) <= end_s)]) + "\n")
    _, result = localized(tmp_path / "a", imu, "--fixes-every", 10)
    assert result["truth"] == "fixes that were withheld"
    assert sum(result["fixes"].values()) == 20
    assert result["fixes"]["used"] > 10
    assert result["error"]["n"] > 110  # the first 70 s hold samples that are interpolated, and no start
    assert result["error"]["median_m"] < 3.5
    assert result["placed_after_alignment"] > 0.95
