"""Hesai packet layouts and firing times (little-endian, azimuth in 0.01°), from the user manuals.

header (0, 8 or 12 bytes) │ blocks of azimuth and channels (distance, reflectivity) │ tail │ sequence number
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from geometry.arrays import Int64

START = b"\xee\xff"
BLOCK_START = b"\xff\xee"  # of each block of a Pandar40P, which has no header
# Offset of return mode, date and microseconds in the tail; its size; year 0 of the date.
TAILS = {
    "pandar": {"mode": 14, "date": 16, "us": 10, "size": 22, "year": 2000},
    "qt": {"mode": 16, "date": 18, "us": 12, "size": 24, "year": 1900},
    "xt": {"mode": 10, "date": 13, "us": 19, "size": 24, "year": 1900},
}
RETURNS = dict.fromkeys((51, 52, 55, 56), 1) | dict.fromkeys((57, 58, 59, 60), 2) | {0x3D: 3}
_PANDAR40P_NS = (
    -42220, -28470, -16040, -3620, -45490, -31740, -47460, -54670, -20620, -33710, -40910, -8190, -20620, -27160,
    -50730, -8190, -14740, -36980, -45490, -52700, -23890, -31740, -38950, -11470, -18650, -25190, -48760, -6230,
    -12770, -35010, -21920, -9500, -43520, -29770, -17350, -4920, -42220, -28470, -16040, -3620,
)  # fmt: skip
_PANDAR64_NS = (
    -23180, -21876, -20572, -19268, -17964, -16660, -11444, -46796, -7532, -36956, -50732, -54668, -40892, -44828,
    -31052, -34988, -48764, -52700, -38924, -42860, -29084, -33020, -46796, -25148, -36956, -50732, -27116, -40892,
    -44828, -31052, -34988, -48764, -25148, -38924, -42860, -29084, -33020, -52700, -6228, -54668, -15356, -27116,
    -10140, -23180, -4924, -21876, -14052, -17964, -8836, -19268, -3620, -20572, -12748, -16660, -7532, -11444, -6228,
    -15356, -10140, -4924, -3620, -14052, -8836, -12748,
)  # fmt: skip
_QT64_NS = (
    12310, 14370, 16430, 18490, 20540, 22600, 24660, 26710, 29160, 31220, 33280, 35340, 37390, 39450, 41500, 43560,
    46610, 48670, 50730, 52780, 54840, 56900, 58950, 61010, 63450, 65520, 67580, 69630, 71690, 73740, 75800, 77860,
    80900, 82970, 85020, 87080, 89140, 91190, 93250, 95300, 97750, 99820, 101870, 103930, 105980, 108040, 110100,
    112150, 115200, 117260, 119320, 121380, 123430, 125490, 127540, 129600, 132050, 134110, 136170, 138220, 140280,
    142340, 144390, 146450,
)  # fmt: skip


@dataclass(frozen=True)
class Model:
    """Layout of one model; a channel fires `first_ns` + `period_ns` · firing + `channels_ns` after the packet's time.

    Firings count up from the first block, or with `is_end` down from the last one. `angles_deg` are the highest
    elevation and its step, where the manual has them as design values with azimuth 0.
    """

    name: str
    channels: int
    blocks: int
    channel_bytes: int
    header: Literal[0, 8, 12]
    tail: str
    first_ns: int
    period_ns: float
    channels_ns: tuple[int, ...]
    is_end: bool = True
    angles_deg: tuple[float, float] | None = None

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """One packet without its sequence number."""
        tail = TAILS[self.tail]
        channel = np.dtype(
            {"names": ["distance", "reflectivity"], "formats": ["<u2", "u1"], "itemsize": self.channel_bytes}
        )
        block: list[Any] = [("azimuth", "<u2"), ("channels", channel, self.channels)]
        if self.header == 0:
            block.insert(0, ("start", "<u2"))
        head: list[Any] = [("header", f"V{self.header}")] if self.header else []
        return np.dtype([*head, ("blocks", block, self.blocks), ("tail", "u1", tail["size"])])

    def firing_ns(self, returns: int) -> Int64:
        """Time of each channel (blocks, channels) against that of the packet."""
        block = np.arange(self.blocks)
        firing = -((self.blocks - 1 - block) // returns) if self.is_end else block // returns
        times: Int64 = (self.first_ns + (self.period_ns * firing).astype(np.int64))[:, None] + np.array(
            self.channels_ns
        )
        return times


def _even(first: int, step: int, count: int, again: int = 1) -> tuple[int, ...]:
    return tuple(first + step * k for k in range(count)) * again


MODELS = (
    Model("Pandar40P", 40, 10, 3, 0, "pandar", -28_580, 55_560, _PANDAR40P_NS),
    Model("Pandar64", 64, 6, 3, 8, "pandar", -42_580, 55_560, _PANDAR64_NS),
    Model("PandarQT64", 64, 4, 4, 12, "qt", 25_710, 500_000 / 3, _QT64_NS, False),
    Model("PandarXT16", 16, 8, 4, 12, "xt", 5_632, 50_000, _even(368, 3024, 16), angles_deg=(15.0, -2.0)),
    Model("PandarXT32", 32, 8, 4, 12, "xt", 5_632, 50_000, _even(368, 1512, 32), angles_deg=(15.0, -1.0)),
    Model("PandarXT32M", 32, 6, 4, 12, "xt", 5_632, 50_000, _even(368, 2888, 16, 2), angles_deg=(19.5, -1.3)),
)


def model_of(payload: bytes) -> Model | None:
    """The model of a packet, by its header and size; None for other content."""
    for model in MODELS:
        if len(payload) - model.dtype.itemsize not in (0, 4):
            continue
        sizes = {0: b"", 8: payload[2:4], 12: payload[6:8]}[model.header]
        start = START if model.header else BLOCK_START
        if payload[:2] == start and sizes in (b"", bytes([model.channels, model.blocks])):
            return model
    return None
