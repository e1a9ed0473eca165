"""Numba decorators: single core, results equal to the bit from run to run, cached on disk."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compiles a function with numba, without `parallel` and `fastmath`; keeps its type.

    Division by zero gives infinity, as in numpy: a loop that can raise is not vectorised.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inline_kernel(function: F) -> F:
    """Compiles a function into each calling kernel: a call would pass every array as seven values."""
    return cast(F, numba.njit(cache=True, error_model="numpy", inline="always")(function))
