"""Which order can be given now, and why another one cannot."""

from hmi.drive_view.standing import is_ready
from hmi.page_state import PageState
from hmi.refusal import Refused
from hmi.texts import Texts
from messages.command import MachineState, Mode, OrderStatus, SupervisorState
from messages.motion import Odometry
from messages.plan import MissionStatus, PathSectionType

ORDERS = ("confirm_clear", "start", "resume", "pause", "forbid", "permit", "reset", "manual", "automatic")
NUDGES = {"nudge_left": 0.01, "nudge_right": -0.01}  # step of the driven line to the left of the machine, m
CONTROLS = (*ORDERS, *NUDGES)
ENGAGED = (Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP)
STOPPED = (Mode.FAULT_STOP, Mode.EMERGENCY_STOP)
STANDING_MPS = 0.05


def unavailable(state: PageState, texts: Texts) -> dict[str, str]:
    """Reason by order that the machine would not take now; the supervisor decides in any case."""
    supervisor, status = state.fresh("supervisor", SupervisorState), state.fresh("order_status", OrderStatus)
    if supervisor is None or status is None:
        return dict.fromkeys(CONTROLS, texts("why.no_data"))
    found = {order: _why_not(order, supervisor, status, state) for order in CONTROLS}
    return {order: texts(f"why.{key}") for order, key in found.items() if key}


def _why_not(order: str, supervisor: SupervisorState, status: OrderStatus, state: PageState) -> str:
    """Key of the reason, "" for an order that is available."""
    mode = supervisor.mode
    if order in NUDGES:
        return "" if mode is Mode.AUTOMATIC and driven_swath(state) is not None else "not_on_swath"
    if order in ("forbid", "permit"):
        if status.is_forbidden == (order == "permit"):
            return ""
        return "forbidden_now" if order == "forbid" else "permitted"
    if order in ("start", "resume"):
        return "forbidden" if status.is_forbidden else _why_no_start(order, supervisor, state)
    if order == "pause":
        return "" if mode in ENGAGED else "not_engaged"
    if order == "confirm_clear":
        return "" if mode in (Mode.STANDBY, Mode.OBSTACLE_STOP, Mode.START_WARNING) else "no_confirmation"
    if order == "reset":
        if mode not in STOPPED:
            return "no_stop"
        machine = state.fresh("machine", MachineState)
        if machine is not None and machine.is_emergency_button_pressed:
            return "button_pressed"
        return "" if _is_still(state) else "moving"
    if order == "automatic":
        return "" if mode is Mode.MANUAL else "not_manual"
    return "manual_now" if mode is Mode.MANUAL else "stopped" if mode is Mode.EMERGENCY_STOP else ""


def _why_no_start(order: str, supervisor: SupervisorState, state: PageState) -> str:
    mode = supervisor.mode
    if mode in ENGAGED:
        return "engaged"
    if mode in STOPPED:
        return "reset_first"
    if mode is Mode.MANUAL:
        return "automatic_first"
    if mode is Mode.FINISHED:
        return "finished"
    if not is_ready(supervisor):
        return "not_ready"
    if order == "start":
        return "begun" if state.is_begun else ""
    return "" if state.is_begun else "not_begun"


def driven_swath(state: PageState) -> MissionStatus | None:
    """State of a mission that drives along a swath, None elsewhere."""
    mission = state.fresh("mission", MissionStatus)
    return mission if mission is not None and mission.section_type is PathSectionType.SWATH else None


def check_standing(state: PageState) -> None:
    """Raises Refused in automatic operation, and while the machine moves; one that is silent can be replaced."""
    supervisor, odometry = state.fresh("supervisor", SupervisorState), state.fresh("odom", Odometry)
    if supervisor is not None and supervisor.mode in ENGAGED:
        raise Refused("engaged")
    if odometry is not None and abs(odometry.speed_mps) >= STANDING_MPS:
        raise Refused("moving")


def _is_still(state: PageState) -> bool:
    odometry = state.fresh("odom", Odometry)
    return odometry is not None and abs(odometry.speed_mps) < STANDING_MPS
