"""Speed, heading, deviation from the path, row, worked area and time left."""

import math

from hmi.drive_view.row import UNKNOWN, Row, number
from hmi.page_state import PageState
from hmi.texts import Texts
from messages.command import ControlCommand, MachineState, Mode, SupervisorState
from messages.motion import Odometry
from messages.plan import MissionStatus, PathSectionType

MIN_ENGAGED_S = 20.0  # before it the mean speed says nothing


def motion_rows(state: PageState, texts: Texts) -> list[Row]:
    """Speed, heading, errors and steering angle."""
    odometry, pose = state.fresh("odom", Odometry), state.pose
    heading = UNKNOWN if pose is None or odometry is None else number(compass_deg(pose.yaw_rad), 0, "°")
    control = deviation(state)
    xte = UNKNOWN if control is None else _sided(100.0 * control.xte_m, 1, "cm", texts)
    turned = UNKNOWN if control is None else _sided(math.degrees(control.heading_error_rad), 1, "°", texts)
    values = {
        "speed": UNKNOWN if odometry is None else number(3.6 * odometry.speed_mps, 1, "km/h"),
        "heading": heading, "xte": xte, "heading_error": turned, "steering": _steering(state, texts),
    }  # fmt: skip
    symbols = {"steering": "steering"}
    return [Row(key, texts(f"motion.{key}"), value, symbol=symbols.get(key, "")) for key, value in values.items()]


def work_rows(state: PageState, texts: Texts) -> list[Row]:
    """Section and row, worked area with its share of the field, driven part of the plan, time left, shift."""
    mission = state.fresh("mission", MissionStatus)
    field_m2, area_m2 = state.scene.field.area, state.coverage.area_m2
    values = {"row": UNKNOWN, "area": f"{number(area_m2 * 1e-4, 3, 'ha')} ({area_m2 / field_m2:.0%})"}
    if mission is not None:
        section = texts(f"section.{mission.section_type}")
        values["row"] = section if mission.line < 0 else f"{section} {mission.line + 1}"
        values["driven"] = f"{number(mission.driven_m, 0, 'm')} / {number(mission.total_m, 0, 'm')}"
        values["time_left"] = _time_left(state, mission)
        is_swath = mission.section_type is PathSectionType.SWATH
        values["shift"] = _sided(100.0 * mission.shift_left_m, 0, "cm", texts) if is_swath else UNKNOWN
    return [Row(key, texts(f"work.{key}"), value) for key, value in values.items()]


def deviation(state: PageState) -> ControlCommand | None:
    """Command of control with the deviation from the path, None while none is followed."""
    control, supervisor = state.fresh("control_command", ControlCommand), state.fresh("supervisor", SupervisorState)
    is_engaged = supervisor is not None and supervisor.mode in (Mode.AUTOMATIC, Mode.OBSTACLE_STOP, Mode.START_WARNING)
    return control if control is not None and is_engaged and math.isfinite(control.xte_m) else None


def compass_deg(yaw_rad: float) -> float:
    """Heading clockwise from north (°), 0 to 360, of a yaw counter-clockwise from east."""
    return round((90.0 - math.degrees(yaw_rad)) % 360.0) % 360


def _sided(value: float, digits: int, unit: str, texts: Texts) -> str:
    """Amount with its side; left positive."""
    text = number(abs(value), digits, unit)
    if not math.isfinite(value) or float(f"{abs(value):.{digits}f}") == 0.0:
        return text
    return f"{text} {texts('side.left' if value > 0.0 else 'side.right')}"


def _steering(state: PageState, texts: Texts) -> str:
    machine = state.fresh("machine", MachineState)
    if machine is None:
        return UNKNOWN
    angle_rad = math.atan(machine.curvature_radpm * state.scene.vehicle.drivetrain.wheelbase_m)
    return _sided(math.degrees(angle_rad), 1, "°", texts)


def _time_left(state: PageState, mission: MissionStatus) -> str:
    """Minutes to the end of the plan at the mean speed of the time in automatic operation."""
    if state.engaged_s < MIN_ENGAGED_S or not mission.driven_m >= 1.0:
        return UNKNOWN
    left_s = (mission.total_m - mission.driven_m) * state.engaged_s / mission.driven_m
    return number(math.ceil(left_s / 60.0), 0, "min") if math.isfinite(left_s) else UNKNOWN
