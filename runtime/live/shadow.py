"""`headland shadow --bus`: listen to a machine's bus, log every frame, tell what it says, and send nothing."""

import argparse
import json
import sys
import time
from typing import Any

import can

from configs.strict import CONFIGS, load
from datasets.log import LogWriter
from interfaces.can_receiver import Incoming
from messages.command import CanFrame, CanFrames, MachineState
from messages.errors import HeadlandError
from messages.message import Envelope, Message
from runtime.live.clock import Clock
from runtime.live.config import CanConfig, LiveConfig, open_bus
from runtime.run_folder import RunFolder, versions
from runtime.stack import load_stack

STATE_NS, FRAMES_NS, LINE_NS = 20_000_000, 100_000_000, 1_000_000_000
WAIT_S = 0.01


class Listener:
    """Frames in, messages out; it is given no way to send."""

    def __init__(self, tractor_address: int, own_address: int) -> None:
        self.incoming = Incoming(tractor_address)
        self.count = 0
        self._own_address = own_address
        self._frames: list[CanFrame] = []
        self._state_ns = self._frames_ns = 0

    def take(self, now_ns: int, frame: can.Message) -> None:
        """Take in one frame."""
        self.count += 1
        if frame.is_error_frame or frame.is_remote_frame or not frame.is_extended_id:
            self.incoming.rejected += frame.is_error_frame
            return
        data = bytes(frame.data)
        self._frames.append(CanFrame(now_ns, frame.arbitration_id, data))
        self.incoming.take(now_ns, self._own_address, frame.arbitration_id, data)
        self.incoming.claims, self.incoming.is_claim_requested = [], False  # others' matter: we are not there

    def due(self, now_ns: int) -> list[tuple[str, Message]]:
        """What is to be logged now."""
        outputs: list[tuple[str, Message]] = []
        if now_ns - self._state_ns >= STATE_NS:
            self._state_ns = now_ns
            outputs.append(("machine", self.incoming.state(now_ns)))
        if now_ns - self._frames_ns >= FRAMES_NS:
            self._frames_ns = now_ns
            outputs.append(("can/rx", CanFrames(now_ns, "machine", tuple(self._frames))))
            self._frames = []
        return outputs


def main(arguments: argparse.Namespace) -> int:
    """Listen until interrupted or for the time given; 0 when a frame was heard."""
    stack, live = load_stack(), load(LiveConfig, CONFIGS / "live.yaml")
    config = CanConfig(interface=arguments.interface, channel=arguments.bus, port=live.can.port)
    addresses = stack.interfaces.gateway
    listener = Listener(addresses.tractor_address, addresses.address)
    bus = open_bus(config)
    try:
        folder = RunFolder("shadow", arguments.out)
        conditions = versions()
        folder.record("conditions", conditions | {"bus": f"{config.interface}:{config.channel}"})
        with LogWriter(folder.path / "log.mcap", {"run": conditions}, stack.datasets.log) as log:
            _listen(bus, listener, log, arguments.for_s)
    finally:
        bus.shutdown()
    state = listener.incoming.state(0)
    result: dict[str, Any] = {"frames": listener.count, "rejected": state.rejected_frames, "run_dir": str(folder.path)}
    folder.record("result", {"result": result})
    folder.finish()
    sys.stdout.write(json.dumps(result) + "\n" if arguments.json else _told(result))
    return 0 if listener.count else 1


def _listen(bus: can.BusABC, listener: Listener, log: LogWriter, for_s: float | None) -> None:
    clock = Clock(time.time_ns(), time.monotonic_ns())
    began_ns = told_ns = clock()
    sequence: dict[str, int] = {}
    try:
        while for_s is None or clock() - began_ns < for_s * 1e9:
            frame = _receive(bus)
            now_ns = clock()
            if frame is not None:
                listener.take(now_ns, frame)
            for topic, message in listener.due(now_ns):
                sequence[topic] = sequence.get(topic, -1) + 1
                log.write(Envelope(topic, sequence[topic], now_ns, message))
            if now_ns - told_ns >= LINE_NS:
                told_ns = now_ns
                sys.stderr.write(_line(listener.count, listener.incoming.state(now_ns)))
    except KeyboardInterrupt:
        return


def _receive(bus: can.BusABC) -> can.Message | None:
    try:
        return bus.recv(WAIT_S)
    except can.CanError as error:
        raise HeadlandError(f"the bus fails: {error}") from error


def _line(count: int, state: MachineState) -> str:
    return (
        f"{count} frames, {state.rejected_frames} bad; {3.6 * state.speed_mps:.1f} km/h, curvature "
        f"{state.curvature_radpm:+.3f} 1/m, hitch {state.hitch:.0%}, {state.supply_v:.1f} V\n"
    )


def _told(result: dict[str, Any]) -> str:
    return f"{result['frames']} frames heard, {result['rejected']} bad, none sent; {result['run_dir']}\n"
