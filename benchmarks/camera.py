"""Benchmark of the camera detector: AP50 and recall on Penn-Fudan and COCO128 with the stack's decoder.

    ./headland benchmark camera [--model FILE]

AP50 is COCO's: all-point precision envelope read at 101 recalls, IoU 0.5, best detections first, crowds neither hit nor
miss. "80 classes" is the mean over the COCO classes that occur in the images; "obstacles" scores person, animal and
vehicle as the stack reports them. "At d m" scales each Penn-Fudan image until its tallest person is as tall as one of
1.7 m at that distance in a 1280 x 720 image of 80 degrees, and counts the complete, upright persons that are found.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from re import findall

import cv2
import numpy as np

from benchmarks.recordings import DATA
from configs.strict import parse, read_yaml
from geometry.arrays import Float64, Int64, UInt8
from perception.camera.boxes import Boxes, Candidates, area, intersection, iou, non_max_suppression
from perception.camera.classes import COCO, GROUPS, MEMBERS, group_scores
from perception.camera.detector import Detector, DetectorConfig, load_detector

MODEL = DATA / "onnx-detectors" / "yolox-nano" / "model" / "yolox_nano.onnx"
PENNFUDAN_LIMIT, COCO128_LIMIT = 0.93, 0.60
PERSON_M, VIEW_PX, VIEW_DEG = 1.7, (1280, 720), 80.0
RECALLS = np.linspace(0.0, 1.0, 101)
CURVE_FROM = 0.005


@dataclass(frozen=True)
class Sample:
    """An image and its labels: `corners_px` (M, 4), COCO index `label` (M,), `is_crowd` (M,)."""

    bgr: UInt8
    corners_px: Float64
    label: Int64
    is_crowd: Int64


Labelling = Callable[[Candidates], Candidates]
Evaluated = tuple[Boxes, Sample]


def pennfudan(folder: Path) -> Iterator[Sample]:
    """Available images of Penn-Fudan with all annotated pedestrians."""
    for image in sorted((folder / "images").glob("*.png")):
        text = (folder / "annotation" / f"{image.stem}.txt").read_text(encoding="latin-1")
        rows = findall(r"\(Xmin, Ymin\) - \(Xmax, Ymax\) : \((\d+), (\d+)\) - \((\d+), (\d+)\)", text)
        corners = np.array(rows, np.float64).reshape(-1, 4) - np.array([1, 1, 0, 0])  # counted from 1, ends included
        zeros = np.zeros(len(corners), np.int64)
        yield Sample(_read(image), corners, zeros, zeros)


def coco128(folder: Path) -> Iterator[Sample]:
    """The 128 images with all boxes of the 80 COCO classes."""
    truth = json.loads((folder / "annotations" / "instances_train2017.json").read_text())
    index = {c["id"]: COCO.index(c["name"]) for c in truth["categories"]}
    for image in sorted(truth["images"], key=lambda i: str(i["file_name"])):
        rows = [a for a in truth["annotations"] if a["image_id"] == image["id"]]
        boxes = np.array([a["bbox"] for a in rows], np.float64).reshape(-1, 4)
        boxes[:, 2:] += boxes[:, :2]
        label = np.array([index[a["category_id"]] for a in rows], np.int64)
        crowd = np.array([a["iscrowd"] for a in rows], np.int64)
        yield Sample(_read(folder / "train2017" / image["file_name"]), boxes, label, crowd)


def _read(path: Path) -> UInt8:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR), np.uint8)


def evaluate(results: Iterable[Evaluated], label: int) -> tuple[Float64, Int64, int]:
    """Score (D,) and hit (D,) of all detections of a class over all images, and the number of labels."""
    scores, hits, n = [], [], 0
    for boxes, sample in results:
        is_class, truth = boxes.label == label, sample.label == label
        crowd = sample.corners_px[truth & (sample.is_crowd == 1)]
        labels = sample.corners_px[truth & (sample.is_crowd == 0)]
        hit, ignored = match(boxes.corners_px[is_class], labels, crowd)
        scores.append(boxes.score[is_class][~ignored])
        hits.append(hit[~ignored])
        n += len(labels)
    score, hit = np.concatenate(scores), np.concatenate(hits)
    order = np.argsort(-score, kind="stable")
    return score[order], hit[order].astype(np.int64), n


def match(found: Float64, labels: Float64, crowd: Float64) -> tuple[Int64, Int64]:
    """Which detections (best first) hit a box not yet hit, and which lie in a crowd and are ignored."""
    free = np.ones(len(labels), bool)
    hit, ignored = np.zeros(len(found), bool), np.zeros(len(found), bool)
    overlap = iou(found, labels)
    for i in range(len(found)):
        candidates = np.where(free, overlap[i], -1.0) if len(labels) else np.array([-1.0])
        best = int(candidates.argmax())
        if candidates[best] >= 0.5:
            hit[i], free[best] = True, False
        elif len(crowd):
            covered = intersection(found[i : i + 1], crowd) / max(float(area(found[i : i + 1])[0]), 1e-9)
            ignored[i] = bool(covered.max() >= 0.5)
    return hit, ignored


def average_precision(hit: Int64, n: int) -> float:
    """Mean over 101 recalls of the best precision at that recall or beyond (COCO)."""
    if n == 0:
        return math.nan
    found = np.cumsum(hit)
    recall = found / n
    precision = np.maximum.accumulate((found / np.arange(1, len(hit) + 1))[::-1])[::-1]
    place = np.searchsorted(recall, RECALLS, side="left")
    return float(np.where(place < len(hit), np.append(precision, 0.0)[np.minimum(place, len(hit))], 0.0).mean())


def grouped(candidates: Candidates) -> Candidates:
    """Candidates scored for person, animal and vehicle."""
    return Candidates(candidates.corners_px, group_scores(candidates.scores))


def as_groups(sample: Sample) -> Sample:
    """The sample with labels of `GROUPS`; -1 for other classes."""
    of = {COCO.index(name): g for g, group in enumerate(GROUPS) for name in MEMBERS[group]}
    return Sample(sample.bgr, sample.corners_px, np.array([of.get(int(x), -1) for x in sample.label]), sample.is_crowd)


def shrunk(sample: Sample, distance_m: float) -> tuple[UInt8, Float64]:
    """Image scaled to put its tallest person at `distance_m`, extended by mirroring to fill the view."""
    focal_px = VIEW_PX[0] / 2 / math.tan(math.radians(VIEW_DEG / 2))
    scale = focal_px * PERSON_M / distance_m / float((sample.corners_px[:, 3] - sample.corners_px[:, 1]).max())
    small = cv2.resize(sample.bgr, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = small[: VIEW_PX[1], : VIEW_PX[0]]
    top, left = (VIEW_PX[1] - small.shape[0]) // 2, (VIEW_PX[0] - small.shape[1]) // 2
    y = _mirrored(VIEW_PX[1], small.shape[0], top)
    x = _mirrored(VIEW_PX[0], small.shape[1], left)
    return np.asarray(small[y][:, x], np.uint8), sample.corners_px * scale + np.array([left, top, left, top])


def _mirrored(n: int, size: int, start: int) -> Int64:
    place = (np.arange(n) - start) % (2 * size)
    return np.minimum(place, 2 * size - 1 - place)


def far_recall(samples: list[Sample], detector: Detector, distance_m: float) -> tuple[int, int]:
    """Number of tallest persons found at a distance with the configured score, and number of images."""
    found = 0
    for sample in samples:
        bgr, corners = shrunk(sample, distance_m)
        tallest = corners[[int((corners[:, 3] - corners[:, 1]).argmax())]]
        boxes = non_max_suppression(grouped(detector.detect(bgr)), detector.config.min_score, detector.config.max_iou)
        found += bool((iou(tallest, boxes.corners_px[boxes.label == 0]) >= 0.5).any())
    return found, len(samples)


def detect_all(samples: list[Sample], detector: Detector) -> tuple[list[Candidates], float]:
    """Candidates of each image, and milliseconds of one core per image."""
    start = time.process_time()
    found = [detector.detect(sample.bgr) for sample in samples]
    return found, (time.process_time() - start) / len(samples) * 1e3


def line(name: str, results: list[Evaluated], label: int, score: float) -> float:
    """Prints AP50, and recall and precision at the configured score; returns AP50."""
    scores, hit, n = evaluate(results, label)
    ap, accepted = average_precision(hit, n), scores >= score
    recall, precision = hit[accepted].sum() / max(n, 1), hit[accepted].mean() if accepted.any() else math.nan
    print(f"  {name:<10} AP50 {ap:.3f}   at score {score:.2f}: recall {recall:.3f} precision {precision:.3f}   n {n}")
    return ap


def configured() -> DetectorConfig:
    """Configured selection of detections."""
    perception = read_yaml(Path(__file__).parents[1] / "configs/stack/perception.yaml")
    return parse(DetectorConfig, perception["camera"]["detector"], "stack/perception.yaml: camera.detector")


def run(model: Path, data: Path) -> bool:
    """Prints all results; returns whether both limits are met."""
    config = configured()
    # AP needs the complete curve, with candidates far below the configured score
    detector = load_detector(model, config.model_copy(update={"min_score": CURVE_FROM}))
    print(f"{model.name}: {type(detector.network).__name__}, {detector.model.size_px[1]} x {detector.model.size_px[0]}")
    people, samples = list(pennfudan(data / "pennfudan")), list(coco128(data / "coco128"))
    found, ms = detect_all(people, detector)
    print(f"pennfudan, {len(people)} images, {ms:.1f} ms each")
    iou_limit = config.max_iou
    results = [(non_max_suppression(grouped(c), CURVE_FROM, iou_limit), s) for c, s in zip(found, people, strict=True)]
    first = line("person", results, 0, config.min_score)
    found, ms = detect_all(samples, detector)
    print(f"coco128, {len(samples)} images, {ms:.1f} ms each")
    results = [
        (non_max_suppression(grouped(c), CURVE_FROM, iou_limit), as_groups(s))
        for c, s in zip(found, samples, strict=True)
    ]
    second, *_ = [line(str(g), results, i, config.min_score) for i, g in enumerate(GROUPS)]
    results = [(non_max_suppression(c, CURVE_FROM, iou_limit), s) for c, s in zip(found, samples, strict=True)]
    aps = [average_precision(*evaluate(results, k)[1:]) for k in range(len(COCO))]
    print(f"  80 classes mean AP50 {np.nanmean(aps):.3f} over {np.isfinite(aps).sum()} that occur")
    for distance in (3, 5, 10, 15, 20, 30):
        print_far(people, load_detector(model, config), distance)
    print(f"limits: pennfudan person {first:.3f} of {PENNFUDAN_LIMIT}, coco128 person {second:.3f} of {COCO128_LIMIT}")
    return first >= PENNFUDAN_LIMIT and second >= COCO128_LIMIT


def print_far(people: list[Sample], detector: Detector, distance_m: float) -> None:
    """Prints the recall at a distance and the time per image."""
    start = time.process_time()
    n, of = far_recall(people, detector, distance_m)
    ms = (time.process_time() - start) / of * 1e3
    print(f"  person at {distance_m:>2} m in {VIEW_PX[0]} x {VIEW_PX[1]}: {n}/{of} found, {ms:.0f} ms per image")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path, default=MODEL)
    parser.add_argument("--data", type=Path, default=DATA)
    arguments = parser.parse_args()
    sys.exit(0 if run(arguments.model, arguments.data) else 1)
