"""Runs mutants of safety/ and compares those that no test detects with survivors.yaml.

`make mutants` runs what is left to run. ONLY="safety.stopping_distance.* safety.modes.*" runs those again;
ONLY=survivors all that were not killed; ONLY=none nothing. A file newly in only_mutate needs `rm -r mutants` first.
"""

import json
import re
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import yaml
from mutmut.__main__ import cli
from mutmut.mutation.diff_apply import get_diff_for_mutant
from mutmut.stats import status_by_exit_code

ROOT = Path(__file__).parents[2]
ARGUED = ROOT / "tests/safety/survivors.yaml"
SURVIVED, UNSURE = {"survived", "no tests"}, {"timeout", "suspicious", "segfault"}
STRING = re.compile(r'"[^"]*"')

Change = tuple[str, str, str]  # function, lines before, lines after: the same when other lines of the file move


def results() -> dict[str, tuple[str, str]]:
    """File and status of every mutant by its name."""
    found = {}
    for meta in sorted((ROOT / "mutants/safety").rglob("*.meta")):
        file = str(meta.relative_to(ROOT / "mutants").with_suffix(""))
        codes = json.loads(meta.read_text())["exit_code_by_key"]
        found |= {name: (file, status_by_exit_code[code]) for name, code in codes.items()}
    return found


def change(name: str, file: str) -> Change:
    """Function and lines that a mutant changes."""
    lines = get_diff_for_mutant(name, path=file).splitlines()[2:]
    before, after = (" ".join(line[1:].strip() for line in lines if line.startswith(sign)) for sign in "-+")
    function = name.partition("__mutmut_")[0].replace(".x_", ".").replace(".xǁ", ".").replace("ǁ", ".")
    return function, before, after


def is_wording(before: str, after: str) -> bool:
    """Whether only a text for operators changed: no code, topic or key has a space."""

    def bare(line: str) -> str:
        return STRING.sub(lambda text: '" "' if " " in text[0] else text[0], line)

    return bare(before) == bare(after)


def argued() -> Counter[Change]:
    """Survivors argued in survivors.yaml."""
    groups = yaml.safe_load(ARGUED.read_text())
    return Counter((one["in"], one["was"], one["now"]) for group in groups for one in group["mutants"])


def listed(title: str, changes: Iterable[Change]) -> None:
    for function, before, after in changes:
        print(f"{title}: {function}\n  - in: {function}\n    was: {before!r}\n    now: {after!r}")


def main(only: list[str]) -> int:
    """0 when all mutants were run, every survivor is argued, and every argued one still survives."""
    if only == ["survivors"]:
        only = [name for name, (_, status) in results().items() if status in SURVIVED | UNSURE]
    if only != ["none"]:
        (ROOT / "mutants/mutmut-stats.json").unlink(missing_ok=True)  # coverage by test, collected again
        cli(["run", "--max-children", "1", *only], standalone_mode=False)
    found = results()
    survivors = Counter(change(name, file) for name, (file, status) in found.items() if status in SURVIVED)
    wording = Counter({key: count for key, count in survivors.items() if is_wording(*key[1:])})
    unargued, gone = survivors - wording - argued(), argued() - survivors
    listed("not argued", unargued.elements())
    listed("survives no more", gone.elements())
    counts = Counter(status for _, status in found.values())
    print(", ".join(f"{count} {status}" for status, count in counts.most_common()))
    print(f"of the survivors {wording.total()} only in the wording of a text, {unargued.total()} not argued")
    return 1 if unargued or gone or counts["not checked"] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
