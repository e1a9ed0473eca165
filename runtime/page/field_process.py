"""Reads and plans fields for the page in a process of its own, which the page can end at any time.

`python -m runtime.page.field_process read|plan FOLDER [FEATURE]` works in the folder of a mission
(`hmi/plan_view/mission_store.py`) and prints one JSON object per line: `{"stage": ...}`, then `{"done": ...}` or
`{"error": text}`.
"""

import json
import math
import os
import pathlib
import resource
import sys
from typing import Any

import numpy as np

from configs.mission import Mission, Work
from geometry.arrays import Float64
from geometry.polyline import simplified
from hmi.drive_view.map_view import static_map
from hmi.plan_view.mission_store import MISSION, PLAN, SEED, field_of
from hmi.plan_view.options import default_work
from hmi.plan_view.plan_result import PlanResult, write_result
from hmi.scene import Scene
from messages.errors import FieldError, HeadlandError
from messages.plan import Path
from planning.field.feature_choice import choose
from planning.field.field import FieldOutline, outline_of
from planning.field.formats.contents import FieldFile
from planning.field.formats.known_formats import read_file
from planning.guidance.line import curved_line_of
from planning.guidance.recorded import work_along
from planning.plan import Plan
from runtime.processes import PARENT, end_with_parent

MEMORY_BYTES = 6 << 30  # of addresses; compressed files may hold far more than their size
NICE = 10  # a machine that drives on this computer goes first
MAX_FEATURES = 200
MIN_MPS = 0.05
LINE_M = 2000.0  # drawn to both sides of the point of a guidance line


def main(task: str, folder: pathlib.Path, feature: str | None) -> int:
    """Reads or plans; 1 after an error."""
    end_with_parent(int(parent) if (parent := os.environ.pop(PARENT, "")).isdecimal() else None)
    os.nice(NICE)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    try:
        say(done=read(folder, feature) if task == "read" else plan(folder, feature))
    except (HeadlandError, OSError) as error:
        say(error=str(error).replace(f"{field_of(folder).parent}/", ""))
        return 1
    except MemoryError:
        say(error="the file needs too much memory; export the outline of one field alone")
        return 1
    return 0


def read(folder: pathlib.Path, feature: str | None) -> dict[str, Any]:
    """Fields of the file, and the outline of the one that is chosen, or the only one; raises FieldError."""
    path = field_of(folder)
    contents = read_file(path)
    found: dict[str, Any] = {"features": features_of(contents), "notes": list(contents.notes), "name": ""}
    if feature is None and len(found["features"]) > 1:
        return found
    outline = outline_of(contents, path, feature)
    lines, unused = shown_lines(outline)
    return found | {
        "name": outline.name, "notes": [*outline.notes, *unused], "map": outline_map(outline), "lines": lines,
    }  # fmt: skip


def shown_lines(outline: FieldOutline) -> tuple[list[list[Any]], list[str]]:
    """Number, name and points of each guidance line, straight ones to far outside; and why others are not used."""
    lines: list[list[Any]] = []
    unused = []
    for k, recorded in enumerate(outline.lines[:MAX_FEATURES]):
        try:
            points = points_of(work_along(default_work(), recorded, outline.datum.datum))
        except FieldError as error:
            unused.append(str(error))
            continue
        lines.append([f"{k + 1}", f"{k + 1} {recorded.name}".strip(), points])
    return lines, unused


def through(point_m: tuple[float, float], yaw_rad: float) -> list[list[float]]:
    """Two points far outside of the field on the line through a point, in `map`."""
    along_m = LINE_M * np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    return _listed(np.array([point_m - along_m, point_m + along_m]))


def features_of(contents: FieldFile) -> list[list[str]]:
    """Key for `--feature` and name of each field of a file."""
    found = []
    for number, feature in enumerate(contents.features[:MAX_FEATURES], 1):
        keys = [f"{number}"] if len(feature.parts) < 2 else [f"{number}.{k + 1}" for k in range(len(feature.parts))]
        found += [[key, f"{key} {feature.name}".strip()] for key in keys if is_field(contents, key)]
    return found


def is_field(contents: FieldFile, key: str) -> bool:
    """Whether a part is one that can be chosen."""
    try:
        choose(contents, key, "")
    except FieldError:
        return False
    return True


def outline_map(outline: FieldOutline) -> dict[str, Any]:
    """Outline and areas without work, in `map`."""
    holes = [ring.coords for ring in outline.polygon.interiors]
    areas = [area.exterior.coords for _, area in outline.no_go]
    return {
        "boundary": _listed(np.array(outline.polygon.exterior.coords)),
        "no_go": [_listed(np.array(ring)) for ring in (*holes, *areas)],
        "yard": [], "lanes": [], "gates": [], "walls": [], "plan": [],
    }  # fmt: skip


def plan(folder: pathlib.Path, feature: str | None) -> dict[str, Any]:
    """Plans `mission.yaml` on the field, writes `plan.json` and `plan.geojson`; raises HeadlandError."""
    say(stage="load")
    # only now: the imports take seconds
    from planning.export.geojson import write_geojson
    from runtime.setup import load_setup

    mission = str(folder / MISSION)
    field = str(field_of(folder))
    setup = load_setup(mission, None, None, field, SEED, feature=feature, report=lambda stage: say(stage=stage))
    found, work = setup.plan, setup.mission.work
    write_geojson(found, setup.surveyed, folder / "plan.geojson")
    result = PlanResult(
        length_m=round(found.length_m, 1),
        time_s=round(sum(driving_s(path) for path in found.paths), 1),
        planned_share=round(found.planned_share, 4),
        least_share=0.0 if work is None else work.least_planned_share,
        field_m2=round(found.field_area_m2, 1),
        swaths=len(found.swaths),
        headland_passes=len(found.headland_passes),
        has_gate=bool(setup.site.gates),
        uncovered=tuple((reason, round(area_m2, 1)) for reason, area_m2 in found.uncovered_m2.items()),
        map=static_map(Scene(setup.site, setup.vehicle, setup.implement))
        | {"sections": sections_of(found), "guide": guide_of(setup.mission)}
        | {"labels": [[[*at], numbers] for at, numbers in found.refill_labels.items()]}
        | {"margins": [] if work is None else [[m.from_m, m.to_m] for m in work.margins]},
        refills=tuple((round(r.worked_m2, 1), round(r.driven_m, 1)) for r in found.refills),
        moved_swaths=found.moved_swaths,
    )
    write_result(result, folder / PLAN)
    return {}


def guide_of(mission: Mission) -> list[list[float]] | None:
    """The guidance line of the swaths, None without one."""
    return None if mission.work is None else points_of(mission.work)


def points_of(work: Work) -> list[list[float]] | None:
    """Points of the guidance line of field work for the map."""
    curved = curved_line_of(work)
    if curved is not None:
        return _listed(simplified(curved.line(0, 0.0)))
    if work.swath_through_m is None or work.swath_direction_deg is None:
        return None
    return through(work.swath_through_m, math.radians(work.swath_direction_deg))


def driving_s(path: Path) -> float:
    """Time along a path at its speed limits, without the times for folding and lifting."""
    mean_mps = 0.5 * (path.speed_mps[1:] + path.speed_mps[:-1])
    return float((np.diff(path.s_m) / np.maximum(mean_mps, MIN_MPS)).sum())


def sections_of(plan: Plan) -> list[list[Any]]:
    """Type and line of each section of a plan, for the map."""
    found = []
    for path in plan.paths:
        for section in path.sections:
            points = path.p_map_m[section.first : section.last + 2]
            if len(points) > 1:
                found.append([str(section.section_type), _listed(simplified(points))])
    return found


def say(**values: Any) -> None:
    """Prints one object."""
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


def _listed(points_m: Float64) -> list[list[float]]:
    return [[round(x, 2), round(y, 2)] for x, y in points_m[:, :2].tolist()]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else None))
