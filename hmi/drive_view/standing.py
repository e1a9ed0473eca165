"""Why the machine stands or drives slower, and who must do what next, in words."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from hmi.drive_view.row import Level, number
from hmi.page_state import PageState
from hmi.texts import Texts
from messages.command import Mode, OrderStatus, SupervisorState
from messages.faults import Fault
from messages.perception import ObstacleClass

UNCONFIRMED = "operator_command.unconfirmed"
RuleText = Callable[[str], str]  # Chinese text of the code of a rule
LEVELS: dict[Mode, Level] = {
    Mode.AUTOMATIC: "good", Mode.OBSTACLE_STOP: "warning", Mode.START_WARNING: "warning",
    Mode.FAULT_STOP: "alarm", Mode.EMERGENCY_STOP: "alarm",
}  # fmt: skip


@dataclass(frozen=True)
class Standing:
    """Mode with its symbol, cause of standing or of the speed limit, and the next step with who takes it."""

    mode: str
    level: Level
    cause: str
    next_step: str
    symbol: str


def standing(state: PageState, texts: Texts, rule_text_zh: RuleText) -> Standing:
    """What the supervisor does and why; no data is an alarm."""
    supervisor = state.fresh("supervisor", SupervisorState)
    if supervisor is None:
        return Standing(texts("mode.no_data"), "alarm", _silence(state, texts), texts("next.no_data"), "no_data")
    mode = supervisor.mode
    cause = _cause(state, supervisor, texts, rule_text_zh)
    level = LEVELS.get(mode, "plain")
    orders = state.fresh("order_status", OrderStatus)
    if mode is Mode.STANDBY and orders is not None and orders.is_forbidden:
        return Standing(texts(f"mode.{mode}"), level, texts("cause.forbidden"), texts("next.forbidden"), "forbid")
    return Standing(texts(f"mode.{mode}"), level, cause, _next_step(supervisor, texts), str(mode))


def is_ready(supervisor: SupervisorState) -> bool:
    """Whether nothing but an order is missing for a start in standby."""
    return supervisor.mode is Mode.STANDBY and supervisor.reason in ("", str(Mode.STANDBY), UNCONFIRMED)


def _silence(state: PageState, texts: Texts) -> str:
    last = state.newest("supervisor", SupervisorState)
    if last is None:
        return texts("cause.no_data_yet")
    return texts("cause.no_data", seconds=number(state.age_s(last), 0, "s"))


def _cause(state: PageState, supervisor: SupervisorState, texts: Texts, rule_text_zh: RuleText) -> str:
    code = supervisor.reason
    if is_ready(supervisor) and state.is_refilling:
        return texts("cause.refill")
    if code in ("", str(supervisor.mode)):
        return texts(f"cause.{supervisor.mode}")
    if code == UNCONFIRMED:
        return texts("cause.unconfirmed_way" if supervisor.mode is Mode.OBSTACLE_STOP else "cause.unconfirmed")
    text = text_of(state, supervisor, code, texts, rule_text_zh)
    if supervisor.mode is Mode.AUTOMATIC:
        text = texts("cause.limited", cause=text)
    label, range_m = texts(f"class.{supervisor.obstacle_class}"), supervisor.clearance_m
    is_known = supervisor.obstacle_class is not ObstacleClass.UNKNOWN and math.isfinite(range_m)
    if is_known and label.lower() not in text.lower():
        text += texts("cause.obstacle", label=label, range=number(range_m, 1, "m"))
    return text


def text_of(
    state: PageState, supervisor: SupervisorState, code: str, texts: Texts, rule_text_zh: RuleText
) -> str:  # fmt: skip
    """Text of a code of the supervisor: of its fault message, else of the rule's result; the code itself if unknown."""
    fault = state.faults.get(("supervisor", code))
    if fault is not None:
        return fault_text(fault, texts)
    rule = next((rule for rule in supervisor.rules if rule.code == code), None)
    if rule is None:
        return code
    return rule_text_zh(code) if texts.language == "zh" else rule.text[:1].upper() + rule.text[1:]


def fault_text(fault: Fault, texts: Texts) -> str:
    """Text of a fault in the language of `texts`."""
    return fault.text_zh if texts.language == "zh" else fault.text_en[:1].upper() + fault.text_en[1:]


def _next_step(supervisor: SupervisorState, texts: Texts) -> str:
    mode = supervisor.mode
    if mode is Mode.STANDBY:
        if supervisor.reason == UNCONFIRMED:
            return texts("next.unconfirmed")
        return texts("next.standby" if is_ready(supervisor) else "next.not_ready")
    if mode is Mode.OBSTACLE_STOP:
        if supervisor.reason == UNCONFIRMED:
            return texts("next.unconfirmed_way")
        seconds = number(supervisor.resume_in_s, 1, "s")
        return texts("next.obstacle_stop", seconds=seconds)
    return texts(f"next.{mode}")
