"""`localize` over generated and recorded drives: files, exit codes, refusals."""

import json
import math
from pathlib import Path

import gtsam
import numpy as np
import pytest

from configs.strict import CONFIGS
from datasets.importers.recording import SOURCE, Description, Sensor, describe
from datasets.log import LogWriter
from messages.message import Envelope
from runtime.commands.options import parse_arguments
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
    drive_truth = drive(14, legs=[(4.0, 0.0, 0.0), (100.0, 2.0, 0.05)], sensor_errors=SensorErrors(seed=5))
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
    from messages.errors import LogError
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
    assert result["fixes"] == {"used": 20}
    assert result["error"]["n"] > 120
    assert result["error"]["median_m"] < 3.5
    assert result["placed_after_alignment"] > 0.95
