"""GNSS reception, corrections, source and protection level of the position."""

from hmi.drive_view.corrections import Link, link_of
from hmi.drive_view.row import UNKNOWN, Level, Row, number
from hmi.page_state import PageState
from hmi.texts import Texts
from messages.motion import MapPose, PositionSource
from messages.sensors import GnssFix, GnssSolution

SOLUTION_LEVELS: dict[GnssSolution, Level] = {GnssSolution.RTK_FIXED: "good", GnssSolution.NONE: "alarm"}
SOURCE_LEVELS: dict[PositionSource, Level] = {
    PositionSource.RTK_FIXED: "good", PositionSource.UWB: "good", PositionSource.NONE: "alarm",
}  # fmt: skip

LINK_LEVELS: dict[Link, Level] = {"received": "good", "old": "alarm", "none": "warning"}


def position_rows(state: PageState, texts: Texts) -> list[Row]:
    """State of each receiver, then of the position that control and supervisor use."""
    rows = [row for topic in state.topics("gnss") for row in _receiver(state, topic, texts)]
    return (rows or [_row("solution", texts, texts("position.silent"), "alarm")]) + _pose(state, texts)


def _row(key: str, texts: Texts, value: str, level: Level = "plain", symbol: str = "") -> Row:
    return Row(key, texts(f"position.{key}"), value, level, symbol)


def _receiver(state: PageState, topic: str, texts: Texts) -> list[Row]:
    fix = state.fresh(topic, GnssFix)
    if fix is None:
        return [_row("solution", texts, texts("position.silent"), "alarm")]
    link = link_of(fix, state.corrections.max_age_s)
    satellites = UNKNOWN if fix.satellites is None else str(fix.satellites)
    constellations = f" ({fix.constellations})" if fix.constellations else ""
    return [
        _row("solution", texts, texts(f"solution.{fix.solution.name.lower()}"),
             SOLUTION_LEVELS.get(fix.solution, "warning"), "gnss"),
        _row("satellites", texts, satellites + constellations),
        _row("link", texts, texts(f"link.{link}"), LINK_LEVELS[link]),
        _row("correction_age", texts, number(fix.correction_age_s, 1, "s")),
    ]  # fmt: skip


def _pose(state: PageState, texts: Texts) -> list[Row]:
    pose = state.fresh("map_pose", MapPose)
    if pose is None or not pose.is_initialized:
        return [_row("source", texts, texts("source.none"), "alarm")]
    return [
        _row("source", texts, texts(f"source.{pose.source.name.lower()}"), SOURCE_LEVELS.get(pose.source, "warning")),
        _row("protection_level", texts, number(100.0 * pose.protection_level_m, 0, "cm")),
        _row("accuracy", texts, number(100.0 * pose.accuracy_95_m, 1, "cm")),
    ]
