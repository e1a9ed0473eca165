"""Packet captures written for tests: datagrams in Ethernet frames, in pcap files by dpkt or in pcapng blocks."""

import struct
from collections.abc import Iterable
from pathlib import Path

import dpkt

SECOND = 1_700_000_000
# receive time (s after SECOND), source address, destination port, payload
Packet = tuple[float, str, int, bytes]


def ethernet(source: str, port: int, payload: bytes, vlans: int = 0) -> bytes:
    """One Ethernet frame, with VLAN tags."""
    udp = dpkt.udp.UDP(sport=port, dport=port, data=payload, ulen=8 + len(payload))
    address = bytes(int(part) for part in source.split("."))
    ip = dpkt.ip.IP(src=address, dst=b"\x0a\x00\x00\x01", p=17, data=udp, len=28 + len(payload))
    tags = b"".join(struct.pack(">HH", 0x8100, 5 + k) for k in range(vlans))
    return bytes(12) + tags + struct.pack(">H", 0x0800) + bytes(ip)


def fragments(frame: bytes, size: int = 1480) -> list[bytes]:
    """An untagged Ethernet frame as frames with IP fragments."""
    head, content = bytearray(frame[14:34]), frame[34:]
    out = []
    for at in range(0, len(content), size):
        piece = content[at : at + size]
        struct.pack_into(">H", head, 2, 20 + len(piece))
        struct.pack_into(">H", head, 6, (0x2000 if at + size < len(content) else 0) | at // 8)
        out.append(frame[:14] + bytes(head) + piece)
    return out


def write_pcap(path: Path, frames: Iterable[tuple[float, bytes]], link: int = 1, nano: bool = False) -> Path:
    """A pcap file; times in s after SECOND."""
    with path.open("wb") as file:
        writer = dpkt.pcap.Writer(file, snaplen=65535, linktype=link, nano=nano)
        for time_s, frame in frames:
            writer.writepkt(frame, SECOND + time_s)
    return path


def write_packets(path: Path, packets: Iterable[Packet]) -> Path:
    """A pcap file with UDP datagrams."""
    return write_pcap(path, ((t, ethernet(source, port, payload)) for t, source, port, payload in packets))


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    """One pcapng block."""
    body += bytes(-len(body) % 4)
    size = struct.pack(f"{order}I", len(body) + 12)
    return struct.pack(f"{order}I", kind) + size + body + size


def section(order: str = "<") -> bytes:
    return block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(link: int, resolution: int | None = None, order: str = "<") -> bytes:
    option = b"" if resolution is None else struct.pack(f"{order}HHB3xHH", 9, 1, resolution, 0, 0)
    return block(1, struct.pack(f"{order}HHI", link, 0, 65535) + option, order)


def packet(number: int, ticks: int, frame: bytes, order: str = "<") -> bytes:
    head = struct.pack(f"{order}IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame))
    return block(6, head + frame, order)
