"""Whether a picture shows the world: dark, dazzled, blurred, partly covered, frozen.

Sharpness is the energy of the Laplacian at half size over that at quarter size. It does not depend on contrast or
scene, and halving takes the sensor's noise out: over coco128 and Penn-Fudan sharp pictures have 0.44 to 2.3, the same
blurred by a Gaussian of 2.5 px at most 0.22, by 4 px at most 0.13 (0.42 with noise of 3 grey levels added).
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field

from configs.strict import Config
from messages.message import Float32, UInt8
from messages.perception import HealthState

Bools = npt.NDArray[np.bool_]
ROWS = 6  # cells over the height of the picture


class LensConfig(Config):
    """From what a picture counts as bad; grey levels are of 255."""

    dark_level: float = Field(ge=0.0, le=255.0, description="below it 95 % of the pixels of a dark picture")
    glare_level: float = Field(ge=0.0, le=255.0)
    glare_share: float = Field(gt=0.0, le=1.0, description="of pixels above that level, from which it is dazzled")
    least_sharpness: float = Field(gt=0.0, le=2.0)
    flat_level: float = Field(gt=0.0, le=50.0, description="deviation within a cell from which it shows something")
    covered_share: float = Field(gt=0.0, le=1.0, description="of a sector's cells, from which it is covered")
    sectors: int = Field(ge=1, le=32)
    moving_mps: float = Field(gt=0.0, le=5.0, description="speed from which two equal pictures are a frozen one")
    detection_range_m: float = Field(gt=0.0, le=100.0, description="to which the detector finds a person")


@dataclass(frozen=True)
class LensReport:
    """State and reason of the whole picture, and which sectors (S,) see, from right to left."""

    state: HealthState
    reason: str
    sees: UInt8


def inspect(bgr: UInt8, horizon_row: float, config: LensConfig) -> LensReport:
    """The state of a picture (H, W, 3); only what lies below the horizon can be covered, for skies are flat."""
    grey = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), np.uint8)
    # in floats: rounding to grey levels would look like detail in a blurred picture
    half = np.asarray(cv2.pyrDown(grey.astype(np.float32)), np.float32)
    quarter = np.asarray(cv2.pyrDown(half), np.float32)
    reason = _what_blinds(quarter, half, config)
    if reason:
        return LensReport(HealthState.BLIND, reason, np.zeros(config.sectors, np.uint8))
    covered = covered_sectors(quarter, horizon_row / bgr.shape[0], config)
    if covered.all():
        return LensReport(HealthState.BLIND, "lens is covered", np.zeros(config.sectors, np.uint8))
    sees = (~covered).astype(np.uint8)
    if covered.any():
        reason = f"lens is covered in {int(covered.sum())} of {config.sectors} sectors"
        return LensReport(HealthState.DEGRADED, reason, sees)
    return LensReport(HealthState.GOOD, "", sees)


def _what_blinds(quarter: Float32, half: Float32, config: LensConfig) -> str:
    if np.percentile(quarter, 95) < config.dark_level:
        return "picture is dark"
    if (quarter >= config.glare_level).mean() > config.glare_share:
        return "picture is dazzled"
    if quarter.std() < config.flat_level:
        return "lens is covered"
    value = sharpness(half, quarter)
    if value < config.least_sharpness:
        return f"picture is blurred (sharpness {value:.2f})"
    return ""


def sharpness(half: Float32, quarter: Float32) -> float:
    """Energy of the finer Laplacian over that of the coarser one."""
    fine, coarse = cv2.Laplacian(half, cv2.CV_32F).var(), cv2.Laplacian(quarter, cv2.CV_32F).var()
    return float(fine / max(float(coarse), 1e-3))


def covered_sectors(quarter: Float32, horizon: float, config: LensConfig) -> Bools:
    """Which sectors (S,), from right to left, show nothing in most cells below the `horizon` (0 top, 1 bottom)."""
    height, width = quarter.shape
    cell_h, cell_w = height // ROWS, width // config.sectors
    cells = quarter[: cell_h * ROWS, : cell_w * config.sectors].reshape(ROWS, cell_h, config.sectors, cell_w)
    flat = cells.std(axis=(1, 3)) < config.flat_level
    # a mount that looks up leaves the lowest row to judge by
    first = min(int(np.ceil(horizon * ROWS)), ROWS - 1)
    return np.asarray(flat[first:].mean(axis=0) >= config.covered_share)[::-1]
