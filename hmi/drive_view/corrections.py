"""Link of the GNSS corrections, by what the receivers report: received, too old, or none; an alarm when it fails."""

from typing import Literal

from messages.fault_reporter import FaultReporter, FaultType
from messages.faults import Fault, Response, Severity
from messages.sensors import GnssFix

Link = Literal["received", "old", "none"]
FAILED_NS = 2_000_000_000  # without corrections, then the alarm: a single fix without them is no failure
LOST = FaultType(
    "corrections.lost", Severity.ALARM, Response.NONE, "GNSS corrections have failed", "卫星差分改正中断"
)  # fmt: skip


def link_of(fix: GnssFix, max_age_s: float) -> Link:
    """State of the link; a solution without corrections has no age of them."""
    if not fix.correction_age_s >= 0.0:
        return "none"
    return "received" if fix.correction_age_s <= max_age_s else "old"


class CorrectionWatch:
    """Alarm when no receiver has corrections any more that one of them had before."""

    def __init__(self, max_age_s: float) -> None:
        self.max_age_s = max_age_s
        self._received_ns: int | None = None
        self._faults = FaultReporter("corrections")

    def take(self, now_ns: int, fixes: list[GnssFix]) -> list[Fault]:
        """Begin or end of the alarm, by the newest fixes that are not too old."""
        if any(link_of(fix, self.max_age_s) == "received" for fix in fixes):
            self._received_ns = now_ns
        is_lost = self._received_ns is not None and now_ns - self._received_ns > FAILED_NS
        return self._faults.update(now_ns, [(LOST, is_lost)])
