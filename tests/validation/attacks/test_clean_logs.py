"""Clean logs are judged, with the margin in closed form: constant speed, a standing or crossing box, the brake.

The gap is found by moving the outline, with the side margin of the conditions, along the arc until it touches the box;
nothing is shared with the code under test but the values of the brake.
"""

import math

import numpy as np
import pytest
from shapely import Polygon, box
from shapely.affinity import rotate, translate

from tests.validation.attacks.recorded import Bench, drive, reasons, standing, walking, write_own_log
from tests.validation.obstacle_stop.closed_form import DEAD, TAU, braked_m
from tests.validation.obstacle_stop.consistency.world import Actor, Drive

TOLERANCE_M = 0.1
CAR = (-1.0, -1.4, 3.6, 1.4)  # outline with the half width of the conditions
HARROW = (-2.4, -3.35, -1.1, 3.35)  # configs/implements/harrow_6m.yaml with the side margin


def on_arc(curvature_radpm: float, s_m: float) -> tuple[float, float, float]:
    """Pose after a distance."""
    turn = curvature_radpm * s_m
    chord = s_m * np.sinc(0.5 * turn / math.pi)
    return float(chord * math.cos(0.5 * turn)), float(chord * math.sin(0.5 * turn)), turn


def gap_m(drive: Drive, actor: Actor, t_s: float, outlines: tuple[tuple[float, ...], ...]) -> float:
    """Distance from the place at a time until an outline touches the object at its place then."""
    x, y, yaw = actor.at(t_s)
    length, width = actor.size_m[:2]
    thing = translate(rotate(box(-0.5 * length, -0.5 * width, 0.5 * length, 0.5 * width), yaw, use_radians=True), x, y)
    direction = math.copysign(1.0, drive.speed_mps)
    for step in np.arange(0.0, 40.0, 0.02):
        px, py, turn = on_arc(drive.curvature_radpm, drive.speed_mps * t_s + direction * float(step))
        for outline in outlines:
            body: Polygon = rotate(box(*outline), turn, origin=(0.0, 0.0), use_radians=True)
            if translate(body, px, py).intersects(thing):
                return float(step)
    return math.inf


def person(curvature_radpm: float, s_m: float, y_m: float = 0.2, id: int = 9) -> Actor:
    """A person who stands on an arc."""
    x, y, yaw = on_arc(curvature_radpm, s_m)
    return standing(id, x - y_m * math.sin(yaw), y + y_m * math.cos(yaw))


CLEAN: dict[str, Drive] = {
    "straight": drive(standing(9, 16.0, 0.2)),
    "left bend": drive(person(0.03, 16.0), curvature_radpm=0.03),
    "right bend": drive(person(-0.03, 16.0), curvature_radpm=-0.03),
    "reverse": drive(standing(9, -12.0, 0.2), speed_mps=-3.0),
    "two persons": drive(standing(9, 15.0, 0.5), standing(8, 17.0, -0.4)),
    "crossing walker": drive(walking(9, 16.0, -3.2, 0.0, 1.4)),
    "rough ground": drive(standing(9, 16.0, 0.2), bump_deg=1.5),
    "slope": drive(standing(9, 16.0, 0.2), slope=0.05),
    "16 rings": drive(standing(9, 16.0, 0.2), beams=16, columns=600),
    "64 rings": drive(standing(9, 16.0, 0.2), beams=64),
    "truth in the frame of the lidar": drive(standing(9, 16.0, 0.2), truth_in_map=False),
    "6 m/s": drive(standing(9, 22.0, 0.2), speed_mps=6.0),
    "3 m/s": drive(standing(9, 13.0, 0.2), speed_mps=3.0),
    "bare field": drive(standing(9, 16.0, 0.2), has_structure=False, objects=0),
}


@pytest.mark.parametrize("name", CLEAN)
def test_clean_log_passes_with_its_margin(bench: Bench, name: str) -> None:
    assert_clean(bench.judge(CLEAN[name]), CLEAN[name], (CAR,))


def test_implement_sweeps_a_person_beside_the_machine(bench: Bench) -> None:
    log = drive(standing(9, 11.0, 2.4))
    result = bench.judge_log(write_own_log(bench.folder / "own.mcap", log, "harrow_6m"), None)
    assert_clean(result, log, ((-1.0, -1.2, 3.6, 1.2), HARROW))


def assert_clean(result: dict, drive: Drive, outlines: tuple[tuple[float, ...], ...]) -> None:
    """Passed, and every object in time, requested before it was due, with the margin of the closed form."""
    assert result["state"] == "passed", reasons(result)
    encounters = {e["id"]: e for e in result["encounters"]}
    assert {actor.id for actor in drive.actors} <= encounters.keys()
    speed = abs(drive.speed_mps)
    for actor in drive.actors:
        one = encounters[actor.id]
        requested_s = one["stop_requested_s"]
        gap = gap_m(drive, actor, requested_s, outlines)
        assert one["outcome"] == "in time"
        assert one["clearance_m"] == pytest.approx(gap, abs=TOLERANCE_M)
        assert one["stopping_distance_m"] == pytest.approx(speed * TAU + braked_m(speed), abs=0.01)
        assert one["margin_m"] == pytest.approx(gap - speed * DEAD - braked_m(speed), abs=TOLERANCE_M)
