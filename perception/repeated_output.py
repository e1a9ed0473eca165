"""Detection of a frozen sensor: the same measurement sent again."""

import numpy as np
import numpy.typing as npt


def is_repeated(*new_and_last: tuple[npt.ArrayLike, npt.ArrayLike]) -> bool:
    """Whether all new values equal the last ones; NaN (no measurement) equals nothing."""
    return all(np.array_equal(new, last) for new, last in new_and_last)
