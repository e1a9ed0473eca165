"""An attack: a drive with what is wrong in its log, and the reason for which it must not pass."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tests.validation.attacks.damages import Change
from tests.validation.attacks.recorded import Bench, drive, reasons, standing, vehicle_values
from tests.validation.obstacle_stop.consistency.world import Actor, Drive

PERSON = standing(9, 16.0, 0.2)
DRIVE = drive(PERSON)
FRONT_M, HALF_M = 3.6, 0.3


def unchanged(envelopes: list) -> list:
    """The log as it is."""
    return envelopes


def gap_m(t_s: float, x_m: float) -> float:
    """Gap of a drive at 4 m/s to a person who stands at x."""
    return x_m - HALF_M - FRONT_M - 4.0 * t_s


def blind(t_s: float) -> bool:
    """No returns."""
    return False


def two(**values: Any) -> Drive:
    """A person at 14 m who returns nothing and is run over, and one at 24 m for whom the stack stops in time."""
    return drive(standing(7, 14.0, 0.2, has_returns=blind), standing(9, 24.0, 0.2), seconds=5.0, **values)


def configured(**lidar: Any) -> dict[str, Any]:
    """Vehicle file with another lidar."""
    values = vehicle_values(DRIVE)
    values["sensors"]["lidar"]["top"] |= lidar
    return values


def with_body(**body: float) -> dict[str, Any]:
    """Vehicle file with another outline."""
    values = vehicle_values(DRIVE)
    values["body"] |= body
    return values


def mounted(axis: int, by: float, is_angle: bool) -> Drive:
    """The drive with one value of the configured mount wrong (m or degrees)."""
    xyz, rpy = [1.0, 0.0, 1.9], [0.0, 0.0, 0.0]
    (rpy if is_angle else xyz)[axis] += by
    return drive(PERSON, configured=(tuple(xyz), tuple(rpy)))


@dataclass(frozen=True)
class Attack:
    """`reason` is searched in the lines of `reasons`; `state` is that of the result."""

    state: str
    reason: str
    drive: Drive = DRIVE
    change: Change = unchanged
    vehicle: dict[str, Any] | None = None
    about: dict[str, Any] | None = None
    conditions: dict[str, Any] = field(default_factory=dict)

    def check(self, bench: Bench) -> dict[str, Any]:
        """Judges the log; returns the result."""
        result = bench.judge(self.drive, self.change, self.vehicle, self.about, **self.conditions)
        assert result["state"] == self.state, reasons(result)
        assert re.search(self.reason, reasons(result)), reasons(result)
        assert result["headline"].startswith(self.state.replace("_", " "))
        return result


def person(has_returns: Callable[[float], bool], x_m: float = 16.0) -> Actor:
    """A person in the path with returns at some times only."""
    return standing(9, x_m, 0.2, has_returns=has_returns)
