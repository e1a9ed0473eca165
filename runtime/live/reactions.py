"""Reaction time from a visible obstacle to the brake frame on the CAN bus, by the stamps of scans and frames."""

import json
import time
from collections.abc import Iterable
from typing import Any

import can

from messages.errors import HeadlandError
from messages.node import Output, World
from messages.sensors import LidarScan
from runtime.live.can_bus import LoopbackBus
from simulation.actors.popup import PopUp
from simulation.randomness import generator
from simulation.world import SimulationWorld

BRAKE_GROUP = 0x04  # format byte of the external brake request
FULL_SCALE_MPS2, PER_MPS2 = 15.687, 2048.0
MIN_BRAKING_MPS2 = 1.0  # requested of the brakes: more than for any curve
AHEAD_M = 3.5  # inside the stopping distance at work speed, and more than the machine then needs


def requested_mps2(identifier: int, data: bytes | bytearray) -> float:
    """Deceleration that a frame requests of the brakes; 0 for other frames."""
    if identifier >> 16 & 0xFF != BRAKE_GROUP or len(data) != 8:
        return 0.0
    return FULL_SCALE_MPS2 - int.from_bytes(data[:2], "little") / PER_MPS2


class ReactionTrials(World):
    """Simulated world with a person who pops up repeatedly; writes one line per reaction to `reactions.jsonl`."""

    def __init__(self, world: SimulationWorld, bus: can.BusABC, start: Any) -> None:
        self.writes = world.writes
        self._world = world
        self._path = start.folder / "reactions.jsonl"
        setup = start.setup
        self._front = next(
            f"lidar/{name}" for name, one in setup.vehicle.sensors.lidar.items() if one.mount.xyz_m[0] > 0
        )
        self._popup = PopUp(world.machine, world.terrain, generator(setup.seed, "popup"), AHEAD_M)
        world.add_actor(self._popup)
        self._appeared: float | None = None  # wall time, as for frame stamps
        self._scanned: float | None = None
        if not isinstance(bus, LoopbackBus):
            raise HeadlandError(f"--reaction-trials: not on {bus.channel_info}, only on --bus loopback")
        bus.listener = self._on_frame

    def next_ns(self) -> int | None:
        """Time of the next step of the simulated world."""
        return self._world.next_ns()

    def step(self, now_ns: int) -> Iterable[Output]:
        """Steps the simulated world; records the pop-up and its first scan."""
        before = self._popup.count
        outputs = list(self._world.step(now_ns))
        if self._popup.count > before:
            self._appeared, self._scanned = time.time(), None
        if self._appeared is not None and self._scanned is None:
            scans = [m for topic, m in outputs if topic == self._front and isinstance(m, LidarScan)]
            self._scanned = time.time() if scans else None
        return outputs

    def _on_frame(self, frame: can.Message) -> None:
        if self._appeared is None or requested_mps2(frame.arbitration_id, frame.data) < MIN_BRAKING_MPS2:
            return
        scan_to_frame_s = None if self._scanned is None else frame.timestamp - self._scanned
        row = {"appeared_to_frame_s": frame.timestamp - self._appeared, "scan_to_frame_s": scan_to_frame_s}
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        self._appeared = None
