"""Settings of the router."""

from __future__ import annotations

from pydantic import Field
from pydantic_settings import SettingsConfigDict

from vertebra.bus import DEFAULT_ROUTER
from vertebra.service import ServiceSettings


class RouterSettings(ServiceSettings):
    """The Zenoh router where the services of the fleet meet."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_ROUTER_")

    listen: tuple[str, ...] = Field(
        (DEFAULT_ROUTER,), description="Zenoh locators that services and other routers reach it at."
    )
    connect: tuple[str, ...] = Field(
        (), description="Zenoh locators of routers on other hosts to federate with."
    )
