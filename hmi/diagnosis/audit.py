"""Orders since the start of the machine: how many it has accepted, and refused for which reason."""

from typing import Any

from hmi.page_state import PageState
from hmi.texts import Texts
from messages.command import OrderStatus


def audit_rows(state: PageState, texts: Texts) -> list[list[Any]]:
    """Rows of a table: what happened to orders, and how often; none while the order gate is silent."""
    status = state.fresh("order_status", OrderStatus)
    if status is None:
        return []
    rows: list[list[Any]] = [[texts("audit.accepted"), str(status.accepted)]]
    for one in sorted(status.refused, key=lambda one: -one.count):
        reason = texts("audit.refused", reason=texts(f"refusal.{one.reason}"))
        rows.append([{"text": reason, "level": "warning"}, str(one.count)])
    return rows
