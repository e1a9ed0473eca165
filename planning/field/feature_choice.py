"""Choice of one polygon among the fields of a file."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from messages.errors import FieldError
from planning.field.formats.contents import Feature, FieldFile, Rings, count_of

SHOWN = 8
DEGREE_M = 111_195.0
SLIVER_HA = 0.01  # a part that is smaller is no field


@dataclass(frozen=True)
class Choice:
    """A chosen polygon: its feature, the index of this in the file, and its name with the part."""

    feature: Feature
    index: int
    name: str
    rings: Rings


def choose(contents: FieldFile, wanted: str | None, where: str) -> Choice:
    """The polygon that `wanted` names, or the only one; raises FieldError that lists what there is.

    `wanted` is the name of a feature, its number from 1, or either with `.` and the number of a part. A name counts
    before a number.
    """
    features = contents.features
    if not features:
        beside = f", but {count_of(len(contents.lines), 'line')}" if contents.lines else ""
        raise FieldError(f"{where}: holds no polygon{beside}; give a file with the outline of a field")
    if wanted is None and len(features) > 1:
        raise FieldError(f"{where}: holds {len(features)} fields; choose one by --feature: {_listed(features)}")
    index, part = (0, None) if wanted is None else _find(features, wanted, where)
    feature = features[index]
    if feature.problem:
        raise FieldError(f"{where}: {_title(features, index)}{feature.problem}")
    large = [k for k, rings in enumerate(feature.parts) if _hectares(rings) >= SLIVER_HA]
    if part is None and len(large) == 1:
        part = large[0]
    if part is None and len(feature.parts) > 1:
        shown = [f"{index + 1}.{k + 1} ({_hectares(feature.parts[k]):.2f} ha)" for k in large]
        raise FieldError(
            f"{where}: {_title(features, index)}has {len(shown)} fields; choose one by --feature: {_joined(shown)}"
        )
    suffix = "" if len(feature.parts) == 1 else f".{(part or 0) + 1}"
    name = f"{feature.name}{suffix}" if feature.name else f"field {index + 1}{suffix}" if len(features) > 1 else ""
    return Choice(feature, index, name, feature.parts[part or 0])


def _find(features: Sequence[Feature], wanted: str, where: str) -> tuple[int, int | None]:
    """Index of a feature, and of a part or None."""
    text = wanted.strip()
    if (found := _feature(features, text, where)) is not None:
        return found, None
    stem, _, part = text.rpartition(".")
    if stem and part.isdecimal() and (found := _feature(features, stem, where)) is not None:
        count = len(features[found].parts)
        if features[found].problem or 1 <= int(part) <= count:
            return found, int(part) - 1
        raise FieldError(f"{where}: feature {stem!r} has {count_of(count, 'part')}, not a part {part}")
    raise FieldError(f"{where}: no feature {wanted[:60]!r}; there is: {_listed(features)}")


def _feature(features: Sequence[Feature], text: str, where: str) -> int | None:
    named = [k for k, f in enumerate(features) if f.name == text]
    named = named or [k for k, f in enumerate(features) if f.name.casefold() == text.casefold() != ""]
    if len(named) > 1:
        numbers = ", ".join(str(k + 1) for k in named[:SHOWN])
        raise FieldError(f"{where}: {len(named)} features are named {text!r}; choose one by its number: {numbers}")
    if named:
        return named[0]
    if text.isascii() and text.isdecimal() and 1 <= int(text[:9]) <= len(features):
        return int(text[:9]) - 1
    return None


def _title(features: Sequence[Feature], index: int) -> str:
    if len(features) == 1:
        return ""
    name = f" {features[index].name!r}" if features[index].name else ""
    return f"feature {index + 1}{name}: "


def _listed(features: Sequence[Feature]) -> str:
    shown = []
    for k, feature in enumerate(features[: SHOWN + 1]):
        name = f" {feature.name!r}" if feature.name else ""
        size = "unreadable" if feature.problem else f"{sum(map(_hectares, feature.parts)):.2f} ha"
        parts = f" in {len(feature.parts)} parts" if len(feature.parts) > 1 else ""
        shown.append(f"{k + 1}{name} ({size}{parts})")
    return _joined(shown, len(features))


def _joined(shown: list[str], count: int | None = None) -> str:
    more = (count or len(shown)) - SHOWN
    return ", ".join(shown) if more <= 0 else f"{', '.join(shown[:SHOWN])} and {more} more"


def _hectares(rings: Rings) -> float:
    """Approximate area of a polygon in degrees."""
    areas = [abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in pairwise(r))) / 2.0 for r in rings]
    scale = DEGREE_M**2 * math.cos(math.radians(rings[0][0][1] if rings[0] else 0.0))
    return (areas[0] - sum(areas[1:])) * scale / 1e4
