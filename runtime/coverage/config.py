"""Configuration of the sensor coverage: bodies, places, and who may cross the band about an enclosed place."""

from typing import Annotated

from pydantic import Field

from configs.strict import Config


class CoverageConfig(Config):
    """Content of configs/coverage.yaml."""

    heights_m: tuple[Annotated[float, Field(gt=0.0, le=3.0)], ...] = Field(min_length=1, description="of the bodies")
    body_width_m: float = Field(gt=0.0, le=2.0, description="diameter of the bodies, upright cylinders")
    place_m: float = Field(ge=0.02, le=0.5, description="spacing of the places")
    surroundings_m: float = Field(gt=0.0, le=20.0, description="about the swept places, within which bands may lie")
    curvatures: int = Field(ge=3, le=41, description="arcs between the greatest curvatures to either side")
    person_mps: float = Field(gt=0.0, le=10.0, description="speed at which a person may enter a place")
