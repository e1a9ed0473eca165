"""Alarms for the operator: the cause first, at most one new alarm a second, in English and Chinese."""

from collections.abc import Iterable, Mapping

from messages.command import RuleResult
from messages.faults import Fault, Response, Severity

SPACING_NS = 1_000_000_000


def text_zh(texts: Mapping[str, str], code: str) -> str:
    """The Chinese text of a code: its own, else that of the pattern `*<ending>` with the rest of the code put in."""
    if code in texts:
        return texts[code]
    name, dot, state = code.rpartition(".")
    pattern = f"*{dot}{state}"
    return texts[pattern].format(name) if pattern in texts else texts.get("*", "{}").format(code)


def alarm(now_ns: int, result: RuleResult, text: str, is_active: bool) -> Fault:
    """A rule's result as a fault message; what does not stop the machine is a warning."""
    is_stop = result.response >= Response.CONTROLLED_STOP
    return Fault(
        now_ns,
        result.code,
        "supervisor",
        Severity.ALARM if is_stop else Severity.WARNING,
        is_stop,
        result.response,
        is_active,
        result.text,
        text,
    )


class Alarms:
    """Turns the results that hold now into messages on change; `texts` are the Chinese texts of all rules."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        self._texts = texts
        self._active: dict[str, RuleResult] = {}
        self._last_ns: int | None = None

    def update(self, now_ns: int, results: Iterable[RuleResult]) -> list[Fault]:
        """What ended, and the first of what is new once the last alarm is a second old."""
        wanted = {result.code: result for result in reversed(tuple(results))}
        ended = [self._active.pop(code) for code in tuple(self._active) if code not in wanted]
        out = [self._alarm(now_ns, result, False) for result in ended]
        new = next((wanted[code] for code in reversed(wanted) if code not in self._active), None)
        if new is not None and (self._last_ns is None or abs(now_ns - self._last_ns) >= SPACING_NS):
            self._active[new.code], self._last_ns = new, now_ns
            out.append(self._alarm(now_ns, new, True))
        return out

    def _alarm(self, now_ns: int, result: RuleResult, is_active: bool) -> Fault:
        return alarm(now_ns, result, text_zh(self._texts, result.code), is_active)
