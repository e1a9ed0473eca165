"""Headline of a result: what was found, with its exact bound; never only "passed"."""

from collections.abc import Mapping
from typing import Any


def headline(result: Mapping[str, Any]) -> str:
    """One line: the state unless it is passed, the first reason of *not shown*, and both bounds."""
    both = "; ".join(bounds(result))
    if result["state"] == "failed":
        return f"failed: {'; '.join([*_over(result), both])}"
    if result["state"] == "not_shown":
        reasons = result["not_shown"]
        more = f" ({len(reasons)} reasons)" if len(reasons) > 1 else ""
        where = f"{reasons[0]['log']}: " if reasons and reasons[0]["log"] else ""
        return f"not shown: {where}{reasons[0]['reason'] if reasons else 'no trial'}{more}; {both}"
    return both


def bounds(result: Mapping[str, Any]) -> tuple[str, str]:
    """Missed encounters and false stops with their upper bounds."""
    return missed_bound(result["missed_share"]), false_stop_bound(result["false_stops_per_hour"])


def missed_bound(share: Mapping[str, Any] | None) -> str:
    """Number of missed encounters and the upper bound of their share."""
    if share is None:
        return "missed encounters: not shown"
    return f"{share['count']} of {share['of']} encounters missed: at most {_plain(100.0 * share['high'])} % (95 %)"


def false_stop_bound(rate: Mapping[str, Any] | None) -> str:
    """Number of false stops and the upper bound of their rate."""
    if rate is None:
        return "false stops: not shown"
    high = "no bound" if rate["high"] is None else f"at most {_plain(rate['high'])} per hour (95 %)"
    return f"{rate['count']} false stops in {duration(rate['hours'])}: {high}"


def duration(hours: float) -> str:
    """Hours in the largest unit of which they are at least one."""
    factor, unit = next((f, u) for f, u in ((1.0, "h"), (60.0, "min"), (3600.0, "s")) if f * hours >= 1.0 or u == "s")
    return f"{_plain(factor * hours)} {unit}"


def _plain(value: float) -> str:
    """Three digits without an exponent."""
    return f"{float(f'{value:.3g}'):,.12g}"


def _over(result: Mapping[str, Any]) -> list[str]:
    """What the result failed by, besides missed encounters and false stops."""
    late = result["outcomes"].get("late", 0)
    return [*([f"{late} late"] if late else []), *result["violations"]]
