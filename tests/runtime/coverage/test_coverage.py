"""Sensor coverage against closed forms: one ray and one body, boxes that hide, bands that enclose, arcs that reach."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from configs.mission import Mission
from configs.strict import CONFIGS, load, parse
from configs.vehicle import ImplementFile, Lidar, Vehicle
from runtime.__main__ import main
from runtime.coverage.config import CoverageConfig
from runtime.coverage.evaluation import Coverage, enclosed_places, evaluate, reached_places
from runtime.coverage.evaluation import Places as PlacesOf
from runtime.coverage.kernels import count_returns
from runtime.coverage.rays import free_range_m, rays_of, solids_of
from runtime.coverage.states import DriveState, states_of
from runtime.stack import load_stack
from safety.zones.footprint import footprint_of

CONFIG = load(CoverageConfig, CONFIGS / "coverage.yaml")
TRACTOR = load(Vehicle, CONFIGS / "machines/tractor_e.yaml")
HARROW = load(ImplementFile, CONFIGS / "implements/harrow_6m.yaml").implement
SAFETY = load_stack().safety
X_M, Y_M = np.arange(-3.0, 3.001, 0.05), np.arange(-0.5, 0.501, 0.05)


def hits(
    ray: list[float], top_m: float, reach_m: tuple[float, float] = (0.0, 50.0), own: tuple[list[float], ...] = ()
) -> np.ndarray:
    """Returns (X, Y) of one ray on bodies of 0.3 m that count from 0.1 m."""
    out = np.zeros((1, len(X_M), len(Y_M)), np.int64)
    low = np.full(out.shape[1:], 0.1)
    own_m = np.array(own).reshape(-1, 4)
    count_returns(np.array([ray]), np.array([reach_m]), X_M, Y_M, low, np.array([top_m]), 0.15, own_m, out)
    return out[0]


def hit_x(found: np.ndarray) -> tuple[float, float]:
    """Nearest and farthest place hit on the axis."""
    x = X_M[found[:, len(Y_M) // 2] > 0]
    return (float(x.min()), float(x.max())) if len(x) else (math.nan, math.nan)


DOWN = [0.0, 0.0, 1.0, math.sqrt(0.5), 0.0, -math.sqrt(0.5)]


@pytest.mark.parametrize(
    ("top_m", "nearest_m", "farthest_m"),
    [
        (0.5, 0.35, 1.05),  # the top from 1 - top - radius on, the side down to 0.1 m at 1 - 0.1 + radius
        (0.15, 0.70, 1.05),
        (2.0, 0.15, 1.05),  # taller than the sensor: it meets the side, unless the sensor is inside
        (0.05, math.nan, math.nan),  # below the height from which returns count
    ],
)
def test_one_ray_down_at_45_deg(top_m: float, nearest_m: float, farthest_m: float) -> None:
    assert hit_x(hits(DOWN, top_m)) == pytest.approx((nearest_m, farthest_m), abs=0.051, nan_ok=True)


def test_ray_hits_within_the_radius_aside() -> None:
    found = hits(DOWN, 0.5)
    row = int(np.argmin(np.abs(X_M - 0.7)))
    assert np.abs(Y_M[found[row] > 0]).max() == pytest.approx(0.15, abs=0.051)
    assert found[row, np.abs(Y_M) < 0.149].all()


def test_every_direction_sees_the_same() -> None:
    back = hits([0.0, 0.0, 1.0, -math.sqrt(0.5), 0.0, -math.sqrt(0.5)], 0.5)
    assert np.count_nonzero(back[::-1] != hits(DOWN, 0.5)) <= 4  # places exactly on the rim
    turned = hits([0.0, 0.0, 0.2, 0.0, math.cos(0.3), -math.sin(0.3)], 0.15)  # along y
    assert np.abs(X_M[turned.any(axis=1)]).max() == pytest.approx(0.15, abs=0.051)
    assert turned.any(axis=1)[np.abs(X_M) < 0.149].all()


def test_vertical_ray() -> None:
    found = hits([1.0, 0.0, 2.0, 0.0, 0.0, -1.0], 0.5)
    assert hit_x(found) == pytest.approx((0.9, 1.1), abs=0.051)


def test_level_ray_and_range_limits() -> None:
    assert hit_x(hits([0.0, 0.0, 0.3, 1.0, 0.0, 0.0], 0.5)) == pytest.approx((0.2, 3.0), abs=0.051)
    assert hit_x(hits([0.0, 0.0, 0.3, 1.0, 0.0, 0.0], 0.5, (1.0, 2.0))) == pytest.approx((1.15, 2.15), abs=0.051)
    assert not hits([0.0, 0.0, 0.6, 1.0, 0.0, 0.0], 0.5).any()  # above


def test_returns_on_own_outline_do_not_count() -> None:
    found = hits(DOWN, 0.5, own=([-9.0, 0.6, -9.0, 9.0],))
    assert hit_x(found) == pytest.approx((0.80, 1.05), abs=0.051)  # tops are met at 0.5 m, sides from place - 0.15 m


def test_box_hides_what_lies_behind() -> None:
    rays = np.array(
        [DOWN, [0.0, 0.0, 1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 1.0, 0.0], [0.6, 0.0, 0.5, 1.0, 0.0, 0.0]]
    )
    box = np.array([[[0.5, -1.0, 0.0], [0.8, 1.0, 0.6]]])
    assert free_range_m(rays, box) == pytest.approx([0.5 * math.sqrt(2.0), math.inf, math.inf, 0.0])


def test_lidar_behind_its_own_machine_sees_nothing_behind() -> None:
    """A wing of 0.95 m height hides a lying body 0.5 m behind it from a lidar 2 m high and 1 m before it."""
    solids = solids_of(TRACTOR, HARROW, False, False)
    wing = solids[-1]
    assert wing.tolist() == [[-2.4, -3.05, 0.0], [-1.1, 3.05, 0.95]]
    folded = solids_of(TRACTOR, HARROW, True, True)[-1]
    assert folded == pytest.approx(np.array([[-2.4, -1.275, 0.6], [-1.1, 1.275, 1.55]]))
    to = np.array([-2.9, 2.0, 0.1]) - [0.0, 2.0, 2.0]
    ray = np.array([[0.0, 2.0, 2.0, *to / np.linalg.norm(to)]])
    assert free_range_m(ray, wing[None])[0] < np.linalg.norm(to)
    assert free_range_m(ray, solids_of(TRACTOR, None, True, False)).item() == math.inf


def test_band_encloses_only_when_wide_enough() -> None:
    x, y = np.meshgrid(np.arange(60), np.arange(60), indexing="ij")
    ring = (np.hypot(x - 30, y - 30) > 8.0) & (np.hypot(x - 30, y - 30) < 18.0)  # 1 m wide
    assert enclosed_places(ring, 0.7, 0.1)[30, 30]
    assert not enclosed_places(ring, 1.2, 0.1)[30, 30]
    assert not enclosed_places(ring, 0.8, 0.1)[0, 0]
    gap = ring & ~((np.abs(y - 30) <= 1) & (x > 30))
    assert not enclosed_places(gap, 0.8, 0.1)[30, 30]
    assert not enclosed_places(np.zeros((5, 5), bool), 0.1, 0.1).any()


def test_reached_places_straight_and_turning() -> None:
    footprint, places = (
        footprint_of(TRACTOR, HARROW),
        PlacesOf(np.arange(-8, 12, 0.1) + 0.05, np.arange(-8, 8, 0.1) + 0.05),
    )
    straight = reached_places(footprint, DriveState("", 1.0, 0.0), 2.0, places, CONFIG)
    machine, harrow, both = (4.5 + 2.0) * 2.3, (1.3 + 2.0) * 6.1, (0.9 + 1.3 + 0.1) * 2.3 - 0.1 * 2.3
    assert straight.sum() * places.area_m2 == pytest.approx(machine + harrow - both, rel=0.04)
    back = reached_places(footprint, DriveState("", 1.0, 0.0, direction=-1), 2.0, places, CONFIG)
    assert places.x_m[back.any(axis=1)].min() == pytest.approx(-4.35, abs=0.051)
    turning = reached_places(footprint, DriveState("", 1.0, 0.2), 2.0, places, CONFIG)
    assert np.count_nonzero(turning != turning[:, ::-1]) <= 4
    radius = math.hypot(5.0 + 3.05, 2.4)
    assert places.y_m[turning.any(axis=0)].max() == pytest.approx(radius - 5.0, abs=0.1)


def mast(**lidar: object) -> Vehicle:
    """The tractor with one lidar high above it and without parts that hide."""
    elevation = [round(-89.0 + 0.5 * k, 1) for k in range(150)]
    values = {"mount": {"xyz_m": [0.5, 0.0, 6.0]}, "elevation_deg": elevation, "columns": 720, "rate_hz": 20,
              "range_m": [0.1, 60.0], "range_sigma_m": 0.01} | lidar  # fmt: skip
    sensors = TRACTOR.sensors.model_copy(update={"lidar": {"mast": parse(Lidar, values, "mast")}})
    flat = {"all": {"x_m": [-1.0, 3.5], "y_m": [-1.15, 1.15], "z_m": [0.0, 0.01]}}
    body = TRACTOR.body.model_dump() | {"solids": flat}
    return TRACTOR.model_copy(update={"sensors": sensors, "body": type(TRACTOR.body).model_validate(body)})


def near_ground(min_height_m: float = 0.05) -> object:
    return SAFETY.model_copy(update={
        "field": SAFETY.field.model_copy(update={"min_height_m": min_height_m, "min_height_slope": 0.0}),
        "near_field": SAFETY.near_field.model_copy(update={"min_height_m": min_height_m}),
    })  # fmt: skip


STATE = DriveState("straight", 1.0, 0.0)


def test_dense_lidar_on_a_mast_covers_all_but_the_machine() -> None:
    found = evaluate(mast(), None, [STATE], near_ground(), CONFIG)
    assert [one.worst_m for one in found] == [None] * 4
    for one in found:
        own = footprint_of(TRACTOR, None).rigid[0]
        x, y = np.meshgrid(one.places.x_m, one.places.y_m, indexing="ij")
        is_beyond = (x > own.front_m + SAFETY.field.mask_m + 0.15) & (np.abs(y) < 1.15)
        assert (one.is_covered | ~is_beyond | ~one.is_reached).all()
        assert one.row()["uncovered_m2"] == 0.0


@pytest.mark.parametrize(
    ("how", "heights"),
    [
        ({"field_of_view_deg": 180.0, "mount": {"xyz_m": [0.5, 0.0, 6.0], "rpy_deg": [0.0, 0.0, 180.0]}}, 4),
        ({"columns": 16}, 4),
        ({"range_m": [0.1, 5.0]}, 4),
        ({"range_m": [0.1, 6.4]}, 3),  # the top of the tallest body is nearer
        ({"rate_hz": 2}, 0),  # a wider band is needed, and there
        ({"rate_hz": 0.3}, 4),  # no band is wide enough
    ],
)
def test_poor_lidar_leaves_places_uncovered(how: dict[str, object], heights: int) -> None:
    found = evaluate(mast(**how), None, [STATE], near_ground(), CONFIG)
    assert sum(one.worst_m is not None for one in found) == heights


def test_floor_of_the_supervisor_counts() -> None:
    found = evaluate(mast(), None, [STATE], near_ground(0.3), CONFIG)
    assert [one.worst_m is None for one in found] == [False, False, True, True]


def test_without_lidar_everything_is_uncovered() -> None:
    bare = TRACTOR.model_copy(update={"sensors": TRACTOR.sensors.model_copy(update={"lidar": {}})})
    for one in evaluate(bare, None, [STATE], SAFETY, CONFIG):
        assert np.array_equal(one.is_uncovered, one.is_reached)


def test_rays_of_a_turned_lidar() -> None:
    lidar = mast(
        field_of_view_deg=90.0,
        columns=16,
        elevation_deg=[-30.0],
        mount={"xyz_m": [1.0, 2.0, 3.0], "rpy_deg": [0.0, 0.0, 90.0]},
    )
    rays = rays_of(lidar.sensors.lidar["mast"], 1.0)
    assert rays[:, :3] == pytest.approx(np.broadcast_to([1.0, 2.0, 3.0], (16, 3)))
    azimuth = np.degrees(np.arctan2(rays[:, 4], rays[:, 3]))
    assert azimuth.min() == pytest.approx(90.0 - 45.0 + 45.0 / 16)
    assert rays[:, 5] == pytest.approx(np.full(16, -0.5))


def test_states_of_missions() -> None:
    planning = load_stack().planning
    names = {
        mission: [
            one.name
            for one in states_of(load(Mission, CONFIGS / f"missions/{mission}.yaml"), TRACTOR, HARROW, planning)
        ]
        for mission in ("demo", "line", "dock", "line_turn")
    }
    assert names == {
        "demo": ["working", "raised", "turning", "reversing", "folded", "folded, reversing"],
        "line": ["working", "raised", "reversing"],
        "dock": ["folded", "folded, reversing"],
        "line_turn": ["raised", "reversing"],
    }


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["headland", "coverage", *words])
    return main()


def test_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare = tmp_path / "bare.yaml"
    text = (CONFIGS / "machines/tractor_e.yaml").read_text()
    bare.write_text(text[: text.index("  lidar:")] + text[text.index("  camera:") :])
    blind, text = tmp_path / "blind.yaml", (CONFIGS / "implements/harrow_6m.yaml").read_text()
    blind.write_text(text[: text.index("    lidar:")] + text[text.index("    ultrasonic:") :])
    assert (
        run(monkeypatch, str(bare), str(blind), "--json", "--out", str(tmp_path / "out"), "--mission", "line_turn") == 1
    )
    result = json.loads(capsys.readouterr().out)
    assert {row["state"] for row in result["rows"]} == {"raised", "reversing"}
    assert result["uncovered_m2"] == pytest.approx(sum(row["reached_m2"] for row in result["rows"]))
    assert (tmp_path / "out/coverage.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "out/coverage.csv").read_text().count("\n") == 1 + len(result["rows"])
    assert run(monkeypatch, "no_such_machine") == 2
    assert "no_such_machine" in capsys.readouterr().err
    assert run(monkeypatch, str(bare), "no_such_implement") == 2


def test_worst_place_lies_in_the_largest_area() -> None:
    places = PlacesOf(np.arange(0, 2, 0.1), np.arange(0, 2, 0.1))
    reached = np.zeros((20, 20), bool)
    reached[1:4, 1:4] = reached[10:17, 8:15] = True
    none = np.zeros_like(reached)
    assert Coverage(STATE, 0.5, 1.0, places, reached, none, none).worst_m == (1.3, 1.1)
