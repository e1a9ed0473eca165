"""Locations of recordings: samples in tests/data, and larger ones in HEADLAND_DATA (default ../shared/data)."""

from pathlib import Path

import pytest

from benchmarks.recordings import DATA, ROOT

SAMPLES = ROOT / "tests" / "data"
REASON = "needs recordings"


def needs(*names: str) -> pytest.MarkDecorator:
    """Skips a test when one of these files or folders of DATA is absent; the reason names it."""
    missing = [name for name in names if not (DATA / name).exists()]
    return pytest.mark.skipif(bool(missing), reason=f"{REASON}: {', '.join(missing)} not in {DATA}")


def recording(name: str) -> Path:
    """A file or folder of DATA; skips the calling test when it is absent."""
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{REASON}: {name} not in {DATA}")
    return path
