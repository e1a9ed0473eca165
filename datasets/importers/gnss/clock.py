"""GPS time and UTC, and times that receivers state within a day or a week only."""

from datetime import date

S = 1_000_000_000
DAY_NS = 86_400 * S
WEEK_NS = 7 * DAY_NS
# A time may be before the last one by this much: lines of two receivers, or a clock that was set.
BACK_NS = 60 * S
# Days on which a leap second had been inserted since the start of GPS time (IERS Bulletin C; none since 2017)
LEAP_DAYS = (
    (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7), (1994, 7),
    (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
)  # fmt: skip


def day_ns(day: date) -> int:
    """Midnight of a day as Unix time."""
    return (day - date(1970, 1, 1)).days * DAY_NS


GPS_START_NS = day_ns(date(1980, 1, 6))
_LEAPS_NS = tuple(day_ns(date(year, month, 1)) for year, month in LEAP_DAYS)


def utc_of_gps(gps_ns: int) -> int:
    """Unix time of a GPS time (ns since 1980-01-06); within a leap second the one after it."""
    unix_ns = GPS_START_NS + gps_ns
    return unix_ns - sum(unix_ns >= leap_ns + k * S for k, leap_ns in enumerate(_LEAPS_NS, start=1)) * S


def gps_of_utc(unix_ns: int) -> int:
    """GPS time (ns since 1980-01-06) of a Unix time."""
    return unix_ns - GPS_START_NS + sum(unix_ns >= leap_ns for leap_ns in _LEAPS_NS) * S


class Calendar:
    """Times of a stream that states the time within a period (day, week) always and the period itself only sometimes.

    A stream goes forwards: a time is the first one after the last time less a minute, so rollovers need no other rule.
    Without a date the times count from `start_ns` >= 0; that of another calendar with the same stream read before is
    the right one from the first time on.
    """

    def __init__(self, period_ns: int, start_ns: int = 0) -> None:
        self.start_ns: int | None = None
        self._period_ns, self._now_ns, self._from_ns = period_ns, start_ns + period_ns // 2, start_ns

    @property
    def now_ns(self) -> int:
        """The last time."""
        return self._now_ns

    def set(self, exact_ns: int) -> None:
        """Sets a time with its date; the first one determines `start_ns`."""
        if self.start_ns is None:
            self.start_ns = exact_ns - self.at(exact_ns % self._period_ns)
        self._now_ns, self._from_ns = exact_ns, exact_ns - BACK_NS

    def near(self, about_ns: int) -> None:
        """Sets an approximate time, such as that of a recorder: the next one is within half a period of it."""
        self._now_ns, self._from_ns = about_ns, about_ns - self._period_ns // 2

    def at(self, phase_ns: int) -> int:
        """The time with this phase of the period."""
        from_ns = max(0, self._from_ns)
        self._now_ns = from_ns + (phase_ns - from_ns) % self._period_ns
        self._from_ns = self._now_ns - BACK_NS
        return self._now_ns
