"""Settings of the face tracking service."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, field_validator
from pydantic_settings import SettingsConfigDict

from vertebra.keys import check_key_expression, intersects
from vertebra.service import ServiceSettings
from vertebra_face_tracking.models import default_directory

RESULT = "faces"
"""The results for the images on `vizzy/camera/left` are on `vizzy/camera/left/faces`."""


class FaceTrackingSettings(ServiceSettings):
    """Find faces in camera images and follow them over time."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_FACE_TRACKING_")

    input: str = Field("*/camera/*", description="Key expression of the images to look at.")
    backend: str = Field("blazeface", description="Installed detector: blazeface or haar.")
    model: str = Field(
        "", description="Model of the backend; empty for its default (blazeface-full-range)."
    )
    models_directory: Path = Field(
        default_factory=default_directory,
        validation_alias="VERTEBRA_MODELS",
        description="Where fetched models lie.",
    )
    min_score: float = Field(0.5, ge=0, le=1, description="Detections below it are ignored.")
    keep_s: float = Field(
        1.0,
        gt=0,
        le=60,
        description="How long a hidden face keeps its id; more than the time between two images.",
    )
    max_rate_hz: float = Field(
        60.0, gt=0, description="Images per second that are looked at, all cameras together."
    )

    @field_validator("input")
    @classmethod
    def _reads_no_results(cls, expression: str) -> str:
        check_key_expression(expression)
        if intersects(expression, f"{expression}/{RESULT}"):
            raise ValueError(
                f"it also matches the results, '<image key>/{RESULT}'; "
                "name the images more closely, for example '*/camera/*'"
            )
        return expression
