"""`headland plan`: plans a field without driving; writes figure, GeoJSON, KML, ISOXML, path length and areas."""

import argparse
import json
import sys

from runtime.commands.checks import check_drive
from runtime.commands.options import version


def main(arguments: argparse.Namespace) -> int:
    """Plans and writes the results; returns 1 below the mission's `least_planned_share`.

    Raises FieldError before writing if the field cannot be worked.
    """
    check_drive(arguments, is_planned_only=True)
    # only now: these imports take seconds, and a wrong argument is reported at once
    from runtime.run_folder import RunFolder, command_of, named_errors, resolved, versions

    with RunFolder("plan", arguments.out, command_of(arguments)) as folder:
        from planning.drawing import draw_plan
        from planning.export.geojson import write_geojson
        from planning.export.isoxml import write_isoxml
        from planning.export.kml import write_kml
        from planning.field.drivable_area import describe
        from runtime.setup import setup_from

        setup = setup_from(arguments)
        plan = setup.plan
        result = {
            "length_m": round(plan.length_m, 1),
            "field_m2": round(plan.field_area_m2, 1),
            "planned_m2": round(plan.planned_area.area, 1),
            "planned_share": round(plan.planned_share, 4),
            "gate": bool(setup.site.gates),
            "swaths": len(plan.swaths),
            "headland_passes": len(plan.headland_passes),
            "uncovered": [
                {"reason": u.reason, "area_m2": round(u.area_m2, 2), "place_m": u.place_map_m} for u in plan.uncovered
            ],
            "moved_swaths": plan.moved_swaths,
            "refills": [
                {
                    "number": r.number,
                    "reason": r.reason,
                    "place_m": [round(v, 2) for v in r.place[:2]],
                    "worked_m2": round(r.worked_m2, 1),
                    "driven_m": round(r.driven_m, 1),
                }
                for r in plan.refills
            ],
            "run_dir": str(folder.path),
        }
        folder.record("conditions", versions() | {"seed": str(setup.seed)})
        config = resolved(mission=setup.mission, site=setup.site, machine=setup.vehicle, implement=setup.implement)
        with named_errors(folder.path):
            folder.file("config.yaml").write_text(config, encoding="utf-8")
            draw_plan(plan, setup.site, folder.file("plan.png"))
            write_geojson(plan, setup.surveyed, folder.file("plan.geojson"))
            write_kml(plan, setup.surveyed, folder.file("plan.kml"))
            write_isoxml(plan, setup.surveyed, folder.file("TASKDATA"), version())
        folder.record("result", {"result": result})
        folder.finish()
    if arguments.json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        share = 100.0 * plan.planned_share
        gate = "" if setup.site.lanes else ", from a start within the field without a gate"
        sys.stdout.write(
            f"{plan.length_m:.0f} m path, {share:.1f} % of {plan.field_area_m2:.0f} m² planned{gate}: {folder.path}\n"
        )
    work = setup.mission.work
    if work is not None and (passes := plan.rig.headland_passes(work)) > work.headland_passes:
        radius_m = plan.rig.radius_m
        sys.stderr.write(
            f"note: {passes} headland passes instead of {work.headland_passes}: turns forwards with a radius of "
            f"{radius_m:.1f} m{'' if plan.rig.trailer is None else ' and a run-in'} need the room\n"
        )
    if not arguments.json:
        for r in plan.refills:
            sys.stdout.write(
                f"refill {r.number} ({r.reason}) at x {r.place.x_m:.1f} m, y {r.place.y_m:.1f} m: "
                f"{r.worked_m2:.0f} m² worked, {r.driven_m:.0f} m driven since the last one\n"
            )
    if plan.moved_swaths:
        sys.stderr.write(
            f"note: {plan.moved_swaths} swaths are worked in another order than swath_skip or swaths_from_m set: "
            "no turn leads from one to the next\n"
        )
    least = 0.0 if setup.mission.work is None else setup.mission.work.least_planned_share
    if plan.planned_share >= least:
        return 0
    sys.stderr.write(f"warning: {plan.planned_share:.1%} of the field planned, less than {least:.1%}:\n")
    for reason, area_m2 in plan.uncovered_m2.items():
        largest = max((u for u in plan.uncovered if u.reason == reason), key=lambda u: u.area_m2)
        where = describe(setup.site, *largest.place_map_m)
        sys.stderr.write(f"  {area_m2:.0f} m² {reason}, the largest part at {where}\n")
    return 1
