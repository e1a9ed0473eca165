"""A way by sampling with OMPL, in a worker process of its own so that its seed holds."""

from geometry.polyline import Float64
from planning.turn import Space, Wanted


def sampled(wanted: Wanted, space: Space, seed: int, iterations: int) -> Float64 | None:
    return None
