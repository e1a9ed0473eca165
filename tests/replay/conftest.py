"""The simulated drive that the tests of a folder replay."""

from pathlib import Path

import pytest

from tests.replay.simulated_crossing import crossing


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return crossing(tmp_path_factory.mktemp("crossing") / "log.mcap")
