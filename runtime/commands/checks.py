"""Arguments that name files of `configs/`, checked before the imports that take seconds."""

import argparse
import sys
from pathlib import Path

from messages.errors import HeadlandError


def check_drive(arguments: argparse.Namespace, is_planned_only: bool = False) -> None:
    """Raises HeadlandError for a mission, machine, implement, scenario, field or bay that is missing or invalid.

    Also, unless it `is_planned_only`, for an implement that is not driven. Prints what a field file holds beside the
    field, one line each.
    """
    notes = check_field(arguments)
    # only now: the imports take 0.5 s, and a wrong field file is reported at once
    from configs.mission import Mission
    from configs.site import Site
    from configs.strict import find, load
    from configs.vehicle import ImplementFile, TrailedImplement, Vehicle, undriven

    mission = load(Mission, find("missions", arguments.mission))
    load(Vehicle, find("machines", arguments.machine or mission.machine))
    implement = load(ImplementFile, find("implements", arguments.implement or mission.implement)).implement
    if isinstance(implement, TrailedImplement) and not is_planned_only:
        raise HeadlandError(undriven(implement))
    if getattr(arguments, "scenario", None) is not None:
        find("scenarios", arguments.scenario)
    if arguments.bay is not None and arguments.field is None:
        site = load(Site, find("sites", mission.site))
        if site.shed is None:
            raise HeadlandError(f"--bay {arguments.bay}: the site {mission.site} has no shed")
        site.shed.bay(arguments.bay)
    for note in notes:
        sys.stderr.write(f"{arguments.field}: {note}\n")


def check_field(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Notes on a field file; raises HeadlandError for one without the field or guidance line that is asked for."""
    if arguments.field is None:
        for name in ("feature", "guidance"):
            if (given := getattr(arguments, name)) is not None:
                raise HeadlandError(f"--{name} {given}: is taken from a field file; give the file by --field")
        return ()
    from planning.field.feature_choice import choose
    from planning.field.formats.contents import count_of
    from planning.field.formats.known_formats import read_file

    path = Path(arguments.field)
    contents = read_file(path)
    choose(contents, arguments.feature, str(path))
    # only now: the import takes 0.5 s, and a file of another kind is reported at once
    from planning.field.field import outline_of
    from planning.guidance.recorded import choose_line, line_in_map, listed

    outline = outline_of(contents, path, arguments.feature)
    if arguments.guidance is not None:
        line_in_map(choose_line(outline.lines, arguments.guidance), outline.datum.datum)
        return outline.notes
    if not outline.lines:
        return outline.notes
    count = count_of(len(outline.lines), "guidance line")
    return (*outline.notes, f"{count}, used with --guidance LINE: {listed(outline.lines)}")
