"""A plan as GeoJSON."""

import json
from pathlib import Path as FilePath
from typing import Any

import shapely
from shapely.geometry import mapping
from shapely.geometry.base import BaseGeometry

from configs.site import Site
from planning.export.shapes import degrees_of, field_of, name_of
from planning.plan import Plan


def plan_to_geojson(plan: Plan, site: Site) -> dict[str, Any]:
    """FeatureCollection in degrees: field, no-go areas, planned strips, path sections, uncovered areas, refills."""
    degrees = degrees_of(site.datum)

    def feature(shape: BaseGeometry, **properties: Any) -> dict[str, Any]:
        return {"type": "Feature", "properties": properties, "geometry": mapping(shapely.transform(shape, degrees))}

    field, no_go = field_of(site)
    found = [feature(field, kind="field", name=name_of(site), area_m2=round(field.area, 1))]
    found += [feature(shape, kind="no_go", name=name) for name, shape in no_go]
    if not plan.planned_area.is_empty:
        found.append(feature(plan.planned_area, kind="planned", area_m2=round(plan.planned_area.area, 1)))
    for path in plan.paths:
        for section in path.sections:
            points = path.p_map_m[section.first : section.last + 2]
            if len(points) > 1:
                kind = {"kind": "path", "section_type": str(section.section_type), "line": section.line}
                found.append(feature(shapely.LineString(points), **kind))
    found += [
        feature(u.outline, kind="uncovered", reason=u.reason, area_m2=round(u.area_m2, 1)) for u in plan.uncovered
    ]
    for stop in plan.refills:
        amounts = {"worked_m2": round(stop.worked_m2, 1), "driven_m": round(stop.driven_m, 1)}
        found.append(feature(shapely.Point(stop.place[:2]), kind="refill", number=stop.number, **amounts))
    return {"type": "FeatureCollection", "name": site.name, "features": found}


def write_geojson(plan: Plan, site: Site, file: FilePath) -> None:
    """Writes `plan_to_geojson` to a file."""
    file.write_text(json.dumps(plan_to_geojson(plan, site)) + "\n", encoding="utf-8")
