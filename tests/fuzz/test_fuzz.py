"""A short run of what `benchmarks/fuzz.py` does a million times, and that it can fail."""

import numpy as np
import pytest

from benchmarks import fuzz
from interfaces.isobus.checksum import SealCheck


@pytest.mark.parametrize(("name", "count"), [("frames", 5000), ("lines", 3000), ("files", 60), ("logs", 200)])
def test_no_crash_and_nothing_wrong_is_accepted(name: str, count: int) -> None:
    found = fuzz.KINDS[name][0](count, np.random.default_rng(7))
    assert found.tried == count
    assert 0 < found.accepted < count


def test_a_reader_that_looks_at_no_checksum_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SealCheck, "open", lambda self, identifier, data: None)
    with pytest.raises((fuzz.Wrong, IndexError)):
        fuzz.fuzz_frames(3000, np.random.default_rng(7))
