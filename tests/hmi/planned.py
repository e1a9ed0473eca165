"""Field files and stored missions for tests of the plan view."""

import json
import math
import sys
from pathlib import Path
from typing import Any

from hmi.plan_view.desk import PlanDesk
from hmi.plan_view.mission_store import MISSION, PLAN, MissionStore
from hmi.plan_view.options import default_options, default_work, write_mission

PLANNER = (sys.executable, "-m", "runtime.page.field_process")
L_SHAPE = ((0.0, 0.0), (0.0012, 0.0), (0.0012, 0.0009), (0.0006, 0.0009), (0.0006, 0.0005), (0.0, 0.0005), (0.0, 0.0))
ROW = """
name: row
site: demo
machine: tractor_e
implement: harrow_6m
start: {{x_m: 14.0, y_m: 25.0, heading_deg: 0.0}}
line: {{speed_kmh: {:g}, legs: [{{length_m: 52.0, is_working: true}}]}}
"""
DEGREE_M = 111_200.0  # of latitude
RESULT = {
    "length_m": 5.0, "time_s": 60.0, "planned_share": 0.97, "least_share": 0.95, "field_m2": 1e4, "swaths": 4,
    "headland_passes": 2, "has_gate": True, "uncovered": [], "map": {},
}  # fmt: skip
FAKE = """
import json, sys, time
from pathlib import Path
task, folder = sys.argv[1], Path(sys.argv[2])
text = next((folder / "field").iterdir()).read_text()
if text == "slow":
    print(json.dumps({"stage": "route"}), flush=True)
    time.sleep(60)
if text == "dies":
    sys.exit(3)
if text == "bad":
    print(json.dumps({"error": "outline crosses itself"}))
    sys.exit(1)
shown = dict.fromkeys(("yard", "no_go", "lanes", "gates", "walls", "plan"), []) | {"boundary": [[0, 0], [9, 0], [9, 9]]}
if task == "plan":
    print(json.dumps({"stage": "route"}), flush=True)
    (folder / "plan.json").write_text(json.dumps(PLAN | {"map": shown}))
    print(json.dumps({"done": {}}))
else:
    names = [["1", "north"], ["2", "south"]] if text == "two" and len(sys.argv) < 4 else [["1", "north"]]
    found = {"features": names, "notes": ["a note"], "name": "north"}
    print(json.dumps({"done": found if len(names) > 1 else found | {"map": shown}}))
"""
FAKE_PLANNER = (sys.executable, "-c", f"PLAN = {RESULT!r}\n{FAKE}")


def row_mission(speed_kmh: float) -> str:
    """Mission of one row of 52 m in the field of the demo."""
    return ROW.format(speed_kmh)


def corner_field(side_m: float) -> tuple[tuple[float, float], ...]:
    """A square without one of its quarters, as corners for `geojson`."""
    return _corners(side_m, ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.5, 1.0), (0.5, 0.5), (0.0, 0.5), (0.0, 0.0)))


def square_field(side_m: float) -> tuple[tuple[float, float], ...]:
    """A square, as corners for `geojson`."""
    return _corners(side_m, ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)))


def _corners(side_m: float, corners: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    size, shrinks = side_m / DEGREE_M, math.cos(math.radians(48.0))
    return tuple((size / shrinks * x, size * y) for x, y in corners)


def geojson(corners: tuple[tuple[float, float], ...] = L_SHAPE, name: str = "corner field") -> bytes:
    """A field file with corners in degrees from 11° E, 48° N."""
    ring = [[11.0 + x, 48.0 + y] for x, y in corners]
    geometry: dict[str, Any] = {"type": "Polygon", "coordinates": [ring]}
    return json.dumps({"type": "Feature", "properties": {"name": name}, "geometry": geometry}).encode()


def planned_draft(store: MissionStore, text: str = "field") -> Path:
    """A draft with field, mission and plan."""
    draft = store.new_draft()
    (draft / "field" / "a.geojson").write_text(text, encoding="utf-8")
    write_mission(default_options("", "").mission("north", default_work()), draft / MISSION)
    (draft / PLAN).write_text(json.dumps(RESULT), encoding="utf-8")
    return draft


def desk_in(folder: Path, command: tuple[str, ...] = FAKE_PLANNER, limit_s: float = 60.0) -> PlanDesk:
    """A desk with its missions in a folder."""
    return PlanDesk(MissionStore(folder / "missions"), command, default_options("", ""), limit_s)
