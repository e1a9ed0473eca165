"""Array types by element type; shape, frame and unit are in the name or docstring of each use."""

import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]
Int64 = npt.NDArray[np.int64]
Int32 = npt.NDArray[np.int32]
UInt32 = npt.NDArray[np.uint32]
UInt16 = npt.NDArray[np.uint16]
UInt8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]


def runs_of(is_set: Bool) -> list[tuple[int, int]]:
    """First and last index of each run of set elements (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_set.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def quantile(values: Float64, share: float) -> float:
    """Quantile of finite values (N,), at least one: as np.quantile, which takes ten times as long for a few hundred."""
    ordered = np.sort(values)
    place = (len(ordered) - 1) * share
    low = int(place)
    below, above = float(ordered[low]), float(ordered[min(low + 1, len(ordered) - 1)])
    rest, step = place - low, above - below
    return above - step * (1.0 - rest) if rest >= 0.5 else below + step * rest


def median(values: Float64) -> float:
    """Median of finite values (N,), at least one: as np.median, which takes ten times as long for a few hundred."""
    ordered = np.sort(values)
    return 0.5 * float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
