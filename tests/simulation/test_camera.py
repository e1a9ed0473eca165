"""Camera model: projection, recall of a real network, lens contamination, exposure, repeatability."""

import dataclasses
from concurrent.futures import Future

import numpy as np
import open3d
import pytest

from benchmarks.camera import MODEL, configured
from benchmarks.camera_simulated import CAMERA, box_of, detect, labelled_images
from configs.site import Site
from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import Vehicle
from messages.perception import HealthState, ObstacleClass
from perception.camera.detector import load_detector
from perception.camera.image_quality import ImageQualityConfig, inspect
from perception.camera.ranging import CameraGeometry
from simulation.actors.actors import ActorState
from simulation.environment.meshes import join
from simulation.environment.scene import Scene
from simulation.environment.scenery import build_scenery
from simulation.environment.terrain import Terrain
from simulation.machine.pose_buffer import PoseBuffer
from simulation.objects.encountered import ENCOUNTERED
from simulation.objects.solid import GAIT_STEPS
from simulation.scenario import CameraEpisode
from simulation.sensors.camera import CameraModel, Lens
from simulation.sensors.sensor import WorldState
from simulation.world import Rendering
from tests.recordings import needs
from tests.simulation.simulated_farm import CONFIG, Farm, machine_file

SITE, VEHICLE = load(Site, find("sites", "demo")), load(Vehicle, find("machines", "tractor_e"))
TERRAIN = Terrain(SITE, CONFIG.terrain, 5)
PIECES = build_scenery(SITE, TERRAIN, CONFIG.scenery, 5)
T_MAP_BASE = TERRAIN.pose_on_ground(25.0, 25.0, 0.3, 2.55, 1.9)
EPISODES = (
    CameraEpisode(from_s=10.0, for_s=5.0, state="blocked"),
    CameraEpisode(from_s=20.0, for_s=5.0, state="blurred"),
)


def actor_ahead(ahead_m, left_m=0.0, label=ObstacleClass.PERSON, **changes):
    x, y = (T_MAP_BASE @ np.array([CAMERA.mount.xyz_m[0] + ahead_m, left_m, 0.0, 1.0]))[:2]
    actor = ActorState(1, ENCOUNTERED[label], "", (x, y, TERRAIN.height_m(x, y)), 2.0, (0.0, 0.0), 0.3)
    return dataclasses.replace(actor, **changes)


class Photographer:
    def __init__(self, camera=CAMERA):
        self.scene = Scene(lambda: PIECES)
        self.model = CameraModel("front", camera, VEHICLE, SITE, EPISODES, 5, CONFIG.camera)
        self.poses = PoseBuffer(5_000_000, 0.02)
        self.poses.append(T_MAP_BASE)

    def take(self, *actors, at_s=0.0):
        self.scene.actors = actors
        return self.model.sample(WorldState(round(at_s * 1e9), at_s, self.poses, None, self.scene)).bgr


@pytest.fixture(scope="module")
def photographer():
    return Photographer()


@pytest.fixture(scope="module")
def empty_image():
    """First image without actors: exposure and noise equal those of any other first image."""
    return Photographer().take()


def test_image_of_request_time():
    at_once = Photographer().take(actor := actor_ahead(8.0))
    later = Photographer()
    later.scene.actors = (actor,)
    request = later.model.prepare(WorldState(0, 0.0, later.poses, None, later.scene))
    later.scene.actors = ()
    later.poses.append(TERRAIN.pose_on_ground(40.0, 25.0, 1.3, 2.55, 1.9))
    assert np.array_equal(later.model.render(request).bgr, at_once)


def test_images_equal_wherever_rendered():
    def pictures(rendering):
        farm = Farm(vehicle=machine_file(sensors=("camera", "imu")), rendering=rendering)
        given = farm.drive(2.0)
        waiting = [message for *_, message in farm.world._pending if isinstance(message, Future)]
        farm.close()
        assert sum(topic == "imu" for topic, _ in given) == 200
        taken = [message for topic, message in given if topic == "camera/front"]
        return {image.stamp_ns: image.bgr for image in (*taken, *(future.result() for future in waiting))}

    in_step = pictures(Rendering.IN_STEP)
    assert len(in_step) >= 3
    for rendering in (Rendering.IN_THREAD, Rendering.LATE):
        found = pictures(rendering)
        assert all(np.array_equal(found[stamp_ns], bgr) for stamp_ns, bgr in in_step.items())


def changed(a, b):
    """Left, top, right and bottom of differences well above the noise."""
    rows, columns = np.nonzero(np.abs(a.astype(int) - b).sum(axis=2) > 60)
    return np.array([*np.percentile(columns, [1, 99]), *np.percentile(rows, [1, 99])])[[0, 2, 1, 3]]


@pytest.mark.parametrize(("ahead_m", "left_m"), [(5.0, 0.0), (8.0, 3.5), (8.0, -3.5), (15.0, 5.0)])
def test_actor_at_projected_box(ahead_m, left_m, empty_image):
    actor = actor_ahead(ahead_m, left_m)
    there = Photographer().take(actor)
    box = box_of(actor, T_MAP_BASE, CAMERA)
    # the shadow extends the box sideways and down, never up
    found_box = changed(there, empty_image)
    assert abs(found_box[1] - box[1]) < 0.06 * (box[3] - box[1]) + 2.0
    assert found_box[0] < box[0] + 0.2 * (box[2] - box[0]) + 2.0
    assert found_box[2] > box[2] - 0.2 * (box[2] - box[0]) - 2.0


def test_images_bit_identical():
    assert np.array_equal(Photographer().take(actor_ahead(7.0)), Photographer().take(actor_ahead(7.0)))


def test_actor_not_visible_to_camera(empty_image):
    unseen = actor_ahead(7.0, visible_to=("lidar", "radar", "ultrasonic"))
    assert np.array_equal(Photographer().take(unseen), empty_image)


def test_lens_contamination_detected(photographer):
    quality = parse(
        ImageQualityConfig,
        read_yaml(CONFIGS / "stack/perception.yaml")["camera"]["image_quality"],
        "stack/perception.yaml",
    )
    horizon = CameraGeometry(CAMERA).horizon_row()

    def state(at_s):
        return inspect(photographer.take(actor_ahead(9.0), at_s=at_s), horizon, quality)

    assert state(9.99).state is HealthState.GOOD
    assert state(10.0).state is HealthState.BLIND
    assert state(14.99).state is HealthState.BLIND
    assert state(15.0).state is HealthState.GOOD
    assert "blurred" in state(20.0).reason
    assert state(25.0).state is HealthState.GOOD


def test_automatic_exposure(photographer):
    for _ in range(4):
        bgr = photographer.take()
    assert 70.0 < bgr.mean() < 170.0


def test_pinhole_without_distortion():
    lens = Lens(CAMERA.model_copy(update={"distortion": (0.0,) * 5}), 0.75)
    assert lens.size_px == (960, 540)
    assert lens.intrinsics == pytest.approx([600.0, 600.0, 479.5, 269.5])


@pytest.mark.parametrize("label", [ObstacleClass.PERSON, ObstacleClass.ANIMAL, ObstacleClass.VEHICLE])
@pytest.mark.parametrize("gait", [-1.0, 0.0, 3 / GAIT_STEPS, 10 / GAIT_STEPS])
def test_coarse_and_fine_mesh_agree(label, gait):
    solid = ENCOUNTERED[label]
    coarse = solid.mesh(gait)
    assert len(coarse.triangles) < 2500
    fine = join([part.mesh for part in solid.parts(solid.step(gait), True)])
    assert outside_m(fine, coarse) < 0.02
    assert outside_m(coarse, fine) < 0.02


def outside_m(a, b):
    """Largest distance of a body's vertices outside another body."""
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    tensor = open3d.core.Tensor
    scene.add_triangles(tensor(b.vertices_m), tensor(b.triangles.astype(np.uint32)))
    return scene.compute_signed_distance(tensor(a.vertices_m), nthreads=1, nsamples=11).numpy().max()


@needs("onnx-detectors")
def test_detection_network_recall():
    """Limit 80 % at 5 to 15 m; `benchmarks/camera_simulated.py` uses more images."""
    detector = load_detector(MODEL, configured())
    pictures = [
        shot
        for seed in (901, 902)
        for shot in labelled_images(seed, order=(ObstacleClass.PERSON,) * 5, range_m=(5, 15))
    ]
    results = [detect(shot, detector)[0] for shot in pictures]
    assert np.mean(results) >= 0.8
