"""UDP datagrams of captured frames: Ethernet with VLAN tags, Linux cooked captures, raw IP; IPv4 reassembled, IPv6."""

import struct
from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from ipaddress import ip_address

from datasets.importers.captures.container import Frame

ETHERNET, NULL, LOOP, COOKED, COOKED_2 = 1, 0, 108, 113, 276
RAW = (12, 14, 101, 228, 229)
VLAN = (0x8100, 0x88A8, 0x9100)
IPV4, IPV6 = 0x0800, 0x86DD
TCP, UDP = 6, 17
# Datagrams under reassembly at the same time; the oldest one is given up first.
MAX_PARTIAL = 64
MAX_DATAGRAM = 65_535
# TCP connections counted apart.
MAX_FLOWS = 32
# first bytes → content that is not read
CONTENT = {
    b"\x02\x02\x02\x02\x01\0\0\0": "SICK compact segments", b"\x02\x02\x02\x02": "SICK CoLa B",
    b"\x02s": "SICK CoLa A", b"\xaa\x44": "NovAtel binary", b"\xee\xff": "another Hesai model",
    b"\xff\xee": "another Velodyne model",
}  # fmt: skip
UNKNOWN = "unknown content"


@dataclass(frozen=True, slots=True)
class Datagram:
    """One UDP datagram from address `source` to `port`."""

    receive_ns: int
    source: str
    port: int
    payload: bytes


@dataclass
class _Partial:
    """Fragments of a datagram by their offset; `size` is known from the last one."""

    pieces: dict[int, bytes] = field(default_factory=dict)
    size: int | None = None


class Network:
    """Datagrams from frames; other content is counted in `skipped` by (what, reason)."""

    def __init__(self) -> None:
        self.skipped: Counter[tuple[str, str]] = Counter()
        self._partial: OrderedDict[bytes, _Partial] = OrderedDict()
        self._names: dict[bytes, str] = {}
        self._flows: dict[str, Counter[str]] = {}

    def datagrams(self, frames: Iterable[Frame]) -> Iterator[Datagram]:
        """All complete datagrams, at the time of their last frame."""
        for frame in frames:
            try:
                found = self._datagram(frame)
            except struct.error:
                self.skipped["frame", f"of {len(frame.data)} bytes ends within its headers"] += 1
                continue
            if found is not None:
                yield found
        if self._partial:
            self.skipped["UDP", "fragments of a datagram are missing"] += len(self._partial)
            self._partial.clear()
        for flow, contents in self._flows.items():
            known = [name for name, _ in contents.most_common() if name != UNKNOWN]
            self.skipped[flow, f"{(known or [UNKNOWN])[0]} over TCP is not read"] += contents.total()
        self._flows.clear()

    def _datagram(self, frame: Frame) -> Datagram | None:
        kind, packet = _packet(frame)
        if kind == IPV4 and len(packet) >= 20:
            source, protocol, content = self._ipv4(packet)
        elif kind == IPV6 and len(packet) >= 40:
            source, protocol = packet[8:24], packet[6]
            content = packet[40 : 40 + struct.unpack_from(">H", packet, 4)[0]]
        else:
            self.skipped[_name_of(kind, frame.link)] += 1
            return None
        if content is None:
            return None
        if protocol != UDP:
            self._count(protocol, content)
            return None
        _, port, size, _ = struct.unpack_from(">HHHH", content)
        if not 8 <= size <= len(content):
            self.skipped[f"UDP port {port}", "datagrams cut off by the capture or of a wrong length"] += 1
            return None
        return Datagram(frame.receive_ns, self._name(source), port, content[8:size])

    def _count(self, protocol: int, content: bytes) -> None:
        """Counts a packet that is not UDP; the segments of a TCP connection together, as their content goes on."""
        if protocol != TCP or len(content) < 20:
            self.skipped[f"IP protocol {protocol}", "no sensor data"] += 1
            return
        source, port = struct.unpack_from(">HH", content)
        data = content[(content[12] >> 4) * 4 :]
        flow = f"TCP ports {source} to {port}"
        if flow not in self._flows and len(self._flows) >= MAX_FLOWS:
            flow = "other TCP ports"
        self._flows.setdefault(flow, Counter())[name_of_content(data)] += 1

    def _name(self, address: bytes) -> str:
        name = self._names.get(address)
        if name is None:
            name = self._names[address] = str(ip_address(address))
        return name

    def _ipv4(self, packet: bytes) -> tuple[bytes, int, bytes | None]:
        """Source, protocol and content; None while fragments are missing."""
        head = (packet[0] & 15) * 4
        size, _, flags = struct.unpack_from(">HHH", packet, 2)
        content = packet[head : size or len(packet)]  # 0: segmentation by the network card
        if flags & 0x3FFF:
            return packet[12:16], packet[9], self._reassembled(packet, content, flags)
        return packet[12:16], packet[9], content

    def _reassembled(self, packet: bytes, content: bytes, flags: int) -> bytes | None:
        key = packet[4:6] + packet[9:10] + packet[12:20]
        partial = self._partial.setdefault(key, _Partial())
        offset = (flags & 0x1FFF) * 8
        if not flags & 0x2000:
            partial.size = offset + len(content)
        partial.pieces[offset] = content
        whole = b"".join(piece for _, piece in sorted(partial.pieces.items()))
        if partial.size is not None and len(whole) == partial.size <= MAX_DATAGRAM:
            del self._partial[key]
            return whole
        if len(self._partial) > MAX_PARTIAL or len(whole) > MAX_DATAGRAM:
            self._partial.popitem(last=len(whole) > MAX_DATAGRAM)
            self.skipped["UDP", "fragments of a datagram are missing"] += 1
        return None


def _packet(frame: Frame) -> tuple[int, bytes]:
    """Ethernet type and packet of a frame; type -1 for an unknown link."""
    data = frame.data
    if frame.link == ETHERNET:
        kind, at = struct.unpack_from(">H", data, 12)[0], 14
    elif frame.link == COOKED:
        kind, at = struct.unpack_from(">H", data, 14)[0], 16
    elif frame.link == COOKED_2:
        kind, at = struct.unpack_from(">H", data)[0], 20
    elif frame.link in (*RAW, NULL, LOOP):
        at = 0 if frame.link in RAW else 4
        kind = {4: IPV4, 6: IPV6}.get(data[at] >> 4, 0) if len(data) > at else 0
    else:
        return -1, b""
    while kind in VLAN:
        kind, at = struct.unpack_from(">H", data, at + 2)[0], at + 4
    return kind, data[at:]


def _name_of(kind: int, link: int) -> tuple[str, str]:
    if kind == -1:
        return f"link type {link}", "its frames are not read"
    return {0x0806: "ARP"}.get(kind, f"Ethernet type 0x{kind:04x}"), "no sensor data"


def name_of_content(data: bytes) -> str:
    """What data that are not read hold, by their first bytes."""
    return next((name for begin, name in CONTENT.items() if data.startswith(begin)), UNKNOWN)
