"""Decoders against manual calculation, model recognition, unsupported files, published networks on photographs."""

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.errors import ConfigError
from messages.perception import ObstacleClass
from perception.camera.boxes import Boxes, Candidates, iou, non_max_suppression
from perception.camera.classes import COCO, class_scores, group_scores
from perception.camera.detector import DetectorConfig, fit, join_tiles, load_detector, split_tiles
from perception.camera.networks import Nanodet, Yolox, recognize
from perception.camera.networks.focal import expectation
from tests.perception.camera.onnx_files import write
from tests.recordings import DATA, needs, recording

YOLOX = DATA / "onnx-detectors" / "yolox-nano" / "model" / "yolox_nano.onnx"
NANODET = DATA / "onnx-detectors" / "nanodet-m" / "model" / "nanodet_m_416.onnx"
CONFIG = DetectorConfig(min_score=0.3, max_iou=0.45, max_tile_ratio=1.5, input_px=64)
needs_models = needs("onnx-detectors")


def yolox_cells(side: int = 64) -> int:
    return sum((side // s) ** 2 for s in (8, 16, 32))


def nanodet_outputs(side: int = 64, classes: int = 80) -> dict[str, np.ndarray]:
    sizes = {s: (side // s) ** 2 for s in (8, 16, 32)}
    scores = {f"cls_pred_stride_{s}": np.full((1, n, classes), 0.01, np.float32) for s, n in sizes.items()}
    return scores | {f"dis_pred_stride_{s}": np.zeros((1, n, 32), np.float32) for s, n in sizes.items()}


def test_yolox_offset_decoding() -> None:
    raw = np.zeros((1, yolox_cells(), 85), np.float32)
    raw[0, :, 2:4] = -9.0
    cell = 8 * 8 + 1 * 4 + 2  # stride 16: row 1, column 2
    raw[0, cell, :5] = (0.25, 0.5, np.log(2.0), np.log(3.0), 0.5)
    raw[0, cell, 5 + 16] = 0.8
    network = recognize({"output": raw}, 64, 64)
    assert isinstance(network, Yolox)
    assert not network.is_decoded
    found = network.decode({"output": raw})
    np.testing.assert_allclose(found.corners_px[cell], [36 - 16, 24 - 24, 36 + 16, 24 + 24], atol=1e-4)
    assert found.scores[cell, 16] == pytest.approx(0.4)
    assert found.scores.sum() == pytest.approx(0.4)


def test_yolox_decoded_export() -> None:
    raw = np.zeros((1, yolox_cells(), 85), np.float32)
    plain = recognize({"output": raw}, 64, 64)
    assert isinstance(plain, Yolox)
    pixels = raw.copy()
    pixels[0, :, :2], pixels[0, :, 2:4] = plain.corner_px, plain.stride_px[:, None]
    decoded = recognize({"output": pixels}, 64, 64)
    assert isinstance(decoded, Yolox)
    assert decoded.is_decoded
    np.testing.assert_allclose(
        decoded.decode({"output": pixels}).corners_px, plain.decode({"output": raw}).corners_px, atol=1e-4
    )


def test_nanodet_decoding_and_output_order() -> None:
    outputs = nanodet_outputs()
    outputs["dis_pred_stride_16"][0, 5].reshape(4, 8)[[0, 1, 2, 3], [1, 2, 3, 4]] = 50.0  # row 1, column 1
    for order in (list(outputs), list(reversed(outputs))):
        given_ = {name: outputs[name] for name in order}
        network = recognize(given_, 64, 64)
        assert isinstance(network, Nanodet)
        corners = network.decode(given_).corners_px
        wanted = [23.5 - 16, 23.5 - 32, 23.5 + 48, 23.5 + 64]
        assert np.isclose(corners, wanted, atol=1e-3).all(axis=1).any()


def test_expectation_of_uniform_distribution() -> None:
    np.testing.assert_allclose(expectation(np.zeros((2, 32), np.float32)), 3.5)
    assert np.isfinite(expectation(np.full((1, 32), 1e30, np.float32))).all()


@pytest.mark.parametrize(
    "outputs",
    [
        {"output": np.zeros((1, yolox_cells() - 1, 85), np.float32)},
        {"output": np.zeros((1, yolox_cells(), 5), np.float32)},
        {"output": np.zeros((yolox_cells(), 85), np.float32)},
        {"a": np.zeros((1, yolox_cells(), 85), np.float32), "b": np.zeros((1, 1), np.float32)},
        {k: v for k, v in nanodet_outputs().items() if k != "dis_pred_stride_32"},
        nanodet_outputs() | {"dis_pred_stride_8": np.zeros((1, 64, 30), np.float32)},
        nanodet_outputs() | {"cls_pred_stride_8": np.zeros((1, 64, 79), np.float32)},
        nanodet_outputs(96),
        {"cls_pred_stride_0": np.zeros((1, 1, 80), np.float32), "dis_pred_stride_0": np.zeros((1, 1, 32), np.float32)},
        {},
    ],
)
def test_other_outputs_are_not_recognized(outputs: dict[str, np.ndarray]) -> None:
    assert recognize(outputs, 64, 64) is None


def test_unsupported_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gone\.onnx: no such model file"):
        load_detector(tmp_path / "gone.onnx", CONFIG)
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"\x08\x08not a model")
    with pytest.raises(ConfigError, match=r"broken\.onnx: not a model"):
        load_detector(broken, CONFIG)
    other = write(tmp_path / "other.onnx", (1, 3, 64, 64), {"probabilities": np.zeros((1, 1000), np.float32)})
    with pytest.raises(ConfigError, match=r"other\.onnx: its outputs probabilities \[1, 1000\] are those of none"):
        load_detector(other, CONFIG)
    flat = write(tmp_path / "flat.onnx", (1, 10), {"output": np.zeros((1, 10), np.float32)})
    with pytest.raises(ConfigError, match=r"flat\.onnx: takes image \[1, 10\]"):
        load_detector(flat, CONFIG)
    few = write(tmp_path / "few.onnx", (1, 3, 64, 64), {"output": np.zeros((1, yolox_cells(), 8), np.float32)})
    with pytest.raises(ConfigError, match=r"few\.onnx: .* 3 classes, not COCO's 80"):
        load_detector(few, CONFIG)


@pytest.mark.parametrize("takes", [(1, 3, 64, 64), (1, 3, "height", "width"), ("batch", 3, 64, 64)])
def test_input_size_from_file_or_configuration(tmp_path: Path, takes: tuple[int | str, ...]) -> None:
    raw = np.full((1, yolox_cells(), 85), 0.0, np.float32)
    raw[0, 70, 4:6] = 1.0
    detector = load_detector(write(tmp_path / "m.onnx", takes, {"output": raw}), CONFIG)
    assert detector.model.size_px == (64, 64)
    found = detector.detect(np.zeros((128, 128, 3), np.uint8))
    assert found.scores.shape == (1, 80)  # one cell with class person
    # cell 70 is row 1, column 2 of stride 16; the image is twice the input
    np.testing.assert_allclose(found.corners_px[0], [48, 16, 80, 48])


def test_letterbox_aspect_ratio_and_padding() -> None:
    canvas, scale = fit(np.full((100, 200, 3), (1, 2, 3), np.uint8), (64, 64), is_stretched=False)
    assert canvas.shape == (64, 64, 3)
    np.testing.assert_allclose(scale, 0.32)
    np.testing.assert_array_equal(canvas[0, 0], [1, 2, 3])
    np.testing.assert_array_equal(canvas[32, 0], [114, 114, 114])


def test_stretched_image() -> None:
    canvas, scale = fit(np.full((100, 200, 3), (1, 2, 3), np.uint8), (64, 96), is_stretched=True)
    assert (canvas == [1, 2, 3]).all()
    assert canvas.shape == (64, 96, 3)
    np.testing.assert_allclose(scale, [0.48, 0.64])


@given(st.integers(16, 4000), st.integers(16, 4000), st.floats(1.0, 4.0))
@settings(derandomize=True, max_examples=200)
def test_tiles_cover_the_image(width: int, height: int, max_ratio: float) -> None:
    tiles = split_tiles(width, height, max_ratio)
    assert tiles[0][0] == 0
    assert tiles[-1][1] == width
    for (a, b), (c, _) in pairwise(tiles):
        assert a < c < b
    assert len(tiles) == 1 or width > max_ratio * height


def test_candidate_cut_by_tile_border() -> None:
    score = np.eye(80, dtype=np.float32)[:1]
    complete = Candidates(np.array([[600, 10, 720, 90]], np.float32), score)
    cut = Candidates(np.array([[600, 10, 700, 90]], np.float32), score)
    tiles = [(0, 700), (580, 1280)]
    assert len(join_tiles([cut, complete], tiles, 1280).scores) == 1
    empty = Candidates(np.empty((0, 4), np.float32), np.empty((0, 80), np.float32))
    assert len(join_tiles([cut, empty], tiles, 1280).scores) == 1
    assert len(join_tiles([empty, empty], tiles, 1280).scores) == 0


boxes = st.tuples(st.floats(0, 500), st.floats(0, 500), st.floats(1, 300), st.floats(1, 300))


@given(st.lists(st.tuples(boxes, st.integers(0, 2), st.floats(0.0, 1.0)), max_size=30))
@settings(derandomize=True, max_examples=100)
def test_non_max_suppression(items: list[tuple[tuple[float, ...], int, float]]) -> None:
    corners = np.array([(x, y, x + w, y + h) for (x, y, w, h), _, _ in items], np.float32).reshape(-1, 4)
    scores = np.zeros((len(items), 3), np.float32)
    for i, (_, label, score) in enumerate(items):
        scores[i, label] = score
    picked = non_max_suppression(Candidates(corners, scores), 0.3, 0.5)
    assert (np.diff(picked.score) <= 0).all()
    assert (picked.score >= np.float32(0.3)).all()
    for label in range(3):
        mine = picked.corners_px[picked.label == label]
        assert (iou(mine, mine) - np.eye(len(mine)) <= 0.5 + 1e-6).all()
        # each removed box overlaps a better one that was kept
        for k in np.flatnonzero(scores[:, label] >= np.float32(0.3)):
            assert (iou(corners[k : k + 1].astype(float), mine) > 0.5 - 1e-4).any()


def test_non_finite_candidates() -> None:
    corners = np.array([[0, 0, 10, 10], [np.nan, 0, 10, 10], [0, 0, np.inf, 10]], np.float32)
    picked = non_max_suppression(Candidates(corners, np.full((3, 1), 0.9, np.float32)), 0.3, 0.5)
    assert len(picked) == 1
    assert isinstance(non_max_suppression(Candidates(corners[:0], np.empty((0, 3), np.float32)), 0.3, 0.5), Boxes)


def test_class_groups() -> None:
    scores = np.zeros((1, 80), np.float32)
    scores[0, [COCO.index("cow"), COCO.index("sheep"), COCO.index("chair")]] = (0.4, 0.5, 0.9)
    np.testing.assert_allclose(group_scores(scores), [[0.0, 0.5, 0.0]])
    row = class_scores(1, 0.5)
    assert row.sum() == pytest.approx(1.0)
    assert row[2] == pytest.approx(0.5)  # ObstacleClass: unknown, person, animal
    np.testing.assert_allclose(np.delete(row, 2), 0.5 / (len(ObstacleClass) - 1))


@needs_models
@pytest.mark.parametrize(("file", "family"), [(YOLOX, Yolox), (NANODET, Nanodet)])
def test_published_networks_detect_persons(file: Path, family: type) -> None:
    image = recording("pennfudan/images/FudanPed00001.png")
    detector = load_detector(file, CONFIG)
    assert isinstance(detector.network, family)
    bgr = cv2.imread(str(image))
    candidates = detector.detect(bgr)
    found = non_max_suppression(Candidates(candidates.corners_px, group_scores(candidates.scores)), 0.3, 0.45)
    people = found.corners_px[found.label == 0]
    truth = np.array([[159, 181, 301, 430], [419, 170, 535, 485]], float)  # its annotation
    assert (iou(truth, people).max(axis=1) > 0.7).all()
    again = detector.detect(bgr)
    np.testing.assert_array_equal(again.corners_px, candidates.corners_px)
    np.testing.assert_array_equal(again.scores, candidates.scores)


@needs_models
def test_black_image() -> None:
    assert len(load_detector(YOLOX, CONFIG).detect(np.zeros((720, 1280, 3), np.uint8)).scores) == 0
