"""Detection rate of the camera's detector on simulated images: recall by distance, and false persons.

    ./headland benchmark camera_simulated [--model FILE] [--worlds N] [--out FOLDER]

Each world (seed) has its own light, clothes and terrain; an image shows one actor or none, 4 to 20 m from the camera,
at any bearing in the image, in field, lane and yard, walking or standing at any heading. Detected: a box of its class
with IoU of at least 0.5 and at least the stack's score.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.camera import MODEL, configured, grouped
from configs.site import Site
from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import Camera, Mount, Vehicle
from geometry.arrays import Float64, UInt8
from geometry.transforms import apply, invert
from messages.perception import ObstacleClass
from perception.camera.boxes import Boxes, iou, non_max_suppression
from perception.camera.classes import GROUPS
from perception.camera.detector import Detector, load_detector
from simulation.actors.actors import ActorState
from simulation.environment.scene import Scene
from simulation.environment.scenery import build_scenery
from simulation.environment.terrain import Terrain
from simulation.machine.machine import Machine
from simulation.machine.pose_buffer import PoseBuffer
from simulation.objects.encountered import ENCOUNTERED
from simulation.sensors.camera import CameraModel
from simulation.sensors.sensor import WorldState
from simulation.world import SimulationConfig

CAMERA = Camera(
    mount=Mount(xyz_m=(1.6, 0.0, 2.75), rpy_deg=(0.0, 8.0, 0.0)), size_px=(1280, 720), focal_px=(800.0, 800.0),
    center_px=(639.5, 359.5), distortion=(-0.05, 0.01, 0.0, 0.0, 0.0), rate_hz=2.0,
)  # fmt: skip
NEAR_M, FAR_M, EVALUATED_M = 4.0, 20.0, (5.0, 15.0)
LIMIT, GOAL = 0.80, 0.95
ORDER = (ObstacleClass.PERSON, ObstacleClass.PERSON, ObstacleClass.ANIMAL, ObstacleClass.PERSON, None,
         ObstacleClass.PERSON, ObstacleClass.VEHICLE, ObstacleClass.PERSON)  # fmt: skip
WHEELBASE_M, TRACK_M = 2.55, 1.9


@dataclass(frozen=True)
class LabelledImage:
    """An image, its actor's class (None: no actor), distance from the camera and box (4,) in the image."""

    bgr: UInt8
    label: ObstacleClass | None
    distance_m: float
    corners_px: Float64


def poses_at_rest(T_map_base: Float64) -> PoseBuffer:
    """Poses of a standing machine."""
    poses = PoseBuffer(5_000_000, 0.02)
    poses.append(T_map_base)
    return poses


def labelled_images(
    seed: int, camera: Camera = CAMERA, order: tuple[ObstacleClass | None, ...] = ORDER,
    range_m: tuple[float, float] = (NEAR_M, FAR_M),
) -> Iterator[LabelledImage]:  # fmt: skip
    """Images of one world, with actors at these distances."""
    config = parse(SimulationConfig, read_yaml(CONFIGS / "stack/simulation.yaml"), "stack/simulation.yaml")
    site, vehicle = load(Site, find("sites", "demo")), load(Vehicle, find("machines", "tractor_e"))
    terrain = Terrain(site, config.terrain, seed)
    scene = Scene(lambda: build_scenery(site, terrain, config.scenery, seed))
    model = CameraModel("front", camera, vehicle, site, (), seed, config.camera)
    random = np.random.default_rng([seed, 7])
    machine: Machine = None  # type: ignore[assignment]  # not read by the camera model
    for k, label in enumerate(order):
        T_map_base = draw_pose(terrain, random)
        actor, distance_m = draw_actor(100 * seed + k, label, range_m, T_map_base, terrain, camera, random)
        scene.actors = () if actor is None else (actor,)
        message = model.sample(WorldState(k, float(k), poses_at_rest(T_map_base), machine, scene))
        box = np.zeros(4) if actor is None else box_of(actor, T_map_base, camera)
        yield LabelledImage(message.bgr, label, distance_m, box)


def draw_pose(terrain: Terrain, random: np.random.Generator) -> Float64:
    """A pose in the field, before the gate or in the yard."""
    kind = random.integers(5)
    if kind < 3:
        x, y, yaw = random.uniform(12.0, 68.0), random.uniform(12.0, 38.0), random.uniform(-math.pi, math.pi)
    elif kind == 3:
        x, y, yaw = random.uniform(18.0, 22.0), random.uniform(-30.0, -20.0), random.normal(0.5 * math.pi, 0.15)
    else:
        x, y, yaw = random.uniform(10.0, 30.0), random.uniform(-47.0, -32.0), random.uniform(-math.pi, math.pi)
    return terrain.pose_on_ground(x, y, yaw, WHEELBASE_M, TRACK_M)


def draw_actor(
    id: int, label: ObstacleClass | None, range_m: tuple[float, float], T_map_base: Float64, terrain: Terrain,
    camera: Camera, random: np.random.Generator,
) -> tuple[ActorState | None, float]:  # fmt: skip
    """An actor entirely in the image, and its distance."""
    if label is None:
        return None, math.nan
    while True:
        distance, bearing = random.uniform(*range_m), math.radians(random.uniform(-36.0, 36.0))
        gait = -1.0 if random.random() < 0.4 else float(random.random())
        yaw = float(random.uniform(-math.pi, math.pi))
        ahead, left = distance * math.cos(bearing), distance * math.sin(bearing)
        p = T_map_base @ np.array([camera.mount.xyz_m[0] + ahead, left, 0.0, 1.0])
        place = (float(p[0]), float(p[1]), terrain.height_m(float(p[0]), float(p[1])))
        actor = ActorState(id, ENCOUNTERED[label], "", place, yaw, (0.0, 0.0), gait)
        low, high = box_of(actor, T_map_base, camera).reshape(2, 2)
        if (low >= 0.0).all() and (high < camera.size_px).all():
            return actor, float(distance)


def box_of(actor: ActorState, T_map_base: Float64, camera: Camera) -> Float64:
    """Left, top, right and bottom of an actor in the image, occlusion ignored."""
    T_camera_map = invert(T_map_base @ camera.mount.T_base_sensor)
    body = apply(T_camera_map, actor.vertices_map_m.astype(np.float64))
    optical = np.stack([-body[:, 1], -body[:, 2], body[:, 0]], axis=1)
    (fx, fy), (cx, cy) = camera.focal_px, camera.center_px
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    pixels, _ = cv2.projectPoints(optical, np.zeros(3), np.zeros(3), K, np.array(camera.distortion))
    flat = np.asarray(pixels, np.float64).reshape(-1, 2)
    return np.concatenate([flat.min(axis=0), flat.max(axis=0)])


def detect(image: LabelledImage, detector: Detector) -> tuple[bool, Boxes]:
    """True if the image's actor is detected; and all boxes of the stack's classes."""
    config = detector.config
    boxes = non_max_suppression(grouped(detector.detect(image.bgr)), config.min_score, config.max_iou)
    if image.label is None:
        return False, boxes
    mine = boxes.corners_px[boxes.label == GROUPS.index(image.label)]
    return bool((iou(image.corners_px[None], mine) >= 0.5).any()), boxes


def run(model: Path, worlds: int, out: Path | None) -> bool:
    """Prints all figures; True if the recall of persons meets the limit."""
    detector = load_detector(model, configured())
    rows: list[tuple[LabelledImage, bool, int, int]] = []
    render_s = 0.0
    for seed in range(1, worlds + 1):
        images = labelled_images(seed)
        for k in range(len(ORDER)):
            start = time.process_time()
            image = next(images)
            render_s += time.process_time() - start if k > 1 else 0.0
            is_detected, boxes = detect(image, detector)
            people = int((boxes.label == GROUPS.index(ObstacleClass.PERSON)).sum())
            false = people - int(is_detected and image.label is ObstacleClass.PERSON)
            rows.append(
                (
                    LabelledImage(image.bgr[:0], image.label, image.distance_m, image.corners_px),
                    is_detected,
                    false,
                    seed,
                )
            )
            if out is not None:
                save(out, seed, k, image, is_detected, boxes)
    each_ms = render_s / worlds / (len(ORDER) - 2) * 1e3
    print(f"{model.name}, {len(rows)} images of {worlds} worlds, {each_ms:.0f} ms each to render")
    for label in GROUPS:
        print_label(label, [(s.distance_m, f) for s, f, _, _ in rows if s.label is label])
    print_false(rows)
    in_range = [
        f for s, f, _, _ in rows if s.label is ObstacleClass.PERSON and EVALUATED_M[0] <= s.distance_m < EVALUATED_M[1]
    ]
    share = float(np.mean(in_range))
    at = f"person at {EVALUATED_M[0]:.0f} to {EVALUATED_M[1]:.0f} m"
    print(f"{at}: {sum(in_range)}/{len(in_range)} = {share:.3f} (limit {LIMIT}, goal {GOAL})")
    return share >= LIMIT


def print_label(label: ObstacleClass, trials: list[tuple[float, bool]]) -> None:
    """Prints recall per metre (persons) or four metres (others)."""
    width = 1.0 if label is ObstacleClass.PERSON else 4.0
    print(f"{label}: distance, detected of shown")
    for low in np.arange(NEAR_M, FAR_M, width):
        hits = [f for d, f in trials if low <= d < low + width]
        if hits:
            print(f"  {low:4.0f} to {low + width:2.0f} m  {sum(hits):3d}/{len(hits):3d}  {np.mean(hits):.2f}")


def print_false(rows: list[tuple[LabelledImage, bool, int, int]]) -> None:
    """Prints the number of false persons."""
    for name, mine in (("without actor", [r for r in rows if r[0].label is None]),
                       ("with animal or vehicle", [r for r in rows if r[0].label not in (None, ObstacleClass.PERSON)]),
                       ("with a person", [r for r in rows if r[0].label is ObstacleClass.PERSON])):  # fmt: skip
        print(f"false persons in images {name}: {sum(r[2] for r in mine)} in {len(mine)}")


def save(folder: Path, seed: int, k: int, image: LabelledImage, is_detected: bool, boxes: Boxes) -> None:
    """Saves an image with the true box (white) and the detected ones (red)."""
    bgr = image.bgr.copy()
    for corners, color in [(image.corners_px, (255, 255, 255)), *((c, (0, 0, 255)) for c in boxes.corners_px)]:
        left, top, right, bottom = (int(c) for c in corners)
        cv2.rectangle(bgr, (left, top), (right, bottom), color, 1)
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{'found' if is_detected else 'missed' if image.label else 'empty'}-{image.label or 'none'}-{seed}-{k}.jpg"
    cv2.imwrite(str(folder / name), bgr)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path, default=MODEL)
    parser.add_argument("--worlds", type=int, default=60)
    parser.add_argument("--out", type=Path, help="folder for images with boxes")
    arguments = parser.parse_args()
    sys.exit(0 if run(arguments.model, arguments.worlds, arguments.out) else 1)
