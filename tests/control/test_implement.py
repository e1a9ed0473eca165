"""Implement control: work edges with different hitch latencies, PTO."""

from dataclasses import dataclass

import numpy as np
import pytest

from control.implement import ImplementControl, edges_of
from tests.control.plant import CONFIG, IMPLEMENT, Ground, Plant, path_along

STEP_M = 0.1


def marked(first, last, points=601):
    """`is_working` as planned: from the last point before work to the first after it."""
    work = np.zeros(points, np.uint8)
    work[first - 1 : last + 2] = 1
    return work


def crossings(track):
    """Arc lengths where the hitch crossed the working position, interpolated."""
    x, h = np.array(track.x_m), np.array(track.hitch)
    found = []
    for k in np.flatnonzero((h[1:] < 0.1) != (h[:-1] < 0.1)):
        share = (0.1 - h[k]) / (h[k + 1] - h[k])
        found.append(float(x[k] + share * (x[k + 1] - x[k])))
    return found


@pytest.mark.parametrize(("speed_mps", "grade"), [(0.8, 0.0), (1.94, 0.08), (2.78, 0.0), (2.78, -0.08)])
def test_work_edges_within_5_cm(speed_mps, grade):
    path = path_along(np.zeros(280), speed_mps, work=marked(120, 220, 281))
    track = Plant(ground=Ground(3.0, grade=grade)).run(path)
    down, up = crossings(track)
    assert down == pytest.approx(12.0 - 0.5 * STEP_M, abs=0.05)
    assert up == pytest.approx(22.0 + 0.5 * STEP_M, abs=0.05)


@dataclass
class SlowHitch:
    """Plant with an additional hitch latency."""

    plant: Plant
    delay_s: float

    def run(self, path):
        queue = [False] * round(self.delay_s / 0.01)
        move = self.plant.move

        def late():
            self.plant.control_command = _with_hitch(self.plant.control_command, queue)
            move()

        self.plant.move = late
        return self.plant.run(path)


def _with_hitch(control_command, queue):
    from dataclasses import replace

    queue.append(desired := getattr(control_command, "wanted", control_command.is_implement_lowered))
    changed = replace(control_command, is_implement_lowered=queue.pop(0))
    object.__setattr__(changed, "wanted", desired)
    return changed


def test_hitch_latency_learning():
    work = np.zeros(901, np.uint8)
    for first in range(100, 800, 150):
        work[first - 1 : first + 72] = 1
    path = path_along(np.zeros(900), 2.78, work=work)
    found = crossings(SlowHitch(Plant(), 0.25).run(path))
    desired = [s for first in range(100, 800, 150) for s in (first * STEP_M - 0.05, (first + 70) * STEP_M + 0.05)]
    late = np.array(found) - np.array(desired)
    assert np.abs(late[:2]).max() > 0.4
    assert np.abs(late[-4:]).max() < 0.15


def test_edges_half_a_step_inside_marks():
    path = path_along(np.zeros(100), work=marked(30, 60, 101))
    assert [(e.s_m, e.is_lowering) for e in edges_of(path)] == [
        (pytest.approx(2.95), True),
        (pytest.approx(6.05), False),
    ]


def test_work_on_complete_path():
    path = path_along(np.zeros(50), work=np.ones(51))
    control = ImplementControl(IMPLEMENT, CONFIG.implement)
    control.start(path)
    assert control.is_lowered
    assert [e.is_lowering for e in edges_of(path)] == [True, False]


def test_no_implement_command_at_standstill_before_edge():
    path = path_along(np.zeros(300), 2.0, work=marked(100, 200, 301))
    plant = Plant()
    plant.run(path, stop=lambda p, _: p.x > 7.0)
    plant.is_enabled = False
    plant.run(path, until_s=8.0)
    assert plant.x < 9.5
    assert not plant.control_command.is_implement_lowered
    plant.is_enabled = True
    down, _ = crossings(plant.run(path))
    assert down == pytest.approx(9.95, abs=0.3)  # still accelerating


def test_pto_lead_and_hold_between_sections():
    work = marked(300, 350) | marked(400, 450)
    track = Plant().run(path_along(np.zeros(600), 2.78, work=work))
    x, on = np.array(track.x_m), np.array([w.is_pto_on for w in track.commands])
    assert np.flatnonzero(np.diff(on.astype(int))).size == 2
    assert 18.0 < x[np.argmax(on)] < 25.0
    assert x[len(on) - 1 - np.argmax(on[::-1])] == pytest.approx(45.0, abs=0.5)


def test_no_pto_command_without_pto():
    bare = IMPLEMENT.model_copy(update={"uses_pto": False})
    control = ImplementControl(bare, CONFIG.implement)
    plant = Plant()
    plant.controller._implement = control
    track = plant.run(path_along(np.zeros(200), work=marked(50, 150, 201)))
    assert any(w.is_implement_lowered for w in track.commands)
    assert not any(w.is_pto_on for w in track.commands)
