"""Settings of the ROS 2 adapter."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, field_validator
from pydantic_settings import SettingsConfigDict

from vertebra.keys import check_key
from vertebra.ros2.drivers import DriverName
from vertebra.service import ServiceSettings


class Ros2Settings(ServiceSettings):
    """ROS 2 topics, services and actions on the backbone."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_ROS2_")

    driver: DriverName = Field(
        "dds",
        description="How ROS is reached: 'dds'; 'rclpy', the ROS that is installed here; or "
        "'rmw_zenoh' for nodes that run rmw_zenoh_cpp.",
    )
    domain_id: int = Field(0, ge=0, le=232, description="As ROS_DOMAIN_ID.")
    node: str = Field(
        "vertebra", description="Name of our ROS node.", pattern=r"^[A-Za-z_][A-Za-z0-9_]*$"
    )
    namespace: str = Field(
        "/",
        description="Namespace of our ROS node.",
        pattern=r"^(/|(/[A-Za-z_][A-Za-z0-9_]*)+)$",
    )
    interface: str = Field(
        "lo", description="Network interface of DDS; 'auto' leaves it to DDS and CYCLONEDDS_URI."
    )
    peers: tuple[str, ...] = Field(
        (), description="Hosts to look for where there is no multicast, as a JSON list."
    )
    zenoh_router: str = Field(
        "",
        description="Router of the ROS nodes, for 'rmw_zenoh'; empty for the fleet's own.",
    )
    types: tuple[Path, ...] = Field(
        (), description="Folders of ROS packages with .msg, .srv, .action, .idl, as a JSON list."
    )
    routes: Path | None = Field(None, description="YAML file with the explicit routes.")
    automatic: bool = Field(
        default=True, description="Show every topic and service without a route below `mirror`."
    )
    mirror: str = Field(
        "ros2", description="Where that is; two ROS domains on one backbone need two places."
    )

    @field_validator("mirror")
    @classmethod
    def _is_key(cls, mirror: str) -> str:
        if mirror.startswith("@"):
            raise ValueError("what begins with '@' is for control")
        return check_key(mirror)
