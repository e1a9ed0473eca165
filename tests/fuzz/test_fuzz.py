"""Short run of `benchmarks/fuzz.py`, and detection of a missing checksum test."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import fuzz
from configs.strict import read_yaml
from interfaces.isobus.checksum import ProtectionCheck
from messages.errors import ConfigError


@pytest.mark.parametrize(("name", "count"), [("frames", 5000), ("lines", 3000), ("files", 60), ("logs", 200)])
def test_no_crash_and_no_invalid_data_accepted(name: str, count: int) -> None:
    found = fuzz.INPUT_KINDS[name][0](count, np.random.default_rng(7))
    assert found.tried == count
    assert 0 < found.accepted < count


@pytest.mark.parametrize("text", ["{a: 1}: 2", "? [a, b]\n: 1", "a: 1\na: 2"])
def test_invalid_yaml_keys_refused_with_file_name(tmp_path: Path, text: str) -> None:
    (file := tmp_path / "file.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"file\.yaml: not valid YAML"):
        read_yaml(file)


def test_missing_checksum_test_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ProtectionCheck, "check", lambda self, identifier, data: None)
    with pytest.raises((fuzz.InvalidAccepted, IndexError)):
        fuzz.fuzz_frames(3000, np.random.default_rng(7))
