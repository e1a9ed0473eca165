"""Random generators: one per seed and consumer, so that a new sensor does not change the draws of others."""

import numpy as np


def generator(seed: int, name: str) -> np.random.Generator:
    """The generator of `name` (such as "gnss/main") in the run of `seed`."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=tuple(name.encode()))))
