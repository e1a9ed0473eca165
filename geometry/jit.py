"""How loops over returns are compiled: one core, bit for bit the same, cached on disk."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """The function compiled by numba; neither `parallel` nor `fastmath`, so that two runs agree to the bit.

    Division by zero gives infinity, as in numpy: a loop that might raise there cannot use the processor's vectors.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
