"""List of the campaign of hazards: pairs, scenarios, missions and refusals; one drive up to the table."""

import json
from types import SimpleNamespace

import pyarrow.parquet as parquet
import pytest

from benchmarks.kills import VERBS, kill
from configs.mission import Mission
from configs.strict import find, load, parse, read_yaml
from messages.errors import ConfigError, HeadlandError
from runtime.hazards import campaign
from runtime.hazards.cases import (
    CORE,
    FILE,
    HazardList,
    draws_of,
    drives_of,
    load_list,
    scenario_of,
    with_plant,
    without,
)
from runtime.hazards.pairwise import pairs_of, possible_pairs, rows_of
from simulation.scenario import Scenario
from tests.runtime.written_file import after_file

HAZARDS = load_list()


def small():
    """The same levels, two or three of each factor, without rows."""
    values = read_yaml(FILE)
    for factor in ("placements", "phases", "environments"):
        values[factor] = dict(list(values[factor].items())[:3])
    values["placements"]["crosses"] = read_yaml(FILE)["placements"]["crosses"]
    values["objects"] = {name: values["objects"][name] for name in ("adult", "fawn", "stone")}
    return values | {"drives": [], "named": []}


def test_every_possible_pair_is_in_a_row():
    covered = set().union(*(pairs_of(dict(enumerate(row))) for row in HAZARDS.drives))
    assert possible_pairs(HAZARDS) <= covered


def test_a_list_without_a_row_lacks_pairs():
    rows = HAZARDS.drives[:-1]
    covered = set().union(*(pairs_of(dict(enumerate(row))) for row in rows))
    assert not possible_pairs(HAZARDS) <= covered


def test_generated_rows_cover_all_pairs_with_few_rows():
    hazards = parse(HazardList, small(), "small")
    rows = rows_of(hazards)
    assert possible_pairs(hazards) <= set().union(*(pairs_of(dict(enumerate(row))) for row in rows))
    assert all(hazards.is_possible(dict(enumerate(row))) for row in rows)
    assert not any(row[:2] == ("stone", "crosses") for row in rows)
    assert len(rows) < 20  # of 3 x 4 x 3 x 3 combinations


def test_number_of_drives():
    assert len(drives_of(HAZARDS, 1, False)) >= 300
    assert len(drives_of(HAZARDS, 1, True)) == CORE == 60
    names = [one.name for one in drives_of(HAZARDS, 2, False)]
    assert len(set(names)) == len(names)


def test_plant_of_a_drive():
    drive = drives_of(HAZARDS, 1, True)[0]
    worst = with_plant(drive, "worst")
    assert worst.name == f"{drive.name}-worst"
    assert parse(Scenario, worst.scenario, "worst").plant == "worst"
    assert parse(Scenario, drive.scenario, "as listed").plant == "nominal"


def test_drive_without_a_sensor():
    drive = without(drives_of(HAZARDS, 1, True)[0], "lidar/front")
    (fault,) = parse(Scenario, drive.scenario, "without").faults
    assert (fault.topic, fault.kind, fault.is_on(0)) == ("lidar/front", "off", True)
    assert drive.name == "lying_adult-1-without-lidar_front"


def test_random_draws_are_possible_rows_that_depend_on_the_seed_alone():
    drives = draws_of(HAZARDS, range(10_001, 10_201))
    assert [one.seed for one in drives] == list(range(10_001, 10_201))
    assert drives[57] == draws_of(HAZARDS, range(10_058, 10_059))[0]
    rows = [tuple(one.labels.values()) for one in drives]
    assert all(HAZARDS.is_possible(dict(enumerate(row))) for row in rows)
    assert len(set(rows)) > 195
    assert all(len({row[k] for row in rows}) >= 10 for k in range(4))


@pytest.mark.parametrize("number", range(0, len(HAZARDS.drives), 7))
def test_rows_are_valid_scenarios(number):
    row = HAZARDS.drives[number]
    scenario = parse(Scenario, scenario_of(HAZARDS, row), "row")
    assert scenario.objects[-1].object == HAZARDS.objects[row[0]].object["object"]
    assert (scenario.environment is None) is (row[3] == "as configured")


@pytest.mark.parametrize("name", sorted({one.mission for one in drives_of(HAZARDS, 1, False)}))
def test_missions_exist(name):
    assert load(Mission, find("missions", name)).start is not None


BAD = {
    "'moon' is not one of the objects": lambda v: v.update(drives=[["moon", "ahead", "docking", "dust"]]),
    "'crosses' is not possible for 'stone'": lambda v: v.update(
        drives=[["stone", "crosses", "start", "as configured"]]
    ),
    "limit_s": lambda v: v["phases"]["start"].update(limit_s=-1),
    "needs": lambda v: v["placements"]["crosses"].update(needs="wings"),
    "version": lambda v: v.update(version=2),
}


@pytest.mark.parametrize("expected", BAD)
def test_bad_list_is_refused(expected):
    values = small()
    BAD[expected](values)
    with pytest.raises(ConfigError, match=expected):
        parse(HazardList, values, "bad.yaml")


def options(folder, **more):
    values = {
        "seeds": 1,
        "jobs": 1,
        "core": False,
        "plant": None,
        "only": None,
        "scheduler": None,
        "json": True,
        "draws": None,
        "without": None,
        "out": folder,
    }
    return SimpleNamespace(**(values | more))


def test_unknown_name_is_refused(tmp_path):
    with pytest.raises(HeadlandError, match="no drive has such a name"):
        campaign.main(options(tmp_path, only="^unicorn$"))
    with pytest.raises(HeadlandError, match=r"'lidar/unicorn': not one of lidar/front, "):
        campaign.main(options(tmp_path, without="lidar/unicorn"))


@pytest.mark.slow
def test_named_contact_is_reported_after_a_kill_and_not_driven_again(tmp_path, capsys):
    """Adult who lies beside the wing of a machine that begins to dock among plants, nearer than promised."""
    arguments = options(tmp_path / "campaign" / "out", only="^090-1-worst$", plant="worst")
    wait = after_file(VERBS["campaign"].main, 0.5)
    assert kill("campaign", tmp_path, tmp_path / "campaign", wait, is_run_again=False) == ""
    assert campaign.main(arguments) == 1
    result = json.loads(capsys.readouterr().out)
    assert (result["drives"], result["contacts"], result["avoidable_contacts"]) == (1, 1, 0)
    assert result["unavoidable_share"] == 1.0
    assert [one["reason"] for one in result["unavoidable"]] == ["entered the path too near"]
    rows = parquet.read_table(arguments.out / "objects.parquet").to_pylist()
    (row,) = (one for one in rows if one["is_contact"])
    assert not row["is_promised"]
    assert row["part"] == "wheel_rear_right"
    assert 0.0 < row["impact_mps"] < 0.5
    summary = (arguments.out / "summary.md").read_text()
    assert summary.startswith("drives 1, contacts 1, avoidable contacts 0, ")
    assert "- 090-1-worst: " in summary
    page = (arguments.out / "table.html").read_text()
    assert "./headland run --mission dock" in page
    assert "data:image/png" in page
    assert (tmp_path / "campaign" / "mine.txt").read_text() == "mine"
    assert (arguments.out / "notes.txt").read_text() == "mine"
    assert campaign.main(arguments) == 1
    assert "1 of 1 driven before" in capsys.readouterr().err
