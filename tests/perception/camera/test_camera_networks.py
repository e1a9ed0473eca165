"""PicoDet and RT-DETR against manual calculation, input values of each family, and files that fit none."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from messages.errors import ConfigError
from perception.camera.detector import Detector, DetectorConfig, load_detector
from perception.camera.networks import FAMILIES, Nanodet, Picodet, RtDetr, RtDetrLogits, Yolox, recognize
from tests.perception.camera.onnx_files import write
from tests.recordings import DATA, needs

CONFIG = DetectorConfig(min_score=0.3, max_iou=0.45, max_tile_ratio=4.0, input_px=64)
SIDE = (64, 128)  # height and width
MODELS = DATA / "onnx-detectors"
YOLOX, NANODET = MODELS / "yolox-nano/model/yolox_nano.onnx", MODELS / "nanodet-m/model/nanodet_m_320.onnx"


def cells(stride: int) -> int:
    return -(-SIDE[0] // stride) * -(-SIDE[1] // stride)


def picodet(classes: int = 80) -> dict[str, np.ndarray]:
    """Outputs of PicoDet with one person: stride 32, row 1, column 2, reaching 1, 0.5, 2 and 1 cells."""
    scores = {f"transpose_{s}.tmp_0": np.full((1, cells(s), classes), 0.01, np.float32) for s in (8, 16, 32, 64)}
    distances = {f"save_{s}": np.zeros((1, cells(s), 32), np.float32) for s in (8, 16, 32, 64)}
    scores["transpose_32.tmp_0"][0, 6, 0] = 0.9
    bins = distances["save_32"][0, 6].reshape(4, 8)
    bins[[0, 2, 3], [1, 2, 1]] = 50.0
    bins[1, :2] = 50.0  # half way between 0 and 1
    return scores | distances


def rtdetr() -> dict[str, np.ndarray]:
    labels, scores = np.zeros((1, 300), np.int64), np.full((1, 300), 0.01, np.float32)
    boxes = np.full((1, 300, 4), 0.5, np.float32)
    labels[0, 7], scores[0, 7], boxes[0, 7] = 19, 0.8, (0.25, 0.5, 0.5, 0.75)
    return {"labels": labels, "boxes": boxes, "scores": scores}


def rtdetr_logits(classes: int = 80) -> dict[str, np.ndarray]:
    logits = np.full((1, 300, classes), -9.0, np.float32)
    boxes = np.full((1, 300, 4), 0.1, np.float32)
    logits[0, 7, 19], boxes[0, 7] = np.log(0.8 / 0.2), (0.375, 0.625, 0.25, 0.25)
    return {"logits": logits, "pred_boxes": boxes}


def yolox(width: int = 85) -> np.ndarray:
    return np.zeros((1, sum(cells(s) for s in (8, 16, 32)), width), np.float32)


def nanodet() -> dict[str, np.ndarray]:
    scores = {f"cls_pred_stride_{s}": np.zeros((1, cells(s), 80), np.float32) for s in (8, 16, 32)}
    return scores | {f"dis_pred_stride_{s}": np.zeros((1, cells(s), 32), np.float32) for s in (8, 16, 32)}


OF = {
    Yolox: {"output": yolox()}, Nanodet: nanodet(), Picodet: picodet(), RtDetr: rtdetr(),
    RtDetrLogits: rtdetr_logits(),
}  # fmt: skip


def load(path: Path, gives: dict[str, np.ndarray], takes: tuple[int | str, ...] = (1, 3, *SIDE), **more) -> Detector:
    return load_detector(write(path / "m.onnx", takes, gives, **more), CONFIG)


@pytest.mark.parametrize("family", FAMILIES)
def test_each_family_is_recognized_alone(family: type) -> None:
    assert set(OF) == set(FAMILIES)
    outputs = {name: values.astype(np.float32) for name, values in OF[family].items()}
    assert [f for f in FAMILIES if f.recognize(outputs, *SIDE) is not None] == [family]
    for other in FAMILIES:  # outputs of two networks in one file are none of either, but for what RT-DETR adds itself
        if other is not family and RtDetrLogits not in (family, other):
            assert recognize(outputs | OF[other], *SIDE) is None


@pytest.mark.parametrize("order", [1, -1])
def test_picodet_decoding_and_output_order(tmp_path: Path, order: int) -> None:
    outputs = dict(list(picodet().items())[::order])
    detector = load(tmp_path, outputs)
    assert isinstance(detector.network, Picodet)
    found = detector.detect(np.zeros((320, 256, 3), np.uint8))
    # the middle of the cell is (80, 48); the image is 2 times the input wide and 5 times high
    np.testing.assert_allclose(found.corners_px, [[48 * 2, 32 * 5, 128 * 2, 64 * 5]], atol=1e-3)
    assert found.scores[0].argmax() == 0


@pytest.mark.parametrize("takes", [(1, 3, *SIDE), ("N", 3, *SIDE), ("N", "C", *SIDE)])
def test_rtdetr_decoding(tmp_path: Path, takes: tuple[int | str, ...]) -> None:
    for outputs, family, more in (
        (rtdetr(), RtDetr, {"in_size": "boxes"}), (rtdetr_logits(), RtDetrLogits, {}),
        (rtdetr_logits() | {"features": np.zeros((1, 5), np.float32)}, RtDetrLogits, {}),
    ):  # fmt: skip
        detector = load(tmp_path, outputs, takes, **more)
        assert isinstance(detector.network, family)
        found = detector.detect(np.zeros((300, 400, 3), np.uint8))
        np.testing.assert_allclose(found.corners_px, [[100, 150, 200, 225]], atol=1e-3)
        assert found.scores[0].argmax() == 19
        assert found.scores[0, 19] == pytest.approx(0.8)


def test_extreme_logits() -> None:
    network = recognize(rtdetr_logits(), *SIDE)
    assert network is not None
    outputs = rtdetr_logits()
    outputs["logits"][0, 0, :2] = (-1e30, 1e30)
    np.testing.assert_array_equal(network.decode(outputs).scores[0, :2], [0.0, 1.0])


def test_class_outside_of_coco(tmp_path: Path) -> None:
    outputs = rtdetr()
    outputs["labels"][0, 3] = 90
    with pytest.raises(ConfigError, match=r"m\.onnx: its outputs .*labels \[1, 300\].* 91 classes, not COCO's 80"):
        load(tmp_path, outputs, in_size="boxes")
    network = RtDetr()
    late = {name: values.astype(np.float32) for name, values in rtdetr().items()}
    for label in (80, -1):
        late["labels"][0, 3] = label
        with pytest.raises(ValueError, match="COCO's 80 classes"):
            network.decode(late)


@pytest.mark.parametrize(
    ("family", "wanted"),
    [
        (Yolox, [10.0, 20.0, 30.0]),
        (Nanodet, [(10 - 103.53) / 57.375, (20 - 116.28) / 57.12, (30 - 123.675) / 58.395]),
        (Picodet, [(30 / 255 - 0.485) / 0.229, (20 / 255 - 0.456) / 0.224, (10 / 255 - 0.406) / 0.225]),
        (RtDetr, [30 / 255, 20 / 255, 10 / 255]),
        (RtDetrLogits, [30 / 255, 20 / 255, 10 / 255]),
    ],
)
def test_input_values(family: type, wanted: list[float]) -> None:
    network = recognize({name: values.astype(np.float32) for name, values in OF[family].items()}, *SIDE)
    assert network is not None
    bgr = np.broadcast_to(np.array([10.0, 20.0, 30.0], np.float32)[:, None, None], (3, 2, 4))
    np.testing.assert_allclose(network.prepare(bgr)[:, 1, 2], wanted, rtol=1e-5)
    assert network.is_stretched == (family in (Picodet, RtDetr, RtDetrLogits))


def with_(outputs: dict[str, np.ndarray], **changed: np.ndarray) -> dict[str, np.ndarray]:
    return outputs | changed


@pytest.mark.parametrize(
    "outputs",
    [
        pytest.param({"output": yolox() - 3.0}, id="YOLOX without its last sigmoid"),
        pytest.param({"output": yolox() + np.eye(85, dtype=np.float32)[4]}, id="YOLOv6: objectness 1 everywhere"),
        pytest.param({"output": yolox() * np.nan}, id="not a number"),
        pytest.param({"output": yolox().transpose(0, 2, 1)}, id="YOLOX transposed"),
        pytest.param({"output": np.repeat(yolox(), 2, axis=0)}, id="a batch of two"),
        pytest.param({"output0": np.zeros((1, 84, yolox().shape[1]), np.float32)}, id="YOLOv8"),
        pytest.param(picodet(20), id="PicoDet of 20 classes"),
        pytest.param({n: v for n, v in picodet().items() if "64" not in n}, id="a level is missing"),
        pytest.param({n: v[0] for n, v in picodet().items()}, id="without the dimension of the batch"),
        pytest.param(with_(picodet(), save_8=np.zeros((1, cells(8), 80), np.float32)), id="two scores of a level"),
        pytest.param(with_(picodet(), save_8=np.zeros((1, cells(8), 30), np.float32)), id="no four distributions"),
        pytest.param({n: v - 1.0 for n, v in picodet().items()}, id="PicoDet without its last sigmoid"),
        pytest.param({n: v[:, :-1] for n, v in picodet().items()}, id="another size"),
        pytest.param(with_(rtdetr(), scores=np.full((1, 300), 7.0, np.float32)), id="RT-DETR scores above 1"),
        pytest.param(with_(rtdetr(), boxes=np.zeros((1, 300, 5), np.float32)), id="turned boxes"),
        pytest.param({n: v[0] for n, v in rtdetr().items()}, id="RT-DETR without the dimension of the batch"),
        pytest.param(with_(rtdetr_logits(), pred_boxes=np.full((1, 300, 4), 60.0, np.float32)), id="boxes in pixels"),
        pytest.param({n: v[0] for n, v in rtdetr_logits().items()}, id="logits without the dimension of the batch"),
        pytest.param(with_(rtdetr(), labels=np.zeros((1, 300, 91), np.float32)), id="RF-DETR"),
        pytest.param({"probabilities": np.zeros((1, 1000), np.float32)}, id="a classifier"),
        pytest.param({"masks": np.zeros((1, 21, *SIDE), np.float32)}, id="segmentation"),
        pytest.param({"embedding": np.zeros((), np.float32)}, id="one number"),
    ],
)  # fmt: skip
def test_other_outputs_are_named(tmp_path: Path, outputs: dict[str, np.ndarray]) -> None:
    with pytest.raises(ConfigError) as failure:
        load(tmp_path, outputs)
    text = str(failure.value)
    assert "are those of none of YOLOX, NanoDet, PicoDet and RT-DETR for 128 x 64" in text
    assert "\n" not in text
    for name, values in outputs.items():
        assert f"{name} {list(values.shape)}" in text


@pytest.mark.parametrize("classes", [1, 20, 91])
def test_class_count(tmp_path: Path, classes: int) -> None:
    logits = rtdetr_logits(91) | {"logits": np.zeros((1, 300, classes), np.float32)}
    for outputs in ({"output": yolox(classes + 5)}, logits):
        with pytest.raises(ConfigError, match=rf"have {classes} classes, not COCO's 80"):
            load(tmp_path, outputs)


@pytest.mark.parametrize(
    ("takes", "more"),
    [
        ((1, *SIDE, 3), {}), (("N", "H", "W", 3), {}), (SIDE, {}), ((3, *SIDE), {}), ((8, 3, *SIDE), {}),
        ((1, 1, *SIDE), {}), ((1, 3, *SIDE), {"dtype": np.float64}), ((1, 3, *SIDE), {"dtype": np.int64}),
    ],
)  # fmt: skip
def test_other_inputs_are_named(tmp_path: Path, takes: tuple[int | str, ...], more: dict) -> None:
    with pytest.raises(ConfigError, match=r"m\.onnx: takes image \[.*\] tensor\(.*\), not one float image") as failure:
        load(tmp_path, {"output": yolox()}, takes, **more)
    assert "its outputs are output [1, 168, 85]" in str(failure.value)


def test_second_output_of_another_type(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"extra \[1\] tensor\(double\)"):
        load(tmp_path, {"output": yolox(), "extra": np.zeros(1)})


def test_float16(tmp_path: Path) -> None:
    outputs = {name: values.astype(np.float16) for name, values in rtdetr_logits().items()}
    for dtype in (np.float16, np.float32):
        found = load(tmp_path, outputs, dtype=dtype).detect(np.zeros((300, 400, 3), np.uint8))
        assert found.corners_px.dtype == np.float32
        np.testing.assert_allclose(found.corners_px, [[100, 150, 200, 225]], atol=0.1)


@needs("onnx-detectors")
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9, 0.999])
@pytest.mark.parametrize("file", [YOLOX, NANODET])
def test_truncated_file(tmp_path: Path, file: Path, share: float) -> None:
    data = file.read_bytes()
    cut = tmp_path / "cut.onnx"
    cut.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(ConfigError, match=r"cut\.onnx: ") as failure:
        load_detector(cut, CONFIG)
    assert "\n" not in str(failure.value)


@needs("onnx-detectors")
def test_damaged_bytes(tmp_path: Path) -> None:
    """A flipped byte of a weight is not visible here (the hash of a known model finds it); the reader survives all."""
    data, random = bytearray(YOLOX.read_bytes()), np.random.default_rng(4)
    for place in random.integers(0, 4000, 20):
        bad = data.copy()
        bad[place] ^= 0xFF
        (tmp_path / "bad.onnx").write_bytes(bad)
        with suppress(ConfigError):
            load_detector(tmp_path / "bad.onnx", CONFIG)
