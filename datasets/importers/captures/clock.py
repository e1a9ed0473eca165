"""Time of a sensor on the clock of the capture."""

# A larger difference means that the clocks are not synchronized.
SYNCHRONIZED_NS = 500_000_000
# Largest drift between two unsynchronized clocks.
DRIFT = 1e-4


class SensorClock:
    """Stamps of one sensor; `offset_ns` is added to them.

    A sensor within 0.5 s of the time of reception keeps its stamps. Otherwise (time since power-on, TAI) the offset is
    the smallest difference seen between reception and stamp, which may grow by 100 ppm; after a jump it is taken again.
    """

    def __init__(self) -> None:
        self.offset_ns = 0
        self._last_ns = 0

    def stamp_ns(self, device_ns: int, receive_ns: int) -> int:
        """Stamp of a packet sent at `device_ns` of the sensor's clock and received at `receive_ns`."""
        delay_ns = receive_ns - device_ns
        if abs(delay_ns - self.offset_ns) > SYNCHRONIZED_NS:
            self.offset_ns = delay_ns if abs(delay_ns) > SYNCHRONIZED_NS else 0
        elif self.offset_ns:
            grown_ns = self.offset_ns + round(max(0, receive_ns - self._last_ns) * DRIFT)
            self.offset_ns = min(grown_ns, delay_ns)
        self._last_ns = receive_ns
        return device_ns + self.offset_ns
