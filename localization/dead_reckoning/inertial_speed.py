"""Forward speed of a machine without wheel sensors: the accelerometer between corrections by the graph."""

from collections import deque

KEEP_S = 6.0


class InertialSpeed:
    """Integrates the forward acceleration; 0 before the first correction."""

    def __init__(self) -> None:
        self._rows: deque[tuple[int, float]] = deque()
        self._offset_mps = 0.0
        self.bias_mps2 = 0.0

    def clear(self) -> None:
        """Drops the past, keeps the speed; after a gap."""
        self._offset_mps = self.speed_mps
        self._rows.clear()

    @property
    def speed_mps(self) -> float:
        """Speed at the newest sample."""
        return self._offset_mps + (self._rows[-1][1] if self._rows else 0.0)

    def advance(self, stamp_ns: int, acceleration_mps2: float) -> None:
        """Takes the forward acceleration, gravity taken out and bias not, over the interval that ends at a stamp."""
        before = self._rows[-1] if self._rows else (stamp_ns, 0.0)
        change_mps = (stamp_ns - before[0]) * 1e-9 * (acceleration_mps2 - self.bias_mps2)
        self._rows.append((stamp_ns, before[1] + change_mps))
        while stamp_ns - self._rows[0][0] > KEEP_S * 1e9:
            self._rows.popleft()

    def correct(self, stamp_ns: int, speed_mps: float, bias_mps2: float) -> None:
        """Sets the speed at a stamp of the last seconds, and the bias."""
        at_mps = next((v for s, v in reversed(self._rows) if s <= stamp_ns), self._rows[0][1] if self._rows else 0.0)
        self._offset_mps, self.bias_mps2 = speed_mps - at_mps, bias_mps2
