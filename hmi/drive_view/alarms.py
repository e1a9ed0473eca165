"""Active faults and the last ones that ended, as texts."""

from hmi.drive_view.row import Level, Row
from hmi.drive_view.standing import fault_text
from hmi.page_state import PageState
from hmi.texts import Texts
from messages.faults import Response, Severity

LEVELS: dict[Severity, Level] = {
    Severity.NOTICE: "plain", Severity.WARNING: "warning", Severity.ALARM: "alarm",
}  # fmt: skip


def alarm_rows(state: PageState, texts: Texts) -> list[Row]:
    """Active faults, the most severe first: source, text, and the response of the machine."""
    faults = sorted(state.faults.values(), key=lambda fault: (-fault.severity, -fault.stamp_ns))
    return [
        Row(f"{fault.source}:{fault.code}", texts.named("source_name", fault.source),
            f"{fault_text(fault, texts)}{_response(fault.response, texts)}", LEVELS[fault.severity])
        for fault in faults
    ]  # fmt: skip


def _response(response: Response, texts: Texts) -> str:
    return "" if response is Response.NONE else f" – {texts(f'response.{response.name.lower()}')}"
