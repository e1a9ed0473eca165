"""Memory where plants stood."""

import numpy as np
import pytest

from safety.sources.plant_memory import PlantMemory
from tests.clause import clause

MS = 1_000_000
STAND = np.array([[10.1, 2.1], [10.2, 2.3], [11.6, 2.2]])  # two returns in a cell of 0.5 m, and one in another
HEIGHT_M = np.array([0.15, 0.2, 0.1])


def seen(times: int, step_ms: int = 100) -> PlantMemory:
    memory = PlantMemory(0.5, 5.0)
    for k in range(times):
        memory.add((k + 1) * step_ms * MS, STAND, HEIGHT_M)
    return memory


@clause("BD-5.2.4", rule="vegetation")
def test_plants_of_several_scans_are_remembered_with_their_greatest_height() -> None:
    places = np.array([[10.4, 2.4], [11.9, 2.0], [10.1, 2.6], [-10.1, 2.1]])  # the last two are in other cells
    assert seen(2).height_m(places).tolist() == [0.0, 0.0, 0.0, 0.0]
    assert seen(4).height_m(places).tolist() == [0.2, 0.1, 0.0, 0.0]
    assert PlantMemory(0.5, 5.0).height_m(places).tolist() == [0.0, 0.0, 0.0, 0.0]


def test_a_scan_counts_once() -> None:
    memory = seen(1)
    for _ in range(5):
        memory.add(100 * MS, STAND, HEIGHT_M)
    assert not memory.height_m(STAND).any()


@pytest.mark.parametrize(("later_s", "stood"), [(0.5, True), (5.0, False), (60.0, False)])
def test_plants_are_forgotten(later_s: float, stood: bool) -> None:
    memory = seen(4)
    memory.add(400 * MS + round(later_s * 1e9), np.empty((0, 2)), np.empty(0))
    assert bool(memory.height_m(STAND).any()) == stood
    assert len(memory.height_m(np.empty((0, 2)))) == 0
