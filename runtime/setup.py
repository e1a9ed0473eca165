"""Setup of a run: mission, site, machine, implement, stack configuration and plan."""

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from configs.machine_setup import MachineSetup, setup_from_json
from configs.mission import Mission, Spread
from configs.sensor_kinds import SENSOR_KINDS, sensors_of
from configs.site import PoseConfig, Site
from configs.strict import find, load
from configs.vehicle import ImplementFile, MountedImplement, TrailedImplement, Vehicle
from datasets.viewer import Viewer
from interfaces.orders.config import ORDERS, OrderKey
from messages.errors import ConfigError
from planning.field.field import FieldOutline, read_field, with_no_go
from planning.field.gate_choice import with_gate
from planning.field.site_generation import site_of, site_of_original
from planning.guidance.recorded import choose_line, work_along
from planning.plan import Plan, Report, check_within, ignore, plan_mission
from runtime.machine_setup import with_corrections
from runtime.stack import StackConfig, load_stack, with_detector, with_order_key
from simulation.operator import AUTHORITY, operator_key, public_bytes
from simulation.scenario import Scenario

START_STREAM = 0x5747  # random stream of the start pose, separate from world and planner
SESSION_STREAM = 0x5E55  # of the session, which a real start draws from the operating system


@dataclass(frozen=True)
class Setup:
    """All inputs of a run except its world; `start` is the initial pose in map, `session` the nonce of the orders.

    `hitch` is the initial position of the hitch, 0 (lowest) to 1 (highest).
    `surveyed` is the site with the outline of its field file before simplification. A simulation draws its plant around
    `built`, the machine and implement of the configuration files; None: they are `vehicle` and `implement`.
    """

    mission: Mission
    site: Site
    surveyed: Site
    vehicle: Vehicle
    implement: MountedImplement | TrailedImplement
    stack: StackConfig
    plan: Plan
    seed: int
    start: PoseConfig
    is_folded: bool
    session: str
    hitch: float = 1.0
    built: tuple[Vehicle, MountedImplement | TrailedImplement] | None = None

    @property
    def machine_id(self) -> str:
        """Name and serial number of the machine, for which orders are signed."""
        return f"{self.vehicle.name}-{self.stack.interfaces.gateway.name_identity}"

    def viewer(self, **periods_s: float) -> Viewer:
        """Converter to the topics of common log viewers; `periods_s` replaces values of its configuration."""
        config = self.stack.datasets.viewer.model_copy(update=periods_s)
        return Viewer(config, self.vehicle, self.implement, self.site)


def setup_from(arguments: argparse.Namespace) -> Setup:
    """Setup of a command that drives or plans; raises ConfigError or FieldError."""
    given = arguments
    assumed: str | None = getattr(given, "assumed", None)
    return load_setup(
        given.mission, given.machine, given.implement, given.field, given.seed, given.bay,
        feature=given.feature, guidance=given.guidance,
        assumed=None if assumed is None else setup_from_json(assumed, "setup"),
    )  # fmt: skip


def load_setup(
    mission: str,
    machine: str | None,
    implement: str | None,
    field: str | None,
    seed: int,
    bay: str | None = None,
    *,
    feature: str | None = None,
    guidance: str | None = None,
    report: Report = ignore,
    assumed: MachineSetup | None = None,
) -> Setup:
    """Loads the named files and plans the mission, docking in `bay` if given; raises ConfigError or FieldError.

    The stack takes machine, implement and corrections from `assumed` instead of the files, if given.

    `feature` is one of the fields of the file `field` and `guidance` one of its lines, to which swaths are parallel;
    the plan is checked against the outline of the file, before simplification. `report` gets the stages of the planner.
    """
    chosen = load(Mission, find("missions", mission))
    # a site generated from a field outline has no shed
    chosen = chosen.model_copy(update={"site": field, "bay": None} if field else {})
    names = {"machine": machine or chosen.machine, "implement": implement or chosen.implement, "bay": bay or chosen.bay}
    chosen = chosen.model_copy(update=names)
    vehicle = load(Vehicle, find("machines", chosen.machine))
    mounted = load(ImplementFile, find("implements", chosen.implement)).implement
    vehicle = with_implement_sensors(vehicle, mounted)
    stack = with_order_key(load_stack(), "simulated_operator", simulated_operator_key(seed))
    built = None
    if assumed is not None:
        built, mounted = (vehicle, mounted), assumed.implement
        vehicle = with_implement_sensors(assumed.vehicle, mounted)
        stack = with_corrections(stack, assumed.corrections)
    outline = _outline(chosen, field, feature)
    chosen = _with_guidance(chosen, outline, guidance)
    site = _site(chosen, outline, vehicle, mounted)
    start, is_folded = start_pose(chosen, site, seed)
    plan = plan_mission(chosen, site, vehicle, mounted, stack.planning, start, seed, report)
    surveyed = site if outline is None else site_of_original(site, outline)
    if surveyed is not site and chosen.work is not None:
        check_within(plan, surveyed, chosen.work)
    session = np.random.default_rng([seed, SESSION_STREAM]).bytes(16).hex()
    return Setup(chosen, site, surveyed, vehicle, mounted, stack, plan, seed, start, is_folded, session, built=built)


def simulated_operator_key(seed: int) -> OrderKey:
    """Public key of the simulated operator, who may order everything."""
    key = public_bytes(operator_key(seed)).hex()
    return OrderKey(public_key=key, authority=AUTHORITY, orders=tuple(ORDERS), lost_operator_s=None)


def load_scenario(name: str | None, mission: Mission, field: str | None, plant: str | None = None) -> Scenario:
    """Named scenario with this plant (None: its own); default `demo`, or `empty` with a field outline or without work.

    Raises ConfigError.
    """
    is_demo = field is None and mission.work is not None
    scenario = load(Scenario, find("scenarios", name or ("demo" if is_demo else "empty")))
    return scenario if plant is None else scenario.model_copy(update={"plant": plant})


def with_model(setup: Setup, model: Path | None) -> Setup:
    """Setup with the camera detector from this file, unchanged for None; raises ConfigError for a missing file."""
    return replace(setup, stack=with_detector(setup.stack, model))


def start_notes(setup: Setup) -> tuple[str, ...]:
    """Lines of the console at the start of a drive: cameras that detect nothing."""
    idle = ", ".join(sorted(sensors_without_detector(setup)))
    return (f"without a detector model nothing is detected by {idle} (./headland model --help)",) if idle else ()


def sensors_without_detector(setup: Setup) -> frozenset[str]:
    """Labels (`camera_front`) of the cameras if there is no detector model; the supervisor does not require these."""
    has_model = setup.stack.perception.camera.detector.model is not None
    return frozenset() if has_model else frozenset(f"camera_{name}" for name in setup.vehicle.sensors.camera)


def start_pose(mission: Mission, site: Site, seed: int) -> tuple[PoseConfig, bool]:
    """Initial pose in map and whether the implement is folded: drawn by seed, docked, or the site's start."""
    if mission.start is not None:
        return _random_pose(mission.start, mission.spread, seed), False
    if mission.bay is None:
        return site.start, False
    return site.bay(mission.bay).dock, True


def _random_pose(pose: PoseConfig, spread: Spread | None, seed: int) -> PoseConfig:
    """Pose drawn uniformly from the disc and heading interval around a pose."""
    if spread is None:
        return pose
    share, angle, turn = np.random.default_rng([seed, START_STREAM]).uniform(size=3)
    away = spread.distance_m * math.sqrt(share)
    return PoseConfig(
        x_m=pose.x_m + away * math.cos(2.0 * math.pi * angle),
        y_m=pose.y_m + away * math.sin(2.0 * math.pi * angle),
        heading_deg=pose.heading_deg + spread.heading_deg * (2.0 * turn - 1.0),
    )


def _outline(mission: Mission, field: str | None, feature: str | None) -> FieldOutline | None:
    if field is None:
        return None
    if mission.work is None:
        raise ConfigError(f"mission {mission.name!r} has no field work for {field}; select another mission")
    outline = read_field(Path(field), feature)
    return outline if mission.work is None else with_no_go(outline, mission.work.no_go_m)


def _with_guidance(mission: Mission, outline: FieldOutline | None, guidance: str | None) -> Mission:
    """Mission whose swaths are parallel to the guidance line that the caller or the mission names."""
    work = mission.work
    guidance = guidance or (None if work is None else work.guidance)
    if guidance is None or work is None:
        return mission
    if outline is None:
        raise ConfigError(f"guidance {guidance!r}: is a line of a field file; give the file by --field")
    along = work_along(work, choose_line(outline.lines, guidance), outline.datum.datum)
    return mission.model_copy(update={"work": along.model_copy(update={"guidance": guidance})})


def _site(
    mission: Mission,
    outline: FieldOutline | None,
    vehicle: Vehicle,
    implement: MountedImplement | TrailedImplement,
) -> Site:
    work = mission.work
    if outline is None or work is None:
        if work is not None and (work.no_go_m or work.lane_m):
            raise ConfigError("no_go_m, lane_m: belong to a field file; give the file by --field")
        return with_gate(load(Site, find("sites", mission.site)), None if work is None else work.gate_m)
    return site_of(outline, vehicle, implement, work)


def with_implement_sensors(vehicle: Vehicle, implement: MountedImplement | TrailedImplement) -> Vehicle:
    """Vehicle with the sensors of its implement added; raises ConfigError for a duplicate name."""
    if not isinstance(implement, MountedImplement):
        return vehicle
    found = dict[str, dict[str, Any]]()
    for kind in SENSOR_KINDS:
        own, more = sensors_of(vehicle.sensors, kind), sensors_of(implement.sensors, kind)
        duplicates = sorted(own.keys() & more.keys())
        if duplicates:
            raise ConfigError(f"{kind} {duplicates[0]!r} is on {vehicle.name!r} and on {implement.name!r}; rename one")
        found[kind] = {**own, **{name: _sinking(one, implement.lift_m) for name, one in more.items()}}
    return vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update=found)})


def _sinking(sensor: Any, lift_m: float) -> Any:
    """The sensor of an implement with this stroke."""
    return sensor.model_copy(update={"mount": sensor.mount.model_copy(update={"sinks_m": lift_m})})
