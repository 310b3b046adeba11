"""Settings of the template."""

from __future__ import annotations

from pydantic import Field
from pydantic_settings import SettingsConfigDict

from vertebra.service import ServiceSettings


class TemplateSettings(ServiceSettings):
    """Greet whoever is named on a key."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_TEMPLATE_")

    names_key: str = Field("template/names", description="Key of the names, as Text.")
    greetings_key: str = Field("template/greetings", description="Key of the greetings, as Text.")
    greeting: str = Field("Hello", description="What is said to them.", min_length=1)
