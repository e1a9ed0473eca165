"""Arguments that name files of `configs/`, checked before the imports that take seconds."""

import argparse

from configs.mission import Mission
from configs.site import Site
from configs.strict import find, load
from configs.vehicle import ImplementFile, Vehicle
from messages.errors import HeadlandError


def check_drive(arguments: argparse.Namespace) -> None:
    """Raises HeadlandError for a mission, machine, implement, scenario or bay that does not exist or is invalid."""
    mission = load(Mission, find("missions", arguments.mission))
    load(Vehicle, find("machines", arguments.machine or mission.machine))
    load(ImplementFile, find("implements", arguments.implement or mission.implement))
    if getattr(arguments, "scenario", None) is not None:
        find("scenarios", arguments.scenario)
    if arguments.bay is None or arguments.field is not None:
        return
    site = load(Site, find("sites", mission.site))
    if site.shed is None:
        raise HeadlandError(f"--bay {arguments.bay}: the site {mission.site} has no shed")
    site.shed.bay(arguments.bay)
