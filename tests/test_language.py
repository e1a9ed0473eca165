"""Vocabulary: words of the project's former private language do not return (docs/glossary.md has the terms)."""

import re
import subprocess

import pytest

from tests.recordings import ROOT

# Each word is written in two parts so that this file does not contain it.
WORDS = ("to" "ld", "wi" "sh", "look" "out", "he" "lm", "gau" "ge", "sight" "ing", "an" "ew", "hea" "rs")  # fmt: skip
FORMER = re.compile(rf"\b({'|'.join(WORDS)})\b", re.IGNORECASE)
QUOTED_NAMES = re.compile(r"`[^`]*`")  # CHANGELOG.md quotes former names, so that users find what replaces them
SUFFIXES = (".py", ".yaml", ".md", ".toml", ".html", ".dbc", ".sh")


def files() -> list[str]:
    """Tracked text files: code, configuration, tests, documents and scripts."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    return [name for name in listed if name.endswith(SUFFIXES) or name in ("headland", "Makefile", ".ci/run")]


def test_former_words() -> None:
    found = [
        f"{name}:{number}: {line.strip()}"
        for name in files()
        for number, line in enumerate((ROOT / name).read_text(encoding="utf-8").splitlines(), 1)
        if FORMER.search(QUOTED_NAMES.sub("", line) if name == "CHANGELOG.md" else line)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("text", ["It is to" "ld.", "An" "ew", "a hea" "rs b"])  # fmt: skip
def test_a_former_word_is_found(text: str) -> None:
    assert FORMER.search(text)
