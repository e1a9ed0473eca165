"""ONNX file of a detector: its image input, and a run that returns the outputs by name."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import Float32
from messages.errors import ConfigError

IMAGE_TYPES: dict[str, type[np.floating[Any]]] = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
OUTPUT_TYPES = {*IMAGE_TYPES, "tensor(int64)", "tensor(int32)"}
SIZE_INPUT = "orig_target_sizes"  # second input of RT-DETR: width and height in which its boxes are given


@dataclass(frozen=True)
class Model:
    """Loaded file; `size_px` is height and width of its image input, `constants` are its other inputs."""

    session: Any
    image: str
    dtype: type[np.floating[Any]]
    size_px: tuple[int, int]
    constants: dict[str, NDArray[np.int64]]

    def run(self, values: Float32) -> dict[str, Float32]:
        """Outputs by name for input values (3, H, W)."""
        outputs = self.session.run(None, {self.image: values[None].astype(self.dtype), **self.constants})
        names = [output.name for output in self.session.get_outputs()]
        return {name: output.astype(np.float32) for name, output in zip(names, outputs, strict=True)}

    def outputs(self) -> str:
        """Names and shapes of the outputs as the file states them."""
        return ", ".join(f"{o.name} {list(o.shape)}" for o in self.session.get_outputs())


def open_model(path: Path, open_px: int) -> Model:
    """Model of a file, `open_px` high and wide where the file leaves this open.

    Raises ConfigError with inputs and outputs for a file that does not take one image (1, 3, H, W) or give tensors.
    """
    session = _open(path)
    inputs, outputs = session.get_inputs(), session.get_outputs()
    images = [i for i in inputs if not _is_size_input(i)]
    size = _size(images[0].shape, open_px) if len(images) == 1 and images[0].type in IMAGE_TYPES else None
    if size is None or any(o.type not in OUTPUT_TYPES for o in outputs):
        taken, given = (", ".join(f"{x.name} {list(x.shape)} {x.type}" for x in those) for those in (inputs, outputs))
        raise ConfigError(f"{path}: takes {taken}, not one float image (1, 3, H, W); its outputs are {given}")
    constants = {i.name: np.array([size[::-1]], np.int64) for i in inputs if _is_size_input(i)}
    return Model(session, images[0].name, IMAGE_TYPES[images[0].type], size, constants)


def trial(path: Path, model: Model) -> dict[str, Float32]:
    """Outputs for an image of zeros: true shapes, also where the file leaves them open, and warm-up."""
    height, width = model.size_px
    try:
        return model.run(np.zeros((3, height, width), np.float32))
    except Exception as error:  # onnxruntime raises a separate class per cause
        raise ConfigError(f"{path}: cannot run on an image of {width} x {height} ({_first_line(error)})") from error


def _open(path: Path) -> Any:
    import onnxruntime  # late import: heavy, and needed only with a model

    if not path.is_file():
        raise ConfigError(f"{path}: no such model file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3  # NanoDet's file causes 300 lines of warnings
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a separate class per cause
        raise ConfigError(f"{path}: not a model that onnxruntime can load ({_first_line(error)})") from error


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0][:200] if str(error) else type(error).__name__


def _is_size_input(one: Any) -> bool:
    return one.name == SIZE_INPUT and one.type == "tensor(int64)" and len(one.shape) == 2


def _size(shape: list[int | str | None], open_px: int) -> tuple[int, int] | None:
    """Height and width of an image input (1, 3, H, W) of which any may be open, None for other shapes."""
    if len(shape) != 4 or not _is(shape[0], 1) or not _is(shape[1], 3) or shape[3] == 3:
        return None
    height, width = (n if isinstance(n, int) and n > 0 else open_px for n in shape[2:])
    return height, width


def _is(size: int | str | None, wanted: int) -> bool:
    return size == wanted or not isinstance(size, int)
