"""Catalogue of objects: sizes, anthropometry, closed meshes, signatures."""

import numpy as np
import open3d
import pytest

from messages.errors import ConfigError
from simulation.environment.meshes import join
from simulation.objects.catalogue import CATALOGUE, solid_of
from simulation.objects.encountered import PERSON
from simulation.objects.people import between
from simulation.objects.postures import STAND_TO_LIE_STEPS
from simulation.rendering.materials import palette

EVERY = [(name, posture) for name, entry in CATALOGUE.items() for posture in entry.postures]
PEOPLE, LYING = ("adult", "child", "cyclist"), ("lying_along", "lying_across", "lying_curled")
# length, width and height in m at the usual height: low, high; lengths along the object's heading
SIZES = {
    "cyclist": ((1.6, 0.4, 1.6), (1.9, 0.7, 1.95)), "dog": ((0.7, 0.18, 0.65), (1.0, 0.3, 0.75)),
    "calf": ((1.1, 0.3, 0.9), (1.5, 0.45, 1.05)), "sheep": ((1.0, 0.4, 0.8), (1.4, 0.55, 0.95)),
    "roe_deer": ((1.2, 0.25, 1.2), (1.5, 0.4, 1.35)), "fawn": ((0.5, 0.15, 0.28), (0.7, 0.3, 0.32)),
    "gull": ((0.5, 1.2, 0.05), (0.6, 1.4, 0.35)), "car": ((3.7, 1.6, 1.6), (3.9, 1.7, 1.7)),
    "quad": ((1.8, 0.95, 1.15), (2.0, 1.05, 1.25)), "tractor_with_trailer": ((9.5, 2.3, 2.7), (10.0, 2.5, 2.9)),
    "test_body": ((0.37, 0.37, 0.80), (0.38, 0.38, 0.80)), "post": ((0.04, 0.04, 1.2), (0.1, 0.1, 1.2)),
    "wire": ((0.002, 4.0, 0.002), (0.003, 4.0, 0.003)), "low_wall": ((0.2, 3.0, 0.3), (0.2, 3.0, 0.3)),
    "branch": ((0.05, 2.4, 0.05), (0.1, 2.4, 0.1)), "gate": ((0.03, 2.8, 0.9), (3.0, 4.1, 1.1)),
    "shed_door": ((0.04, 2.5, 3.9), (0.06, 2.5, 4.0)), "drawbar": ((2.0, 0.1, 0.5), (2.0, 0.15, 0.5)),
    "round_bale": ((1.3, 1.2, 1.3), (1.4, 1.2, 1.4)), "stone": ((0.35, 0.3, 0.3), (0.4, 0.35, 0.3)),
    "puddle": ((1.9, 1.5, 0.004), (2.0, 1.6, 0.006)),
}  # fmt: skip


def usual(name: str, posture: str):
    return solid_of(name, posture, round(0.5 * sum(CATALOGUE[name].usual_m), 3))


def size_of(solid, gait=-1.0):
    return np.ptp(solid.mesh(gait).vertices_m, axis=0)


@pytest.mark.parametrize(("name", "posture"), [(n, p) for n, p in EVERY if n in SIZES])
def test_size(name, posture):
    low, high = SIZES[name]
    for gait in (-1.0, 0.3):
        size = size_of(usual(name, posture), gait)
        assert np.all(size >= np.array(low) - 1e-3)
        assert np.all(size <= np.array(high) + (0.2 * (gait >= 0.0), 0.0, 0.0) + 1e-3)


def test_every_object_has_a_size():
    assert set(SIZES) | {"adult", "child"} == set(CATALOGUE)


@pytest.mark.parametrize(("name", "posture"), EVERY)
def test_meshes_are_closed_and_outward(name, posture):
    solid = usual(name, posture)
    for part in solid.parts(solid.step(0.3), False):
        corners = part.mesh.vertices_m[part.mesh.triangles].astype(float)
        assert np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() > 0.0
        points = open3d.utility.Vector3dVector(part.mesh.vertices_m)
        faces = open3d.utility.Vector3iVector(part.mesh.triangles)
        assert open3d.geometry.TriangleMesh(points, faces).is_edge_manifold(allow_boundary_edges=False)
    # the bodies of encounters are as they were
    assert len(solid.mesh(-1.0).triangles) <= (
        400 if name not in (*PEOPLE, "car", "roe_deer", "tractor_with_trailer") else 2400
    )
    assert 0.0 <= solid.mesh(-1.0).vertices_m[:, 2].min() < 0.2 or name in ("gull", "wire", "branch")


@pytest.mark.parametrize(("name", "posture"), EVERY)
def test_signatures(name, posture):
    solid, looks = usual(name, posture), palette(1, 1)
    assert solid.must_avoid == (name not in ("gull", "puddle"))
    assert 0.0 < solid.reflectivity <= 1.0
    assert 0.0 <= solid.ultrasonic_strength <= 2.0
    low, high = solid.mesh(-1.0).vertices_m.min(axis=0) - 0.25, solid.mesh(-1.0).vertices_m.max(axis=0) + 0.25
    assert solid.scatterers
    assert all(np.all(np.array(s.at_m) >= low) and np.all(np.array(s.at_m) <= high) for s in solid.scatterers)
    assert {part.region for fine in (True, False) for part in solid.parts(-1, fine)} <= set(looks)
    assert solid_of(name, posture, round(0.5 * sum(CATALOGUE[name].usual_m), 3)) is solid


@pytest.mark.parametrize(("name", "heights"), [("adult", (1.5, 1.75, 1.9)), ("child", (0.9, 1.1, 1.3))])
def test_people_against_anthropometry(name, heights):
    """DIN 33402-2: chest depth with clothes 0.24 to 0.30 of an adult, bideltoid breadth 0.27 of the height, sitting
    height 0.52, squatting 0.5 to 0.65 of the height.
    """
    for height in heights:
        standing, lying = size_of(solid_of(name, "standing", height)), size_of(solid_of(name, "lying_along", height))
        assert standing[2] == pytest.approx(height, abs=0.005)
        assert 0.25 * height < standing[1] < 0.32 * height
        assert height < lying[0] < 1.1 * height
        assert (0.20 if name == "adult" else 0.11) < lying[2] < (0.275 if name == "adult" else 0.19)
        across = size_of(solid_of(name, "lying_across", height))
        assert across == pytest.approx(lying[[1, 0, 2]], abs=0.005)
        curled = size_of(solid_of(name, "lying_curled", height))
        assert curled[0] < 0.8 * height
        assert 0.22 * height < curled[2] < 0.32 * height
        assert 0.50 * height < size_of(solid_of(name, "sitting", height))[2] < 0.57 * height
        assert 0.50 * height < size_of(solid_of(name, "crouching", height))[2] < 0.65 * height
        running = np.array([size_of(solid_of(name, "running", height), k / 16) for k in range(16)])
        assert (
            running[:, 0].max()
            > 0.55 * height
            > 0.40 * height
            > size_of(solid_of(name, "walking", height), 0.3)[0] - 0.2
        )


def test_lying_torso_height():
    """The jacket of a lying adult of 1.75 m."""
    torso = [p.mesh for p in solid_of("adult", "lying_along", 1.75).parts(-1, False) if p.region == "jacket"]
    assert 0.20 < join(torso).vertices_m[:, 2].max() < 0.26


def test_adult_of_encounters_is_the_adult_of_the_catalogue():
    for gait in (-1.0, 0.1, 0.7):
        scaled = solid_of("adult", "walking", 1.757).mesh(gait).vertices_m
        assert scaled == pytest.approx(PERSON.mesh(gait).vertices_m, abs=1e-3)


def test_lying_is_harder_for_radars():
    def strongest(posture):
        return max(s.rcs_dbsm for s in solid_of("child", posture, 1.0).scatterers)

    assert strongest("lying_along") < strongest("crouching") < strongest("standing")


def test_lying_down_is_continuous():
    heights = [
        size_of(between("adult", 1.75, ("standing", "lying_along"), k))[2] for k in range(STAND_TO_LIE_STEPS + 1)
    ]
    assert heights[0] == pytest.approx(1.75, abs=0.005)
    assert heights[-1] == pytest.approx(size_of(solid_of("adult", "lying_along", 1.75))[2], abs=0.005)
    assert np.all(np.diff(heights) < 0.0)
    assert np.min(np.diff(heights)) > -0.35


@pytest.mark.parametrize(("name", "posture", "height_m", "text"), [
    ("cow", "standing", 1.0, "cow"), ("adult", "flying", 1.75, "flying"), ("adult", "standing", 2.5, "2.5"),
])  # fmt: skip
def test_unknown_objects(name, posture, height_m, text):
    with pytest.raises(ConfigError, match=text):
        solid_of(name, posture, height_m)
