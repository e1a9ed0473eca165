"""The filter of the reference gives the bits of SciPy, without its import."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from control.zero_phase import low_pass

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("seed", range(20))
def test_filter_is_that_of_scipy(seed: int) -> None:
    random = np.random.default_rng(seed)
    share = float(random.uniform(0.001, 0.99))
    x = np.cumsum(random.normal(size=(int(random.integers(13, 3000)), 2)), axis=0)
    expected = filtfilt(*butter(3, share), x, axis=0)
    np.testing.assert_array_equal(low_pass(x, share), expected)


def test_controller_imports_no_signal_processing() -> None:
    code = "import sys, runtime.simulated_drive; sys.exit('scipy.signal' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
