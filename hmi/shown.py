"""What a page shows at one moment in one language, by section; a page is sent only the sections that have changed."""

import math
from collections.abc import Callable
from typing import Any

from hmi.drive_view.alarms import alarm_rows
from hmi.drive_view.controls import unavailable
from hmi.drive_view.machine import machine_rows
from hmi.drive_view.map_view import moving_map
from hmi.drive_view.motion import deviation, motion_rows, work_rows
from hmi.drive_view.position import position_rows
from hmi.drive_view.row import Row
from hmi.drive_view.sensing import obstacle_rows, sensor_rows
from hmi.drive_view.standing import RuleText, standing
from hmi.feed import Playback
from hmi.page_state import PageState
from hmi.texts import Texts

ROWS: dict[str, Callable[[PageState, Texts], list[Row]]] = {
    "motion": motion_rows,
    "work": work_rows,
    "position": position_rows,
    "sensors": sensor_rows,
    "obstacles": obstacle_rows,
    "machine": machine_rows,
    "alarms": alarm_rows,
}
EMPTY = {"obstacles": "obstacle.none", "alarms": "alarm.none"}


def shown_of(state: PageState, texts: Texts, rule_text_zh: RuleText, playback: Playback | None) -> dict[str, Any]:
    """Sections of the page for JSON, and under `unavailable` the orders that cannot be given with the reason."""
    now = standing(state, texts, rule_text_zh)
    control = deviation(state)
    shown: dict[str, Any] = {name: _listed(rows(state, texts), name, texts) for name, rows in ROWS.items()}
    shown["state"] = [now.mode, now.level, now.cause, now.next_step, now.symbol]
    shown["bar"] = None if control is None else round(100.0 * control.xte_m, 1)
    shown["map"] = moving_map(state, texts)
    shown["unavailable"] = unavailable(state, texts)
    if playback is not None:
        shown["replay"] = [_clock(playback.position_s), _clock(playback.length_s), playback.is_paused, playback.rate]
    return shown


def _listed(rows: list[Row], name: str, texts: Texts) -> list[list[str]]:
    if not rows and name in EMPTY:
        return [["", texts(EMPTY[name]), "", "", "plain", ""]]
    return [[row.key, row.label, row.value, texts(f"level.{row.level}"), row.level, row.symbol] for row in rows]


def _clock(seconds: float) -> str:
    """Minutes and seconds, such as 2:05."""
    whole = math.floor(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
