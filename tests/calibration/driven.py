"""A trial drive on a drawn plant: a driver follows the line of the mission `calibration`, without the stack."""

import math
from dataclasses import dataclass

import numpy as np

from calibration.recording import Recorder, Recording
from configs.mission import Mission
from configs.site import Site
from configs.strict import find, load
from configs.vehicle import Vehicle
from messages.command import MachineState, Mode, SafeCommand
from messages.message import Envelope
from planning.plan import plan_mission
from runtime.stack import load_stack
from simulation.plant import Plant
from tests.simulation.simulated_farm import CONFIG, EMPTY, IMPLEMENT, SITE, Farm, machine_file

AHEAD_M = 3.0
STANDS_S = 8.0  # before it drives off
DRAWN = EMPTY.model_copy(update={"operator_commands": (), "plant": "drawn"})


@dataclass(frozen=True)
class Trial:
    """Recording of a drive, configured vehicle, plant, true zero error of the angle sensor (degrees), and radius of the
    wider of two circles at the stops."""

    recording: Recording
    vehicle: Vehicle
    plant: Plant
    angle_zero_deg: float
    smallest_radius_m: float = math.nan


def trial(seed: int, kinds: tuple[str, ...] = ("gnss", "imu", "wheels"), limit_s: float = 200.0) -> Trial:
    """Drives the whole line, or stands until `limit_s`, with these kinds of sensors."""
    mission = load(Mission, find("missions", "calibration"))
    site, stack = load(Site, find("sites", mission.site)), load_stack()
    vehicle = machine_file(mission.machine, kinds)
    assert mission.start is not None
    plan = plan_mission(mission, site, vehicle, IMPLEMENT, stack.planning, mission.start, 1)
    path = plan.paths[0]
    farm = Farm(vehicle, CONFIG, DRAWN, seed=seed, site=site, start=mission.start)
    recorder, at = Recorder(site.datum.datum), 0

    def step(farm: Farm) -> None:
        nonlocal at
        machine = farm.machine
        p = np.array([machine.x_m, machine.y_m])
        ahead = path.p_map_m[at : at + 40]
        at += int(np.argmin(np.hypot(*(ahead - p).T)))
        goal = path.p_map_m[min(len(path.p_map_m) - 1, int(np.searchsorted(path.s_m, path.s_m[at] + AHEAD_M)))] - p
        side = goal @ [-math.sin(machine.yaw_rad), math.cos(machine.yaw_rad)]
        farm.is_drive_enabled = farm.elapsed_s > STANDS_S
        left_m = float(path.s_m[-1] - path.s_m[at])
        farm.speed_mps = min(float(path.speed_mps[at + 1 : at + 2].sum()), 0.5 * left_m) if left_m > 0.3 else 0.0
        farm.brake_mps2 = 0.0 if left_m > 0.3 else 1.0
        farm.curvature_radpm = max(-0.2, min(0.2, 2.0 * float(side) / float(goal @ goal)))
        farm.is_lowered = farm.is_pto_on = bool(path.is_working[at])
        if (farm.now_ns - farm.start_ns) % 20_000_000 == 0:
            states = (("machine", _state(farm)), ("safe_command", _command(farm)))
            recorder.take(Envelope(topic, 0, farm.now_ns, message) for topic, message in states)

    stopped_s = math.inf
    while farm.elapsed_s < min(limit_s, stopped_s):
        out = farm.drive(1.0, step)
        recorder.take(Envelope(topic, 0, message.stamp_ns, message) for topic, message in out)
        if at > 0.9 * len(path.s_m) and farm.machine.speed_mps == 0.0:
            stopped_s = min(stopped_s, farm.elapsed_s + STANDS_S)
    farm.close()
    found = Trial(recorder.recording(), vehicle, farm.plant, math.degrees(farm.machine.angle_offset_rad))
    assert limit_s < 200.0 or math.isfinite(stopped_s), "the line was not driven"
    return found


def circles_at_the_stops(seed: int) -> Trial:
    """A driver turns slowly with the wheels at the left stop, then at the right one."""
    vehicle = machine_file("tractor_e", ("gnss", "imu", "wheels"))
    farm = Farm(vehicle, CONFIG, DRAWN, seed=seed)
    recorder = Recorder(SITE.datum.datum)
    settled = list[float]()

    def note(farm: Farm) -> None:
        settled.append(abs(farm.machine.speed_mps / (farm.machine.yaw_rate_radps or 1.0)))

    radii = list[float]()
    for speed_mps, curvature, seconds in ((0.0, 0.0, 3.0), (1.0, 0.31, 14.0), (1.0, -0.31, 14.0)):
        farm.is_drive_enabled, farm.speed_mps, farm.curvature_radpm = speed_mps > 0.0, speed_mps, curvature
        out = farm.drive(seconds, note)
        recorder.take(Envelope(topic, 0, message.stamp_ns, message) for topic, message in out)
        radii.append(float(np.mean(settled[-500:])))
    farm.close()
    angle_zero_deg = math.degrees(farm.machine.angle_offset_rad)
    return Trial(recorder.recording(), vehicle, farm.plant, angle_zero_deg, max(radii[1:]))


def _state(farm: Farm) -> MachineState:
    hitch = round(farm.machine.attached.hitch * 250) / 250  # resolution of the bus
    return MachineState(
        farm.now_ns, 0, 0, farm.now_ns, 0, 0, farm.machine.speed_mps, 0.0, True, 0, 0, hitch, hitch < 0.1,
        farm.machine.attached.pto_radps, False, False, False, False, 0.0, 0.0, 0.0, 0.0, False, False, 13.0, 0,
    )  # fmt: skip


def _command(farm: Farm) -> SafeCommand:
    return SafeCommand(
        farm.now_ns,
        Mode.AUTOMATIC,
        True,
        farm.speed_mps,
        0.0,
        0.0,
        farm.is_lowered,
        farm.is_pto_on,
        False,
        False,
        False,
        "",
    )
