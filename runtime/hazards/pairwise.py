"""Pairwise list: rows of one level per factor so that every possible pair of levels of two factors is in some row.

Greedy (Cohen 1997, AETG): each row begins with a pair that is not covered yet and takes, factor by factor, the level
that covers most further pairs; early rows so cover most. Writes the rows to `configs/hazards.yaml`.
"""

from itertools import combinations

from configs.strict import parse, read_yaml
from runtime.hazards.cases import FILE, HazardList, Row

Pair = tuple[tuple[int, str], tuple[int, str]]
MARK = "drives: # generated\n"


def pairs_of(row: dict[int, str]) -> set[Pair]:
    """Pairs of (factor, level) in a row or part of one."""
    return {(a, b) for a, b in combinations(sorted(row.items()), 2)}


def possible_pairs(hazards: HazardList) -> set[Pair]:
    """All pairs that some row can have."""
    levels = list(hazards.factors.values())
    return {
        ((i, a), (j, b))
        for i, j in combinations(range(len(levels)), 2)
        for a in levels[i]
        for b in levels[j]
        if hazards.is_possible({i: a, j: b})
    }


def rows_of(hazards: HazardList) -> list[Row]:
    """The list."""
    levels, left, rows = list(hazards.factors.values()), possible_pairs(hazards), list[Row]()
    used: dict[tuple[int, str], int] = {}

    def gain(row: dict[int, str], factor: int, level: str) -> tuple[int, int, int]:
        """Pairs that a level adds; then those that it still lacks with other levels; then how seldom it was used."""
        open_pairs = sum((factor, level) in pair for pair in left)
        return len(pairs_of({**row, factor: level}) & left), open_pairs, -used.get((factor, level), 0)

    while left:
        (i, a), (j, b) = max(sorted(left), key=lambda p: sum(one in q for q in left for one in p))
        row = {i: a, j: b}
        for factor in range(len(levels)):
            if factor not in row:
                fits = [x for x in levels[factor] if hazards.is_possible({**row, factor: x})]
                row[factor] = max(fits, key=lambda x, f=factor: gain(row, f, x))  # type: ignore[misc]
        for one in row.items():
            used[one] = used.get(one, 0) + 1
        left -= pairs_of(row)
        rows.append((row[0], row[1], row[2], row[3]))
    return rows


def main() -> None:
    """Writes the list."""
    text = FILE.read_text(encoding="utf-8").partition(MARK)[0]
    rows = rows_of(parse(HazardList, read_yaml(FILE) | {"drives": []}, str(FILE)))
    lines = "".join(f"  - [{', '.join(row)}]\n" for row in rows)
    FILE.write_text(text + MARK + lines, encoding="utf-8")


if __name__ == "__main__":
    main()
