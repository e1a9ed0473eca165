"""Parts of a rotated log, `log.mcap`, `log.2.mcap`, ...: readers take the first one for all of them.

Each part is a complete MCAP file. All but the last end with the metadata `continued`, and all but the first begin with
the metadata `part`; both have the digest of all messages before, by which a part is known to belong to the one before.
"""

import re
from dataclasses import dataclass
from pathlib import Path

PART, CONTINUED = "part", "continued"
SUFFIX = ".mcap"


@dataclass(frozen=True)
class PartName:
    """Name of a part: the path of the first one, and its number from 1."""

    first: Path
    number: int

    @property
    def path(self) -> Path:
        """Path of this part."""
        first = self.first
        return first if self.number == 1 else first.with_name(f"{first.stem}.{self.number}{first.suffix}")

    @property
    def next(self) -> "PartName":
        """The part after this one."""
        return PartName(self.first, self.number + 1)


def part_name(path: Path, number: int) -> PartName:
    """Name of a part of which path and number are known."""
    end = f".{number}{path.suffix}"
    is_later = number > 1 and path.name.endswith(end)
    return PartName(path.with_name(path.name.removesuffix(end) + path.suffix) if is_later else path, number)


def parts_after(path: Path) -> list[Path]:
    """Files named as further parts of the log `path`, in order; empty for files that are no MCAP files."""
    if path.suffix != SUFFIX:
        return []
    pattern = re.compile(re.escape(path.stem) + r"\.([0-9]+)" + re.escape(SUFFIX))
    found = [(int(m[1]), p) for p in path.parent.glob(f"*{SUFFIX}") if (m := pattern.fullmatch(p.name))]
    return [p for _, p in sorted(found)]


def files_of(path: Path) -> list[Path]:
    """The file of a log and those named as its further parts."""
    return [path, *parts_after(path)]
