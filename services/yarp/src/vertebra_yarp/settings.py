"""Settings of the YARP adapter."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field
from pydantic_settings import SettingsConfigDict

from vertebra.service import ServiceSettings
from vertebra.service.routes import read_routes
from vertebra_yarp.routes import KINDS


class YarpSettings(ServiceSettings):
    """YARP ports, RPC and control boards on the backbone."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_YARP_")

    driver: Literal["native", "bindings"] = Field(
        "native",
        description="native needs no YARP; bindings uses the YARP Python bindings of this machine.",
    )
    name_server: str = Field(
        "",
        description="host:tcp_port of the lab's yarpserver, or auto: as YARP finds it (yarp.conf, "
        "multicast); empty starts the built-in one.",
    )
    name_server_bind: str = Field(
        "127.0.0.1:10000", description="host:tcp_port on which the built-in name server listens."
    )
    bind_host: str = Field("127.0.0.1", description="Interface on which our own YARP ports listen.")
    advertise_host: str = Field(
        "", description="Address under which others reach our YARP ports; empty finds it."
    )
    routes: Path | None = Field(None, description="YAML file with the explicit routes.")
    automatic: bool = Field(
        default=True, description="Show every YARP port that no route claims below `yarp/`."
    )
    dialect: Literal["auto", "3", "4"] = Field(
        "auto", description="YARP generation of the robots; `auto` asks each of their ports."
    )
    prefix: str = Field(
        "",
        description="Our own YARP names are below this; empty makes one that no other fleet has.",
        pattern="^(/.*[^/])?$",
    )

    def check(self) -> None:
        """See `ServiceSettings.check`."""
        read_routes(self.routes, KINDS)
