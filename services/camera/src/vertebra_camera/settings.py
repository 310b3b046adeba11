"""Settings of the camera."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from pydantic import Field, field_validator, model_validator
from pydantic_settings import SettingsConfigDict

from vertebra.keys import check_key
from vertebra.service import ServiceSettings
from vertebra_camera.pipeline import Relay, parse_source


class CameraSettings(ServiceSettings):
    """Camera images on the backbone: from devices, files, network streams and other keys."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_CAMERA_")

    source: str = Field(
        "/dev/video0",
        description="/dev/video0, rtsp://..., a picture, video or folder, or key:<other key>.",
    )
    credentials_file: Path | None = Field(
        None, description="File that holds `user:password` for a network stream."
    )
    key: str = Field("lab/camera/front", description="Key of the images.")
    frame_id: str = Field("", description="Coordinate frame of the camera.")
    max_rate_hz: float = Field(
        30.0, description="Images per second at the most; that of single pictures.", gt=0, le=1000
    )
    width: int = Field(0, description="Pixels of a row; 0 as it comes.", ge=0, le=16384)
    height: int = Field(0, description="Number of rows; 0 as it comes.", ge=0, le=16384)
    loop: bool = Field(default=True, description="Begin a file anew when it ends.")

    @field_validator("source")
    @classmethod
    def _is_a_source(cls, text: str) -> str:
        parse_source(text)
        return text

    @field_validator("key")
    @classmethod
    def _is_a_key(cls, key: str) -> str:
        return check_key(key)

    @model_validator(mode="after")
    def _does_not_feed_itself(self) -> Self:
        source = parse_source(self.source)
        if isinstance(source, Relay) and source.key == self.key:
            raise ValueError(f"source and key are both {self.key!r}; choose another key")
        return self
