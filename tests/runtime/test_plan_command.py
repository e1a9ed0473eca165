"""`plan` on a small field: exit code by the planned share."""

import json
from pathlib import Path

import pytest
import yaml

from configs.strict import CONFIGS, read_yaml
from runtime.commands.options import parse_arguments
from runtime.commands.plan import main

RING = [[6.0625, 51.5115], [6.0636, 51.5115], [6.0636, 51.512], [6.0625, 51.512], [6.0625, 51.5115]]


@pytest.mark.parametrize(("least", "code"), [(0.8, 0), (0.999, 1)])
def test_exit_code_by_the_least_planned_share(
    least: float, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    field, mission = tmp_path / "field.geojson", tmp_path / "mission.yaml"
    field.write_text(json.dumps({"type": "Polygon", "coordinates": [RING]}))
    values = read_yaml(CONFIGS / "missions/yard.yaml")
    mission.write_text(yaml.safe_dump(values | {"work": values["work"] | {"least_planned_share": least}}))
    command = ["plan", str(field), "--mission", str(mission), "--out", str(tmp_path / "plan"), "--json"]
    assert main(parse_arguments(command)) == code
    said = capsys.readouterr()
    assert json.loads(said.out)["planned_share"] == pytest.approx(0.95, abs=0.05)
    assert ("less than 99.9%" in said.err) == ("m² edge margin" in said.err) == bool(code)
    assert (tmp_path / "plan/plan.png").is_file()
