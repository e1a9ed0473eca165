"""Kernels on disk follow the files of what they call."""

import subprocess
import sys
from pathlib import Path

CALLED = "from geometry.jit import kernel\nSCALE = {scale}\n@kernel\ndef scaled(x):\n    return SCALE * x + {offset}\n"
CALLING = """
from called import scaled
from geometry.jit import kernel
@kernel
def twice(x):
    return scaled(scaled(x))
print(twice(1.0), sum(twice.stats.cache_hits.values()))
"""


def result(folder: Path) -> str:
    # -B: the interpreter's own files compare whole seconds and sizes, and would give the source before.
    path = f"import sys; sys.path.insert(0, {str(folder)!r}); import calling"
    return subprocess.run([sys.executable, "-B", "-c", path], capture_output=True, text=True, check=True).stdout


def test_a_changed_kernel_is_compiled_again_where_it_is_called(tmp_path: Path) -> None:
    (tmp_path / "calling.py").write_text(CALLING)
    (tmp_path / "called.py").write_text(CALLED.format(scale=2.0, offset=1.0))
    assert result(tmp_path) == "7.0 0\n"
    assert result(tmp_path) == "7.0 1\n"
    (tmp_path / "called.py").write_text(CALLED.format(scale=2.0, offset=0.25))
    assert result(tmp_path) == "4.75 0\n"
    (tmp_path / "called.py").write_text(CALLED.format(scale=3.0, offset=0.25))
    assert result(tmp_path) == "10.0 0\n"
