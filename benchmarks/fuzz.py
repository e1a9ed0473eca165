"""Fuzz test of CAN frames, NMEA lines, configuration files and logs: no crash, no invalid data accepted.

    ./headland benchmark fuzz [--count 1000000] [--seed 1]

Prints the numbers of inputs tried, refused and accepted. A crash ends it with its trace, and so does accepted invalid
data: a value outside the range of its format, a wrong checksum, a configuration outside its bounds, a message that was
not written.
"""

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from configs.mission import Mission
from configs.site import Site
from configs.strict import CONFIGS, Config, load, parse
from datasets.importers.gnss.framing import NMEA, frames
from datasets.importers.gnss.protocols import NmeaFixes, Timing
from datasets.importers.recording import Skipped
from datasets.log import LogConfig, LogWriter
from datasets.reader import read_log
from interfaces.can_receiver import CanReceiver
from interfaces.isobus.checksum import checksum, protect
from messages.errors import HeadlandError
from messages.message import Envelope
from messages.sensors import GnssFix, WheelSample
from simulation.scenario import Scenario

MS = 1_000_000
OWN, TRACTOR = 28, 240
FRAMES = (  # identifier and data of frames of a tractor; the two of the cab have a checksum
    (0x0CAC00F0 | OWN << 8, bytes.fromhex("807d150000ffffff")),
    (0x0CFE48F0, bytes.fromhex("d00700000000fffd")),
    (0x0CFE45F0, bytes.fromhex("c840ffffffffffff")),
    (0x0CFE43F0, bytes.fromhex("e010ffff40ffffff")),
    (0x0CF0E4F0, bytes([7])),
    (0x0CEF00F0 | OWN << 8, protect(0x0CEF00F0 | OWN << 8, bytes.fromhex("01007d007d007d"), 3)),
    (0x0CEF00F0 | OWN << 8, protect(0x0CEF00F0 | OWN << 8, bytes.fromhex("020000ff1401c0")[:7], 4)),
)
LINES = (
    "GNGGA,101112.30,5130.69000,N,00603.75000,E,4,21,0.7,24.100,M,46.500,M,1.2,0001",
    "GNRMC,101112.30,A,5130.69000,N,00603.75000,E,5.40,090.00,211126,,,R",
    "GNGST,101112.30,0.01,,,,0.008,0.009,0.015",
    "GNVTG,90.0,T,,M,5.40,N,10.0,K,R",
    "GNHDT,90.5,T",
)
FILES: tuple[tuple[type[Config], str], ...] = (
    (Mission, "missions/demo.yaml"), (Scenario, "scenarios/demo.yaml"), (Site, "sites/demo.yaml"),
)  # fmt: skip


class InvalidAccepted(AssertionError):
    """Invalid data was accepted."""


@dataclass
class Count:
    """Numbers of inputs of one kind."""

    tried: int = 0
    accepted: int = 0

    def add(self, is_accepted: bool) -> None:
        self.tried += 1
        self.accepted += is_accepted


def mutated(data: bytes, random: np.random.Generator) -> bytes:
    """Data with one to four changes: bit, byte, deletion, repetition, insertion, swap."""
    broken = bytearray(data)
    for _ in range(int(random.integers(1, 5))):
        if not broken:
            return bytes(random.bytes(3))
        k, how = int(random.integers(len(broken))), int(random.integers(6))
        if how == 0:
            broken[k] ^= 1 << int(random.integers(8))
        elif how == 1:
            broken[k] = int(random.integers(256))
        elif how == 2:
            del broken[k : k + int(random.integers(1, 9))]
        elif how == 3:
            broken[k:k] = broken[k : k + int(random.integers(1, 9))]
        elif how == 4:
            broken[k:k] = random.bytes(int(random.integers(1, 5)))
        else:
            other = int(random.integers(len(broken)))
            broken[k], broken[other] = broken[other], broken[k]
    return bytes(broken)


def fuzz_frames(count: int, random: np.random.Generator) -> Count:
    """CAN frames of the machine, read as by the gateway."""
    result, receiver, now_ns = Count(), CanReceiver(TRACTOR), 0
    for _ in range(count):
        identifier, data = FRAMES[int(random.integers(len(FRAMES)))]
        data = mutated(data, random)[:8]
        if random.random() < 0.2:
            identifier ^= 1 << int(random.integers(29))
        now_ns += MS
        rejected = receiver.rejected
        receiver.receive(now_ns, OWN, identifier, data)
        _check_state(receiver.state(now_ns), (identifier, data))
        is_cab = now_ns in (receiver.cab_ns, receiver.driver_steering_ns, receiver.fold_ns)
        if is_cab and checksum(identifier, data) != data[7] >> 4:
            raise InvalidAccepted(f"frame {identifier:08x} {data.hex()} was accepted with a wrong checksum")
        receiver.claims, receiver.is_claim_requested = [], False
        result.add(receiver.rejected == rejected)
    return result


BOUNDS = {
    "speed_mps": 64.3, "curvature_radpm": 8.1, "hitch": 1.01, "fold_position": 1.01, "pto_radps": 850.0,
    "brake_pedal": 1.01,
    "driver_torque_nm": 323.0, "driver_rate_radps": 33.0, "driver_angle_rad": 33.0, "supply_v": 3213.0,
}  # fmt: skip


def _check_state(state: object, given: object) -> None:
    for name, bound in BOUNDS.items():
        value = getattr(state, name)
        if not abs(value) <= bound:
            raise InvalidAccepted(f"{given}: {name} = {value}")


def fuzz_lines(count: int, random: np.random.Generator) -> Count:
    """NMEA lines of a GNSS receiver, read as by the importer."""
    result, fixes = Count(), NmeaFixes(Timing())
    for _ in range(count):
        line = mutated(_line(LINES[int(random.integers(len(LINES)))]), random)
        if random.random() < 0.3:  # valid checksum: errors must be found by the ranges of the fields
            line = _line(mutated(line[1:-5], random).decode("latin-1"))
        framed = [f for f in frames(line + b"\r\n") if f.protocol == NMEA and fixes.reads(f.kind)]
        items = [item for frame in framed for item in fixes.add(frame)]
        for item in items:
            if not isinstance(item, Skipped):
                assert isinstance(item[2], GnssFix)
                _check_fix(item[2], line)
        result.add(bool(framed) and not any(isinstance(item, Skipped) for item in items))
    return result


def _line(body: str) -> bytes:
    data, total = body.encode("latin-1"), 0
    for byte in data:
        total ^= byte
    return b"$" + data + f"*{total:02X}".encode()


def _check_fix(fix: GnssFix, line: bytes) -> None:
    position = (
        abs(fix.latitude_rad) <= 0.5 * math.pi and abs(fix.longitude_rad) <= math.pi and not abs(fix.height_m) >= 2e5
    )
    is_empty = fix.solution == 0 and math.isnan(fix.latitude_rad)
    sigmas = [*fix.sigma_enu_m, fix.hdop, fix.correction_age_s]
    is_speed = not np.hypot(*fix.velocity_enu_mps[:2]) > 515.0
    if not (position or is_empty or fix.solution == 0) or any(s < 0.0 for s in sigmas) or not is_speed:
        raise InvalidAccepted(f"{line!r} became {fix}")


def fuzz_files(count: int, random: np.random.Generator) -> Count:
    """Configuration files: refused with a HeadlandError, or within all bounds."""
    result = Count()
    texts = [(cls, (CONFIGS / name).read_bytes()) for cls, name in FILES]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.yaml"
        for _ in range(count):
            cls, text = texts[int(random.integers(len(texts)))]
            path.write_bytes(mutated(text, random))
            try:
                config = load(cls, path)
            except HeadlandError:
                result.add(False)
                continue
            _check_config(config, path.read_bytes())
            result.add(True)
    return result


def _check_config(config: Config, text: bytes) -> None:
    """Every number is finite, and writing and reading gives the same configuration."""
    for value in _leaves(config.model_dump()):
        if isinstance(value, float) and not math.isfinite(value):
            raise InvalidAccepted(f"{text!r}: {value} in a configuration")
    again = parse(type(config), yaml.safe_load(yaml.safe_dump(config.model_dump(mode="json"))), "again")
    if again != config:
        raise InvalidAccepted(f"{text!r}: differs after writing and reading")


def _leaves(value: object) -> Iterator[object]:
    if isinstance(value, dict):
        for inner in value.values():
            yield from _leaves(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _leaves(inner)
    else:
        yield value


def fuzz_logs(count: int, random: np.random.Generator) -> Count:
    """Bytes of a log: only messages that were written are read."""
    result = Count()
    with tempfile.TemporaryDirectory() as folder:
        complete, path = Path(folder) / "complete.mcap", Path(folder) / "log.mcap"
        config = LogConfig(chunk_kib=16, flush_s=0.1, sync_s=100.0, min_free_mb=0.0)
        with LogWriter(complete, {"about": {"seed": "1"}}, config) as log:
            for k in range(30):
                log.write(Envelope("wheel", k, 20 * k * MS, WheelSample(20 * k * MS, 0.1 * k, -0.01 * k)))
        written = {_plain(envelope) for envelope in read_log(complete)}
        data = complete.read_bytes()
        for _ in range(count):
            path.write_bytes(mutated(data, random))
            try:
                found = {_plain(envelope) for envelope in read_log(path)}
            except HeadlandError:
                result.add(False)
                continue
            if not found <= written:
                raise InvalidAccepted(f"{path.read_bytes().hex()}: {(found - written).pop()} was not written")
            result.add(found == written)
    return result


def _plain(envelope: Envelope) -> tuple[object, ...]:
    message = envelope.message
    values = tuple(getattr(message, f.name) for f in fields(message))
    return (envelope.topic, envelope.sequence, envelope.receive_ns, *values)


Fuzz = Callable[[int, np.random.Generator], Count]
# with the share of the count: a file takes a thousand times as long as a frame
INPUT_KINDS: dict[str, tuple[Fuzz, float]] = {
    "frames": (fuzz_frames, 0.5),
    "lines": (fuzz_lines, 0.35),
    "files": (fuzz_files, 0.05),
    "logs": (fuzz_logs, 0.1),
}


def main() -> None:
    """Runs all kinds and prints the counts."""
    words = argparse.ArgumentParser(description="mutated inputs: no crash, no invalid data accepted")
    words.add_argument("--count", type=int, default=1_000_000, help="of all kinds together")
    words.add_argument("--seed", type=int, default=1)
    arguments = words.parse_args()
    total = 0
    for k, (name, (fuzz, share)) in enumerate(INPUT_KINDS.items()):
        began_s = time.monotonic()
        found = fuzz(round(arguments.count * share), np.random.default_rng([arguments.seed, k]))
        total += found.tried
        counts = f"{found.tried} tried, {found.tried - found.accepted} refused, {found.accepted} accepted as valid"
        print(f"{name}: {counts}; {time.monotonic() - began_s:.0f} s")
    print(f"{total} mutated inputs: no crash, no invalid data accepted")


if __name__ == "__main__":
    main()
