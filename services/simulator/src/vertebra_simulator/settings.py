"""Settings of the simulator."""

from __future__ import annotations

from pydantic import Field
from pydantic_settings import SettingsConfigDict

from vertebra.ros2.drivers import DriverName
from vertebra.service import ServiceSettings


class SimulatorSettings(ServiceSettings):
    """A robot: a head with joints, a camera and an IMU on the YARP wire, a base on ROS 2."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_SIMULATOR_")

    name_server: str = Field(
        "127.0.0.1:10000",
        description="host:tcp_port of the YARP name server; the simulator waits for it.",
        pattern=r"^[^\s:]+:[0-9]{1,5}$",
    )
    robot: str = Field(
        "vizzy",
        description="Name of the robot, with which the names of its YARP ports begin.",
        pattern=r"^[A-Za-z0-9_.-]+$",
    )
    bind_host: str = Field("127.0.0.1", description="Interface on which the YARP ports listen.")
    advertise_host: str = Field(
        "", description="Address under which others reach the YARP ports; empty finds it."
    )
    camera_rate_hz: float = Field(30.0, description="Images per second.", gt=0, le=100)
    ros2: bool = Field(default=False, description="Have a base with wheels, as a ROS 2 node.")
    ros2_driver: DriverName = Field(
        "dds", description="How it is a ROS 2 node: 'dds', 'rclpy' or 'rmw_zenoh'."
    )
    ros2_zenoh_router: str = Field(
        "", description="Router of the ROS nodes, for 'rmw_zenoh'; empty for the fleet's own."
    )
    ros2_domain_id: int = Field(0, ge=0, le=232, description="As ROS_DOMAIN_ID.")
    ros2_interface: str = Field(
        "lo", description="Network interface of DDS; 'auto' leaves it to DDS and CYCLONEDDS_URI."
    )
    ros2_peers: tuple[str, ...] = Field(
        (), description="Hosts to look for where there is no multicast, as a JSON list."
    )
