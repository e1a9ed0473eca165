"""Stamps of the streams against their times of arrival: which clock is off, by how much, and why that may be."""

from array import array
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from localization.config import LocalizationConfig
from localization.localizer import IMU
from messages.message import Envelope

GPS_EPOCH_S = 315_964_800  # of 1980 after 1970
GPS_AHEAD_S = (13, 18)  # of UTC, by the leap seconds from 1999 and since 2017
POWER_ON_S = 1e8  # stamps below are no dates
ZONE_S, LARGEST_ZONE_S, TOLERANCE_S = 1800, 14 * 3600, 5.0


@dataclass
class Clocks:
    """Stamps and arrivals by topic; `names` has the name of each topic for the user."""

    names: Mapping[str, str]
    config: LocalizationConfig
    _stamps: "defaultdict[str, array[int]]" = field(default_factory=lambda: defaultdict(lambda: array("q")))
    _ahead: "defaultdict[str, array[int]]" = field(default_factory=lambda: defaultdict(lambda: array("q")))

    def add(self, envelope: Envelope) -> None:
        """Takes a message."""
        stamp_ns = envelope.message.stamp_ns
        self._stamps[envelope.topic].append(stamp_ns)
        self._ahead[envelope.topic].append(stamp_ns - envelope.receive_ns)

    def count(self, topic: str) -> int:
        """Number of messages of a topic."""
        return len(self._stamps[topic])

    def notes(self) -> list[str]:
        """One sentence for each topic whose stamps the localizer cannot use, or which has no time in common."""
        return [note for topic in self.names if self.count(topic) and (note := self._note(topic))]

    def _note(self, topic: str) -> str:
        stamps, name, cfg = np.array(self._stamps[topic]), self.names[topic], self.config
        ahead_s = float(np.median(self._ahead[topic])) * 1e-9
        if not -cfg.max_sample_age_s <= ahead_s <= cfg.max_sample_lead_s:
            limit_s = cfg.max_sample_lead_s if ahead_s > 0.0 else cfg.max_sample_age_s
            what = f"the time of arrival (at most {limit_s:g} s are allowed)"
            return f"{name}: stamps {_apart(ahead_s)} {what}{_cause(ahead_s, float(np.median(stamps)) * 1e-9)}"
        imu = np.array(self._stamps[IMU])
        if topic == IMU or not len(imu) or (stamps.min() <= imu.max() and imu.min() <= stamps.max()):
            return ""
        first_s = float(stamps.min() - imu.min()) * 1e-9
        what = f"those of {self.names[IMU]}, without a time in common"
        return f"{name}: stamps {_apart(first_s)} {what}{_cause(first_s, float(np.median(stamps)) * 1e-9)}"


def _apart(ahead_s: float) -> str:
    return f"{abs(ahead_s):.2f} s {'ahead of' if ahead_s > 0.0 else 'behind'}"


def _cause(ahead_s: float, stamp_s: float) -> str:
    """The likely cause of a clock that is ahead; "" when none is known."""
    apart_s, (fewest_s, most_s) = abs(ahead_s), GPS_AHEAD_S
    if abs(apart_s - GPS_EPOCH_S) < 60.0:
        return ": seconds since 1980, the epoch of GPS?"
    if fewest_s - 0.5 < apart_s < most_s + 0.5:
        return ": GPS time, which is ahead of UTC by the leap seconds (18 s since 2017)?"
    if ahead_s < 0.0 and 0.0 <= stamp_s < POWER_ON_S:
        return ": seconds since power-on?"
    zones = round(apart_s / ZONE_S)
    if zones and apart_s < LARGEST_ZONE_S + TOLERANCE_S and abs(apart_s - zones * ZONE_S) < TOLERANCE_S:
        return f": time zone ({zones * ZONE_S / 3600:g} h)?"
    return ""
