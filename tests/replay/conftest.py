"""The simulated drive that the tests of a folder replay."""

from pathlib import Path

import pytest

from tests.replay.simulated_crossing import crossing_of_session


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return crossing_of_session(tmp_path_factory)
